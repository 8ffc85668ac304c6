"""Forces at points to forces on the nodes of a surface, with the same sum and moment."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.closest import Closest, closest_points
from tactorch.mesh.geometry import area_vectors
from tactorch.mesh.quadrature import lattice
from tactorch.mesh.tractions import LoadedSurface

_STEPS = 4  # of a lattice of points along the sides of a triangle, for integrals
# Margin of the lattice to the sides that makes means of quadratic functions exact.
_MARGIN = float(np.sqrt(_STEPS**2 / 9.0 + _STEPS / 3.0) - _STEPS / 3.0)
_MIN_INERTIA = 1e-9  # relative to the largest, of an axis about which nodes can carry a couple

Points = Float[np.ndarray, "k 3"]
Nodes = Float[np.ndarray, "n 3"]
Triangles = Int[np.ndarray, "t 3"]


def transfer_forces(
    points: Points,
    forces: Float[np.ndarray, "*q k 3"],
    nodes: Nodes,
    triangles: Triangles,
    sources: Int[np.ndarray, "s 3"] | None = None,
) -> Float[np.ndarray, "*q n 3"]:
    """Return forces on the nodes of a surface with the same sum and moment.

    Forces on nodes of a mesh stand for a traction that is linear on its triangles. It is integrated
    over them with the hat functions of the surface at the closest points, as mortar methods do
    (Bernardi, Maday and Patera, 1994), so that the density of both meshes does not matter. Forces
    that act at points are divided among the corners of the closest triangle. The moment lost where
    points are off the surface is restored by a couple over the loaded nodes.

    Lengths are in mm, forces in N; there may be several sets of these. `sources` are the triangles
    of the mesh of the points on which the traction acts; the forces on other points act at these.

    Raises:
        ConfigError: The surface has no triangle.
    """
    if not len(triangles):
        raise ConfigError("the object has no surface in contact; give triangles.")
    sets = forces.reshape(-1, *forces.shape[-2:])
    acting: np.ndarray = (sets != 0.0).any(axis=(0, 2))
    if sources is None:
        sources = np.zeros((0, 3), dtype=np.int64)
    closest = closest_points(nodes, triangles, points)
    weights = _at_points(closest, triangles, nodes)
    sources = sources[acting[sources].all(axis=1)]
    if len(sources):
        weights = _distributed(weights, points, nodes, triangles, sources)
    nodal = np.stack([weights @ one for one in sets])
    loaded = (nodal != 0.0).any(axis=(0, 2))
    loaded[triangles[closest.triangles[acting]]] = True
    if loaded.any():
        moment = np.cross(points, sets).sum(axis=1) - np.cross(nodes, nodal).sum(axis=1)
        nodal[:, loaded] += _couples(nodes[loaded], moment)
    return nodal.reshape(*forces.shape[:-2], *nodes.shape)


def _at_points(closest: Closest, triangles: Triangles, nodes: Nodes) -> sp.csr_matrix:
    """Forces on the nodes of the surface by unit forces at points, (n, k)."""
    columns = np.repeat(np.arange(len(closest.triangles)), 3)
    entries = closest.barycentric.ravel(), (triangles[closest.triangles].ravel(), columns)
    return sp.csr_matrix(entries, shape=(len(nodes), len(closest.triangles)))


def _distributed(
    at_points: sp.csr_matrix,
    points: Points,
    nodes: Nodes,
    triangles: Triangles,
    sources: Int[np.ndarray, "s 3"],
) -> sp.csr_matrix:
    """Return the map `at_points` with the forces on the nodes of `sources` as a traction."""
    mixed, surface = _products(points, nodes, triangles, sources)
    inner = surface.nodes
    mass = surface.mass[inner][:, inner].toarray()
    result = at_points.tolil()
    result[:, inner] = sp.csr_matrix(np.linalg.solve(mass, mixed[:, inner].toarray().T).T)
    return result.tocsr()


def _products(
    points: Points, nodes: Nodes, triangles: Triangles, sources: Int[np.ndarray, "s 3"]
) -> tuple[sp.csr_matrix, LoadedSurface]:
    """Integrals of products of the hat functions of both surfaces (n, k), mm^2, and the sources."""
    areas = np.linalg.norm(area_vectors(points, sources), axis=1)
    shares = lattice(_STEPS + 1, _MARGIN, 3)
    samples = np.einsum("pc,tcd->tpd", shares, points[sources]).reshape(-1, 3)
    closest = closest_points(nodes, triangles, samples)
    sizes = np.repeat(areas / len(shares), len(shares))
    weights = np.tile(shares, (len(sources), 1)) * sizes[:, None]
    values = closest.barycentric[:, :, None] * weights[:, None]
    rows = np.repeat(triangles[closest.triangles], 3, axis=1)
    columns = np.tile(np.repeat(sources, len(shares), axis=0), 3)
    entries = values.ravel(), (rows.ravel(), columns.ravel())
    mixed = sp.csr_matrix(entries, shape=(len(nodes), len(points)))
    return mixed, LoadedSurface(sources, areas, len(points))


def _couples(nodes: Nodes, moments: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q n 3"]:
    """Smallest self-balanced forces with given moments, about axes that the nodes can carry."""
    arms = nodes - nodes.mean(axis=0)
    inertia = (arms**2).sum() * np.eye(3) - arms.T @ arms
    values, axes = np.linalg.eigh(inertia)
    valid = values > _MIN_INERTIA * max(values[-1], 1e-300)
    rotations = (moments @ axes[:, valid] / values[valid]) @ axes[:, valid].T
    return np.cross(rotations[:, None], arms)
