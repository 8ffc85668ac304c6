"""Presses on the object from contacts of the gel (Section III-A, and the end of Section VI-B).

Without slip, a point of the gel stays with the point of the object that it touched first. Points
are paired in the pose of first contact, along the sensor's axis; the object's point moves with the
gel's after the gel has moved by their gap, which a curved object has. Transferred forces keep their
sum and their moment on any pair of meshes.

Where the gel's contact is known along z only (depth alone), the press has forces along the sensor's
axis and displacements along it, as readings of the surface: no component across it is observed. The
same holds for the displacements where the gel slips, which the option `friction` determines.

Coulomb friction limits the traction along the face to the coefficient of friction times the
pressure. In a contact that is sheared, it reaches the limit at the edge first (R. D. Mindlin,
"Compliance of elastic bodies in contact", J. Appl. Mech. 16 (1949), 259-268). There a point of the
gel does not stay with the point of the object that it touched first. The forces are not affected,
as they follow from the deformation of the gel.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from scipy.spatial import Delaunay

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.sharp_edges import distance_from_sharp_edges
from tactorch.recording import Press, PressErrors, SurfaceReading
from tactorch.sensor.gel import GelContact
from tactorch.sensor.poses import Pose, check_pose, rotate_vectors, transform_points
from tactorch.sensor.transfer import transfer_forces

#: Smallest cosine between the sensor axis and the inward normal of a face that may be in contact.
MIN_FACING = 0.5
_AT_EDGE_MM = 1e-6  # distance of nodes from an edge that they are on
_NEAR_LIMIT = 0.9  # tangential over normal force, over the coefficient of friction
_CONTACT_LEVEL = 0.5  # of the interpolated contact indicator

Points = Float[np.ndarray, "k 3"]
Nodes = Float[np.ndarray, "n 3"]
Triangles = Int[np.ndarray, "t 3"]
Vector = Float[np.ndarray, "3"]
Flat = Float[np.ndarray, " k"]
Flags = Bool[np.ndarray, " k"]


@dataclass(frozen=True)
class ContactOptions(Options):
    """Pairing of the gel with the object."""

    reach_mm: float = option(
        3.0, "Largest distance of touched faces from the gel at first contact", unit="mm", gt=0
    )
    untouched: Literal["unseen", "sensor", "auto"] = option(
        "auto",
        "Nodes under the gel without contact: unseen (not observed), sensor (displaced with the"
        " sensor, as the paper does in a virtual cube, whose empty parts then become soft), or auto"
        " (sensor in a virtual cube, else unseen)",
    )
    smoothing: float = option(0.0, "Smoothing of the interpolated displacements", ge=0)
    friction: float | None = option(
        None, "Coefficient of friction of gel and object: where the traction along the face reaches"
        " it, the gel slips, and only displacements along the axis are observed; null: no slip",
        gt=0,
    )  # fmt: skip


def build_press(
    contact: GelContact,
    pose: Pose,
    first_pose: Pose,
    mesh: TetMesh,
    in_contact: Flags,
    *,
    options: ContactOptions | None = None,
    apart_mm: float | None = 0.0,
    **fields: Any,
) -> Press:
    """Return the press of the sensor on an object.

    Args:
        contact: Forces on the gel and displacements of its face, in the sensor frame.
        pose: T_object_sensor of this frame.
        first_pose: T_object_sensor at first contact.
        mesh: Object at rest, mm.
        in_contact: Nodes of the gel's face in contact; forces on other nodes are ignored.
        options: Pairing of the gel with the object.
        apart_mm: Distance of gel and object in the first pose by an error of it, in which they
            touch. None where the shape of the object is not known: there are no gaps then.
        fields: Further fields of the press: its supports (`springs`, `fixed`, `prescribed`),
            `noise_mm`, `step`, `name`.

    Raises:
        ConfigError: A pose is not valid, the gel does not touch the object, or `noise_mm` is not
            given for a contact that is known along z only, or that slips.
        RecordingError: A field of the press is not valid.
    """
    options, normal_only = options or ContactOptions(), contact.normal_only
    if normal_only:
        contact = contact.with_zeros()
    check_pose(pose, "pose")
    check_pose(first_pose, "first pose")
    if not in_contact.any():
        raise ConfigError("the gel touches nothing in this frame; leave it out.")
    triangles = facing_triangles(mesh, first_pose, contact, options.reach_mm)
    nodes = np.unique(triangles)
    points = mesh.points[nodes]
    paired = transform_points(first_pose, contact.points)  # the object's points at first contact
    motion = transform_points(pose, contact.points + contact.displacement) - paired
    sets = -rotate_vectors(pose, _with_errors(contact, in_contact))
    transferred = transfer_forces(paired, sets, mesh.points, triangles, contact.triangles)
    normal = first_pose[:3, 2]
    known = np.column_stack([motion, contact.points[:, 2]])
    found = interpolate_displacements(paired, known, points, normal, options.smoothing)
    at_rest = transform_points(np.linalg.inv(first_pose), points)
    gaps = np.zeros(len(points)) if apart_mm is None else at_rest[:, 2] - found[:, 3] - apart_mm
    interpolated = found[:, :3] - gaps[:, None] * normal
    inside = np.isfinite(interpolated).all(axis=1)
    touched = _interpolate_flags(contact.points, in_contact, at_rest)
    displacement = np.full(mesh.points.shape, np.nan)
    seen = inside & touched
    if contact.errors is not None:
        # The traction is singular at sharp edges, where the mesh of the object cannot follow it.
        seen &= distance_from_sharp_edges(mesh)(points) > _AT_EDGE_MM
    displacement[nodes[seen]] = interpolated[seen]
    if options.untouched == "sensor":
        free = inside & ~touched
        displacement[nodes[free]] = transform_points(pose, at_rest[free]) - points[free]
    observed = np.repeat(np.isfinite(displacement[:, :1]), 3, axis=1)
    if not observed.any():
        raise ConfigError(
            "no node of the object is in contact with the gel; give a finer mesh of the object."
        )
    axis = pose[:3, 2].copy()
    moved = None
    if contact.errors is not None and not normal_only:
        errors = rotate_vectors(pose, contact.errors.displacement)
        moved = _interpolate_each(paired, errors, points, normal)
        fields["errors"] = PressErrors(nodes, transferred[1:, nodes], moved)
    slipping = slipping_nodes(contact.forces, in_contact, options.friction)
    slips = _interpolate_flags(contact.points, slipping, at_rest)
    along_only = observed[nodes, 0] & (normal_only | slips)
    if along_only.any():
        rows = nodes[along_only]
        variance = 0.0 if moved is None else ((moved[:, along_only] @ axis) ** 2).sum(axis=0)
        fields["surface"] = _along_axis(
            mesh.points[rows], axis, displacement[rows] @ axis, fields.get("noise_mm"), variance
        )
        observed[rows] = False
    return Press(transferred[0], observed, displacement, direction=axis, **fields)


def _with_errors(contact: GelContact, in_contact: Flags) -> Float[np.ndarray, "q k 3"]:
    """Return the forces on the gel at nodes in contact, N, then their errors."""
    sets = [contact.forces[None]] + ([] if contact.errors is None else [contact.errors.forces])
    return np.where(in_contact[:, None], np.concatenate(sets), 0.0)


def slipping_nodes(forces: Points, in_contact: Flags, friction: float | None) -> Flags:
    """Return the nodes of a gel's face that slip, by the forces on the gel in the sensor frame, N.

    None does without a coefficient of friction.
    """
    if friction is None:
        return np.zeros(len(forces), dtype=bool)
    along, pressing = np.linalg.norm(forces[:, :2], axis=1), np.maximum(-forces[:, 2], 0.0)
    at_limit = (along > 0.0) & (along >= _NEAR_LIMIT * friction * pressing)
    return np.asarray(in_contact & at_limit)


def _along_axis(
    points: Points, axis: Vector, along_mm: Flat, noise_mm: float | None, variance_mm2: Flat | float
) -> SurfaceReading:
    """Readings of displacements along an axis at points; the variance is added to the noise."""
    if not noise_mm:
        raise ConfigError("noise_mm is needed for a contact that is known along z only; give it.")
    directions = np.tile(axis / np.linalg.norm(axis), (len(points), 1))
    deviations = np.sqrt(np.full(len(points), float(noise_mm) ** 2) + variance_mm2)
    return SurfaceReading(points, directions, along_mm, deviations)


def _interpolate_flags(points: Points, flags: Flags, targets: Nodes) -> Bool[np.ndarray, " n"]:
    """Interpolate flags of nodes of the gel's face to other points, in the sensor frame."""
    indicator = LinearNDInterpolator(points[:, :2], flags.astype(float), 0.0)
    return np.asarray(indicator(targets[:, :2]) >= _CONTACT_LEVEL)


