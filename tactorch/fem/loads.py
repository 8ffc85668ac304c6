"""Nodal forces of pressures, tractions and gravity, differentiable in the rest positions.

Loads are dead: a pressure or traction acts per rest area, in a constant direction.
"""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.fem.elements import Discretisation
from tactorch.mesh import select_face

#: Standard acceleration of gravity along -z, mm/s^2.
STANDARD_GRAVITY = (0.0, 0.0, -9806.65)


def surface_triangles(
    discretisation: Discretisation, surface: str | Int[np.ndarray, " k"]
) -> Int[np.ndarray, "k 3"]:
    """Return the vertices of surface triangles, given by a flat side ("z+") or by indices.

    Raises:
        ConfigError: No triangle is selected, or an index is outside the surface.
    """
    mesh = discretisation.mesh
    selected = select_face(mesh, surface) if isinstance(surface, str) else np.asarray(surface)
    count = len(mesh.surface.triangles)
    if len(selected) == 0 or selected.min() < 0 or selected.max() >= count:
        raise ConfigError(
            f"surface {surface!r} selects no triangle or one outside 0..{count - 1}; name a flat "
            "side (x-, x+, y-, y+, z-, z+) or give indices into mesh.surface.triangles."
        )
    return mesh.surface.triangles[selected]


def traction_forces(
    discretisation: Discretisation,
    surface: str | Int[np.ndarray, " k"],
    traction_mpa: Float[Tensor, "3"],
    points: Float[Tensor, "n 3"] | None = None,
) -> Float[Tensor, "nodes 3"]:
    """Return the consistent nodal forces (N) of a uniform traction on a surface.

    Args:
        discretisation: The mesh and element.
        surface: Name of a flat side, or indices into `mesh.surface.triangles`.
        traction_mpa: Force per rest area, MPa.
        points: Rest positions, mm; those of the mesh by default.
    """
    triangles = surface_triangles(discretisation, surface)
    areas = _area_vectors(discretisation, triangles, points).norm(dim=1)
    return _to_nodes(discretisation, triangles, areas[:, None] * traction_mpa)


def pressure_forces(
    discretisation: Discretisation,
    surface: str | Int[np.ndarray, " k"],
    pressure_mpa: float | Tensor,
    points: Float[Tensor, "n 3"] | None = None,
) -> Float[Tensor, "nodes 3"]:
    """Return the nodal forces (N) of a pressure (MPa) against the outward rest normals.

    See `traction_forces` for the arguments.
    """
    triangles = surface_triangles(discretisation, surface)
    vectors = _area_vectors(discretisation, triangles, points)
    return _to_nodes(discretisation, triangles, -pressure_mpa * vectors)


def gravity_forces(
    discretisation: Discretisation,
    density: float,
    gravity: Float[Tensor, "3"],
    points: Float[Tensor, "n 3"] | None = None,
) -> Float[Tensor, "nodes 3"]:
    """Return the nodal weights (N), eq. (4), of a density (tonne/mm^3) and gravity (mm/s^2)."""
    _, weights = discretisation.geometry(_rest(discretisation, points))
    at_vertex, at_midside = discretisation.element.volume_rule
    nodes = torch.from_numpy(discretisation.nodes)
    fractions = torch.tensor(
        [at_vertex] * 4 + [at_midside] * (nodes.shape[1] - 4), dtype=torch.float64
    )
    per_node = density * weights.sum(1)[:, None, None] * fractions[:, None] * gravity
    out = torch.zeros(discretisation.n_nodes, 3, dtype=torch.float64)
    return out.index_add(0, nodes.reshape(-1), per_node.reshape(-1, 3))


def _rest(discretisation: Discretisation, points: Tensor | None) -> Tensor:
    return torch.tensor(discretisation.mesh.points) if points is None else points


def _area_vectors(
    discretisation: Discretisation, triangles: np.ndarray, points: Tensor | None
) -> Tensor:
    """Outward normals times areas, (k, 3)."""
    a, b, c = _rest(discretisation, points)[torch.tensor(triangles)].unbind(1)
    return 0.5 * torch.linalg.cross(b - a, c - a)


def _to_nodes(discretisation: Discretisation, triangles: np.ndarray, totals: Tensor) -> Tensor:
    """Nodal forces of the total force of each triangle."""
    at_vertex, at_midside = discretisation.element.surface_rule
    out = torch.zeros(discretisation.n_nodes, 3, dtype=torch.float64)
    for corner in range(3):
        out = out.index_add(0, torch.from_numpy(triangles[:, corner]), at_vertex * totals)
    if at_midside:
        for corner in range(3):
            ends = triangles[:, corner], triangles[:, (corner + 1) % 3]
            nodes = torch.from_numpy(discretisation.midside(*ends))
            out = out.index_add(0, nodes, at_midside * totals)
    return out
