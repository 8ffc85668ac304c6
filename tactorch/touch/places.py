"""Random places and motions of a sensor on a body."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.sensor.poses import Pose
from tactorch.touch.options import TouchOptions
from tactorch.touch.pairing import Facing
from tactorch.touch.scene import TouchScene

_MAX_DRAWS = 60
_SHARP = 0.75  # cosine of the angle to normals beyond an edge, which do not count
_CENTRAL = 0.5  # distance of the first touch from the axis, over half the size of gel or image
_LAG = 0.5  # motion from first touch to that of the place, over the largest depth

Vector = Float[np.ndarray, "3"]


def draw_place(scene: TouchScene, rng: np.random.Generator) -> tuple[Pose, Facing]:
    """Draw a place on the surface of a body and a pose over it, uniform over the area.

    The sensor's axis is the inward normal, tilted a little; its turn about the axis is random.
    Places are drawn again at which the gel first touches the body far from its center, unless the
    place is touched soon afterwards, as on flat sides.

    Returns:
        T_object_sensor, whose origin is on the surface, and the gel in front of the body.

    Raises:
        ConfigError: No place was found.
    """
    options = scene.options
    triangles = _allowed(scene)
    if not len(triangles):
        raise ConfigError(
            f"no part of the body's surface is within {options.max_slope_deg:g} degrees of the side"
            f" opposite {options.held_side}; give a larger max_slope_deg."
        )
    areas = scene.mesh.surface.areas[triangles]
    limits = _CENTRAL * np.minimum(
        scene.sensor.gel.half_size_mm, np.array(scene.sensor.size_mm) / 2
    )
    for _ in range(_MAX_DRAWS):
        triangle = int(triangles[rng.choice(len(triangles), p=areas / areas.sum())])
        pose = _draw_pose(scene, triangle, rng)
        facing = scene.facing(pose)
        if facing is None:
            continue
        first, z_mm = facing.first_touch
        if (np.abs(first) <= limits).all() or -z_mm <= _LAG * options.depth_mm[1]:
            return pose, facing
    raise ConfigError(
        f"no place was found in {_MAX_DRAWS} draws at which the gel first touches the body near its"
        " center; give a larger max_slope_deg, or a larger body."
    )


def draw_motion(options: TouchOptions, rng: np.random.Generator) -> Vector:
    """Draw the motion from first touch, in the sensor frame, mm."""
    depth, shear = float(rng.uniform(*options.depth_mm)), float(rng.uniform(*options.shear_mm))
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    return np.array([shear * np.cos(turn), shear * np.sin(turn), depth])


def _allowed(scene: TouchScene) -> Int[np.ndarray, " t"]:
    """Triangles of the surface that are not too steep, and not held."""
    surface, side = scene.mesh.surface, scene.options.held_side
    up = np.eye(3)["xyz".index(side[0])] * (1.0 if side[1] == "-" else -1.0)
    steep = surface.normals @ up < np.cos(np.deg2rad(scene.options.max_slope_deg))
    held = scene.held[surface.triangles].all(axis=1)
    return np.flatnonzero(~steep & ~held)


def _draw_pose(scene: TouchScene, triangle: int, rng: np.random.Generator) -> Pose:
    """Draw a point of a triangle and a pose there, whose z axis points into the body."""
    mesh, surface = scene.mesh, scene.mesh.surface
    shares = rng.dirichlet(np.ones(3))
    point = shares @ mesh.points[surface.triangles[triangle]]
    centers = mesh.points[surface.triangles].mean(axis=1)
    close = np.linalg.norm(centers - point, axis=1) <= scene.options.gel_edge_mm
    close &= surface.normals @ surface.normals[triangle] > _SHARP
    close[triangle] = True
    normal = (surface.areas[close, None] * surface.normals[close]).sum(axis=0)
    inward = -normal / np.linalg.norm(normal)
    across = np.linalg.svd(inward[None])[2][1:]
    tilt, turn = np.deg2rad(rng.uniform(0.0, scene.options.tilt_deg)), rng.uniform(0.0, 2 * np.pi)
    axis = np.cos(turn) * across[0] + np.sin(turn) * across[1]
    inward = Rotation.from_rotvec(tilt * axis).apply(inward)
    first = np.cross(np.linalg.svd(inward[None])[2][1], inward)
    first = Rotation.from_rotvec(rng.uniform(0.0, 2 * np.pi) * inward).apply(first)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([first, np.cross(inward, first), inward])
    pose[:3, 3] = point
    return pose