def facing_triangles(
    mesh: TetMesh, first_pose: Pose, contact: GelContact, reach_mm: float
) -> Triangles:
    """Return the object's surface triangles that face the gel, under it and within reach."""
    surface = mesh.surface
    facing = np.asarray(surface.normals @ first_pose[:3, 2] < -MIN_FACING)
    centers = mesh.points[surface.triangles].mean(axis=1)
    centers = transform_points(np.linalg.inv(first_pose), centers)
    low, high = contact.points[:, :2].min(axis=0), contact.points[:, :2].max(axis=0)
    under = ((centers[:, :2] >= low) & (centers[:, :2] <= high)).all(axis=1)
    close = np.abs(centers[:, 2] - float(np.median(contact.points[:, 2]))) <= reach_mm
    if not (facing & under & close).any():
        distances, translation = np.abs(centers[facing & under, 2]), first_pose[:3, 3]
        hint = ""
        if 0 < np.abs(translation).max() < 0.05 * np.abs(mesh.points).max():
            shown = [float(f"{v:.4g}") for v in translation]
            hint = f" Its translation {shown} looks like metres; give mm."
        nearest = f": the nearest is {distances.min():.3g} mm away" if len(distances) else ""
        raise ConfigError(
            f"the gel is over no part of the object in the pose of first contact{nearest}; check"
            f" T_object_sensor, whose z axis points out of the sensor to the object.{hint}"
        )
    return surface.triangles[facing & under & close]


