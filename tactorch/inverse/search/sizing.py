"""Edge lengths that the presses, the boundaries of inclusions and edges of the body need."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactorch.inverse.fields import InclusionShape
from tactorch.inverse.forward.footprint import Footprint, loaded_nodes
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice
from tactorch.mesh.refine import Sizing
from tactorch.mesh.sharp_edges import distance_from_sharp_edges
from tactorch.mesh.topology import triangle_edges
from tactorch.recording import Press, Recording, refine_recording

# Longest edge at the boundary of an inclusion over its radius, and its growth with the distance.
# The strain falls with the third power of the distance r from the centre: by a factor of two within
# an element where edges are a quarter of r, as they are far away.
_PER_RADIUS, _GROWTH = 0.5, 0.25
_PER_GAP = 0.25  # longest edge at the observed surface, over its distance from an inclusion
_GAP_GROWTH = 0.5  # of the longest edge with the distance from the surface
_NEAR = 2.0  # largest distance of the surface from an inclusion, over the inclusion's radius
_MIN_GAP = 0.5  # smallest distance that edges follow, over the inclusion's radius
_PER_SIZE = 0.06  # longest edge at a sharp edge, over the body's size
_SHARP_GROWTH = 1.0  # of the longest edge with the distance from a sharp edge
_PER_CONTACT = 0.5  # longest edge at the rim of a contact, over the contact's radius
_PER_TRIANGLE = 4  # divisions of the edges of loaded triangles into points of the loaded surface
_MIN_COSINE = 0.8  # between normals, where the surface goes on across a rim


def inclusion_sizing(inclusions: Sequence[InclusionShape]) -> Sizing:
    """Return the longest edges (mm) at points (mm): short near boundaries of inclusions."""

    def sizing(shape: InclusionShape) -> Sizing:
        shortest = _PER_RADIUS * shape.detail_mm
        return lambda points: shortest + _GROWTH * np.abs(shape.distance(points))

    return smallest(*map(sizing, inclusions))


def observed_sizing(
    observed: Float[np.ndarray, "n 3"], inclusions: Sequence[InclusionShape]
) -> Sizing | None:
    """Return the longest edges (mm) at points (mm): short where the surface is near inclusions.

    `observed` are its observed points, mm. None where no inclusion is near.
    """
    gaps, near = np.full(len(observed), np.inf), np.zeros(len(observed), dtype=bool)
    for shape in inclusions:
        distances = np.abs(shape.distance(observed))
        near |= distances < _NEAR * shape.radius_mm
        gaps = np.minimum(gaps, np.maximum(distances, _MIN_GAP * shape.radius_mm))
    if not near.any():
        return None
    tree, gaps = cKDTree(observed[near]), gaps[near]

    def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        distances, nearest = tree.query(points)
        return np.asarray(_PER_GAP * gaps[nearest] + _GAP_GROWTH * distances)

    return sizing


def sharp_edge_sizing(mesh: TetMesh) -> Sizing:
    """Return the longest edges (mm) at points (mm): short at sharp edges of the body.

    Strains are singular where a supported face ends at an edge.
    """
    distance = distance_from_sharp_edges(mesh)
    shortest = _PER_SIZE * float(np.cbrt(mesh.volumes.sum()))
    return lambda points: shortest + _SHARP_GROWTH * distance(points)


def smallest(*sizings: Sizing | None) -> Sizing:
    """Return the shortest of longest edges, of which None is no limit; infinite without any."""
    limits = [sizing for sizing in sizings if sizing is not None]

    def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        unlimited = np.full(len(points), np.inf)
        return np.minimum.reduce([unlimited, *(limit(points) for limit in limits)])

    return sizing


def contact_sizing(recording: Recording) -> Sizing:
    """Return the longest edges (mm) at points (mm): short at rims of contacts, and under probes.

    The traction ends at the rim, where strains change within a fraction of the contact's radius,
    which is that of a disc of the area of the loaded surface triangles. Contacts that end at an
    edge of the body have no rim there.
    """
    first: dict[bytes, Press] = {}  # of each contact
    for press in recording.presses:
        key = (press.forces != 0).any(axis=1).tobytes() + press.geometry_bytes()
        first.setdefault(key, press)
    rims = [rim for press in first.values() if (rim := Rim.of(press, recording.mesh))]
    inside = [_PER_CONTACT if rim.of_probe else None for rim in rims]
    pairs = zip(rims, inside, strict=True)
    return smallest(*(rim.sizing(_PER_CONTACT, np.inf, under) for rim, under in pairs))


def refined_at_contacts(recording: Recording) -> Recording:
    """Return the presses on a mesh that is fine enough at the rims of contacts for fits."""
    return refine_recording(recording, contact_sizing(recording), smooth_tractions=True)


def loaded_end(mesh: TetMesh, loaded: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Return the nodes where the loaded triangles end, within a face or at edges of the body."""
    triangles = mesh.surface.triangles
    sides = triangle_edges(triangles[loaded[triangles].all(axis=1)])
    ends, counts = np.unique(sides, axis=0, return_counts=True)
    return np.unique(ends[counts == 1])


