"""A press of a gel as a press over the nodes of the recording's mesh."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS
from tactorch.fem.elements import Discretisation
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.recording import Press
from tactorch.sensor.transfer import transfer_forces
from tactorch.simulation.pipeline import add_noise
from tactorch.touch.pairing import ELEMENT
from tactorch.touch.scene import GelPress, TouchScene, held_nodes

_WITHIN = 0.35  # distance of nodes in contact from a loaded point, over the edge of the gel's cells


def record_press(
    scene: TouchScene,
    mesh: TetMesh,
    press: GelPress,
    snr_db: float | None,
    rng: np.random.Generator,
    step: int,
) -> Press:
    """Return the press of the recording: forces on its nodes, and displacements in contact.

    Forces keep their sum and their moment. Nodes of the surface within the contact are observed,
    or the one closest to the largest force where there are none. A signal-to-noise ratio of the
    displacements of None is no noise; `step` is the number of the load step at its place.

    Raises:
        ConfigError: Gel and body do not touch.
    """
    if not len(press.points):
        raise ConfigError("gel and body do not touch; give a larger depth_mm.")
    forces = transfer_forces(press.points, press.forces, mesh.points, mesh.surface.triangles)
    fixed = np.repeat(
        held_nodes(mesh, scene.options.held_side, scene.options.held)[:, None], 3, axis=1
    )
    nodes = _touched(mesh, press, _WITHIN * scene.options.gel_edge_mm)
    displacement = np.zeros_like(mesh.points)
    displacement[nodes] = _displacement_at(scene.mesh, press, mesh.points[nodes])
    observed = np.zeros(mesh.points.shape, dtype=bool)
    observed[nodes] = True
    observed &= ~fixed
    noise_mm = None
    if snr_db is not None:
        displacement, noise_mm = add_noise(displacement, observed, snr_db, rng)
    x, y, z = press.pose[:3, 3]
    return Press(
        forces, observed, displacement, fixed=fixed, noise_mm=noise_mm, step=step,
        direction=press.pose[:3, 2].copy(), name=f"({x:.4g}, {y:.4g}, {z:.4g}) mm, step {step}",
    )  # fmt: skip


def _touched(mesh: TetMesh, press: GelPress, within_mm: float) -> Int[np.ndarray, " k"]:
    """Nodes of the surface within the contact, at least one."""
    nodes = np.unique(mesh.surface.triangles)
    distances, _ = cKDTree(press.points).query(mesh.points[nodes])
    found = nodes[distances <= within_mm]
    if len(found):
        return found
    middle = press.points[np.linalg.norm(press.forces, axis=1).argmax()]
    return nodes[[np.linalg.norm(mesh.points[nodes] - middle, axis=1).argmin()]]


def _displacement_at(
    mesh: TetMesh, press: GelPress, points: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3"]:
    """Displacement of the body's surface at the points of it that are closest to others, mm."""
    parts, triangles = Discretisation(mesh, ELEMENTS[ELEMENT]), mesh.surface.triangles
    closest = closest_points(mesh.points, triangles, points)
    nodes = parts.surface_nodes(triangles[closest.triangles])
    shares = parts.surface_values(closest.barycentric)
    found: np.ndarray = np.einsum("pk,pkd->pd", shares, press.displacement[nodes])
    return found