def _interpolate_each(
    points: Points, fields: Float[np.ndarray, "q k 3"], nodes: Nodes, normal: Vector
) -> Float[np.ndarray, "q n 3"]:
    """Interpolate several fields of displacements; they are zero outside the convex hull."""
    columns = fields.transpose(1, 0, 2).reshape(len(points), -1)
    found = np.nan_to_num(interpolate_displacements(points, columns, nodes, normal))
    return found.reshape(len(nodes), len(fields), 3).transpose(1, 0, 2)


def interpolate_displacements(
    points: Points,
    displacements: Float[np.ndarray, "k c"],
    nodes: Nodes,
    normal: Vector,
    smoothing: float = 0.0,
) -> Float[np.ndarray, "n c"]:
    """Interpolate displacements by a thin-plate spline in the plane across a normal.

    They are NaN at nodes outside the convex hull of the points.
    """
    known = np.isfinite(displacements).all(axis=1)
    if known.sum() < 4:
        raise ConfigError(f"{int(known.sum())} displacements are known; at least four are needed.")
    plane = np.linalg.svd(normal[None])[2][1:].T
    flat, targets = points[known] @ plane, nodes @ plane
    if np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-9) < 2:
        raise ConfigError("the points of known displacements are on a line; give a wider contact.")
    inside = np.asarray(Delaunay(flat).find_simplex(targets) >= 0)
    result = np.full((len(nodes), displacements.shape[1]), np.nan)
    if inside.any():
        spline = RBFInterpolator(
            flat, displacements[known], neighbors=min(40, int(known.sum())),
            smoothing=smoothing, kernel="thin_plate_spline",
        )  # fmt: skip
        result[inside] = spline(targets[inside])
    return result
