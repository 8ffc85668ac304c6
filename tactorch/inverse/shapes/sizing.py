"""Edge lengths that the presses and the boundaries of inclusions need."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.inverse.shapes.field import Ellipsoid
from tactorch.mesh import TetMesh
from tactorch.mesh.refine import Sizing
from tactorch.recording import Recording

_PER_RADIUS = 0.65  # longest edge at the boundary of an inclusion, over its radius
_SHELL = 0.25  # half-width of the refined shell, over the radius
_PER_CONTACT = 0.5  # longest edge at the rim of a contact, over the contact's radius
_MIN_COSINE = 0.8  # between normals, where the surface goes on across a rim


def inclusion_sizing(inclusions: Sequence[Ellipsoid]) -> Sizing:
    """Return the longest edges (mm) at points (mm): short near boundaries of inclusions.

    An element that a boundary crosses has one strain, or a linear one, for both sides.
    """

    def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        lengths = np.full(len(points), np.inf)
        for shape in inclusions:
            near = np.abs(shape.distance(points)) < _SHELL * shape.radius_mm
            lengths[near] = np.minimum(lengths[near], _PER_RADIUS * shape.radius_mm)
        return lengths

    return sizing


def contact_sizing(recording: Recording) -> Sizing:
    """Return the longest edges (mm) at points (mm): short at rims of contacts.

    The traction ends at the rim, where strains change within a fraction of the contact's radius,
    which is that of a disc of the area of the loaded surface triangles. Contacts that end at an
    edge of the body have no rim there.
    """
    rims: dict[bytes, tuple[cKDTree | None, float]] = {}
    for press in recording.presses:
        loaded = (press.forces != 0).any(axis=1)
        if loaded.tobytes() not in rims:
            rims[loaded.tobytes()] = _rim(recording.mesh, loaded)

    def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        lengths = np.full(len(points), np.inf)
        for rim, radius in rims.values():
            if rim is not None:
                near = rim.query(points)[0] < _PER_CONTACT * radius
                lengths[near] = np.minimum(lengths[near], _PER_CONTACT * radius)
        return lengths

    return sizing


def _rim(mesh: TetMesh, loaded: Bool[np.ndarray, " n"]) -> tuple[cKDTree | None, float]:
    """Return the loaded points beside which the surface goes on without load, and the radius."""
    surface = mesh.surface
    inside = loaded[surface.triangles].all(axis=1)
    radius = float(np.sqrt(surface.areas[inside].sum() / np.pi))
    normals = np.zeros((mesh.n_points, 3))
    for corner in surface.triangles[inside].T:
        np.add.at(normals, corner, surface.normals[inside])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    corners = surface.triangles[~inside]
    smooth = np.einsum("tcd,td->tc", normals[corners], surface.normals[~inside]) > _MIN_COSINE
    rim = np.unique(corners[smooth & loaded[corners]])
    return (cKDTree(mesh.points[rim]) if len(rim) else None), radius
