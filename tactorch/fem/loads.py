"""Nodal forces of pressures and tractions, differentiable in the rest positions.

Loads are dead: a pressure or traction acts per rest area, in a constant direction. Surfaces are
flat sides, such as "z+", or indices into `mesh.surface.triangles`; rest positions (mm) are those of
the mesh unless given.
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

Surface = str | Int[np.ndarray, " k"]
Points = Float[Tensor, "n 3"] | None
Forces = Float[Tensor, "nodes 3"]


def pressure_forces(
    discretisation: Discretisation,
    surface: Surface,
    pressure_mpa: float | Tensor,
    points: Points = None,
) -> Forces:
    """Return the nodal forces (N) of a pressure (MPa) against the outward rest normals."""
    triangles, vectors = area_vectors(discretisation, surface, points)
    return to_nodes(discretisation, triangles, -pressure_mpa * vectors)


def area_vectors(
    discretisation: Discretisation, surface: Surface, points: Points
) -> tuple[Int[np.ndarray, "k 3"], Float[Tensor, "k 3"]]:
    """Return the vertices of a surface's triangles, and their outward normals times areas."""
    mesh = discretisation.mesh
    selected = select_face(mesh, surface) if isinstance(surface, str) else np.asarray(surface)
    count = len(mesh.surface.triangles)
    if len(selected) == 0 or selected.min() < 0 or selected.max() >= count:
        raise ConfigError(
            f"surface {surface!r} selects no triangle or one outside 0..{count - 1}; name a flat "
            "side (x-, x+, y-, y+, z-, z+) or give indices into mesh.surface.triangles."
        )
    triangles = mesh.surface.triangles[selected]
    rest = torch.tensor(mesh.points) if points is None else points
    a, b, c = rest[torch.tensor(triangles)].unbind(1)
    return triangles, 0.5 * torch.linalg.cross(b - a, c - a)


def to_nodes(discretisation: Discretisation, triangles: np.ndarray, totals: Tensor) -> Forces:
    """Return the consistent nodal forces of the total force of each triangle."""
    at_vertex, at_midside = discretisation.element.surface_rule
    out = torch.zeros(discretisation.n_nodes, 3, dtype=torch.float64)
    for vertices in triangles.T:
        out = out.index_add(0, torch.tensor(vertices), at_vertex * totals)
    if at_midside:
        for first, second in zip(triangles.T, np.roll(triangles, -1, axis=1).T, strict=True):
            midsides = torch.from_numpy(discretisation.midside(first, second))
            out = out.index_add(0, midsides, at_midside * totals)
    return out