@dataclass(frozen=True, eq=False)
class Rim:
    """Where the load of a contact ends and the surface goes on.

    Attributes:
        nodes: Loaded nodes beside which the surface goes on without load.
        tree: Their positions, mm.
        inside: Points of the loaded surface triangles, mm.
        radius_mm: Radius of a disc of the area of the loaded surface triangles.
        of_probe: Whether a probe loads it, so that its traction is a result.
    """

    nodes: Int[np.ndarray, " k"]
    tree: cKDTree
    inside: cKDTree
    radius_mm: float
    of_probe: bool = False

    @staticmethod
    def of(press: Press, mesh: TetMesh) -> "Rim | None":
        """Return the rim of a press; None where it ends at edges of the body.

        A probe that touches the whole width of a face has a rim there too.
        """
        if press.probe is not None:
            points, rim, radius = Footprint.of(press.probe, mesh)
            nodes = np.flatnonzero(loaded_nodes(press, mesh))
            return Rim(nodes, cKDTree(rim if len(rim) else points), cKDTree(points), radius, True)
        surface, loaded = mesh.surface, (press.forces != 0).any(axis=1)
        inside = loaded[surface.triangles].all(axis=1)
        normals = np.zeros((mesh.n_points, 3))
        for corner in surface.triangles[inside].T:
            np.add.at(normals, corner, surface.normals[inside])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        corners = surface.triangles[~inside]
        smooth = np.einsum("tcd,td->tc", normals[corners], surface.normals[~inside]) > _MIN_COSINE
        nodes = np.unique(corners[smooth & loaded[corners]])
        if not len(nodes):
            return None
        radius = float(np.sqrt(surface.areas[inside].sum() / np.pi))
        places = lattice(_PER_TRIANGLE + 1, margin=0.0, corners=3)
        sampled = np.einsum("sc,tcd->tsd", places, mesh.points[surface.triangles[inside]])
        return Rim(nodes, cKDTree(mesh.points[nodes]), cKDTree(sampled.reshape(-1, 3)), radius)

    def sizing(self, per_radius: float, growth: float, inside: float | None = None) -> Sizing:
        """Return the longest edges at points: `per_radius` times the radius at the rim.

        They grow with the distance from it, without a limit there for infinite growth, and are
        `inside` times the radius at the loaded surface, where they have no limit by default.
        """

        def around(tree: cKDTree, shortest: float) -> Sizing:
            def sizing(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
                beyond = np.maximum(tree.query(points)[0] - shortest, 0.0)
                return shortest + np.multiply(growth, beyond, out=beyond, where=beyond > 0.0)

            return sizing

        at_rim = around(self.tree, per_radius * self.radius_mm)
        within = None if inside is None else around(self.inside, inside * self.radius_mm)
        return smallest(at_rim, within)
