"""Boundary conditions of a body: supports, and nodal forces of pressures and tractions.

Loads are dead: a pressure or traction acts per rest area, in a constant direction. Surfaces are
flat sides, such as "z+", or indices into `mesh.surface.triangles`; rest positions (mm) are those of
the mesh unless given.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
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
    nodes = discretisation.surface_nodes(triangles).T  # vertices, then midsides
    shares = np.repeat(discretisation.element.surface_rule, 3)[: len(nodes)]
    forces = torch.from_numpy(shares)[:, None, None] * totals
    out = torch.zeros(discretisation.n_nodes, 3, dtype=torch.float64)
    return out.index_add(0, torch.tensor(nodes.ravel()), forces.reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class Supports:
    """Supported degrees of freedom of one load case, or of several along the first axis.

    Attributes:
        fixed: Degrees of freedom with a prescribed displacement.
        prescribed: Prescribed displacement, mm; zero by default.
        springs: Stiffness k of zero-length springs to the rest position, N/mm: the energy is
            k u^2 / 2 per degree of freedom (eq. 3 with k_c = 1000 N/m read as the stiffness).
            Given at all nodes, midside nodes included, they are not redistributed.
    """

    fixed: Bool[np.ndarray, "*cases n 3"] | None = None
    prescribed: Float[np.ndarray, "*cases n 3"] | None = None
    springs: Float[np.ndarray, "*cases nodes 3"] | None = None

    def require_cases(self, count: int) -> None:
        """Raise ConfigError unless the supports are for `count` load cases, or for all."""
        for name in ("fixed", "prescribed", "springs"):
            values = getattr(self, name)
            if values is not None and values.ndim == 3 and len(values) != count:
                raise ConfigError(
                    f"supports.{name} has {len(values)} load cases but forces have {count}; "
                    "give one each, or (n, 3) for all."
                )

    def case(self, index: int, discretisation: Discretisation) -> "CaseSupports":
        """Return the supports of one load case at all nodes, midside nodes included."""
        fixed = self._field("fixed", index, discretisation).astype(bool)
        prescribed = self._field("prescribed", index, discretisation)
        springs = self._field("springs", index, discretisation)
        if np.any(springs < 0) or not np.all(np.isfinite(springs)):
            raise ConfigError("supports.springs must be finite and not negative (N/mm).")
        if not np.all(np.isfinite(prescribed[fixed])):
            raise ConfigError(
                "supports.prescribed is not finite at a fixed degree of freedom (mm)."
            )
        # Midside nodes are fixed where both ends are.
        all_fixed = np.concatenate([fixed, fixed[discretisation.edges].all(axis=1)])
        extended = discretisation.extend(np.where(fixed, prescribed, 0.0))
        return CaseSupports(
            all_fixed, np.where(all_fixed, extended, 0.0), discretisation.distributed(springs)
        )

    def _field(self, name: str, index: int, discretisation: Discretisation) -> np.ndarray:
        values, n = getattr(self, name), discretisation.mesh.n_points
        if values is None:
            return np.zeros((n, 3))
        rows = (n, discretisation.n_nodes) if name == "springs" else (n,)
        if values.ndim not in (2, 3) or values.shape[-2] not in rows or values.shape[-1] != 3:
            others = f" (or all {rows[1]} element nodes)" if len(rows) > 1 else ""
            raise ConfigError(
                f"supports.{name} has shape {values.shape}; expected ({n}, 3), one row per mesh "
                f"node{others}, or (cases, {n}, 3)."
            )
        return values if values.ndim == 2 else values[index]


class CaseSupports(NamedTuple):
    """Supports of one load case at all nodes of a discretisation; see `Supports`."""

    fixed: Bool[np.ndarray, "nodes 3"]
    prescribed: Float[np.ndarray, "nodes 3"]
    springs: Float[np.ndarray, "nodes 3"]
