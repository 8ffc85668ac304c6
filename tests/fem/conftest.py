from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tactorch.fem import ELEMENTS, MATERIALS, SoftBody, Supports, make_material, reference
from tactorch.fem.assembly import Assembly
from tactorch.fem.materials.base import invariants
from tactorch.mesh import TetMesh, box_mesh, face_nodes


def clamp(mesh: TetMesh, *faces: str) -> np.ndarray:
    """Mark all degrees of freedom of whole faces."""
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    for face in faces:
        fixed[face_nodes(mesh, face)] = True
    return fixed


def element_energy(
    body: Assembly,
    u: Tensor,
    poisson: Tensor | None = None,
    points: Tensor | None = None,
    *,
    per_point: bool = False,
) -> Tensor:
    """Energy of each element, or of its points, per unit modulus, mm^3 (eq. 2 times volume)."""
    rest = torch.tensor(body.points) if points is None else points
    gradients, weights = body.discretisation.geometry(rest)
    F = reference.deformation_gradient(body.discretisation, u, gradients)
    nu = torch.as_tensor(body.poisson if poisson is None else poisson, dtype=torch.float64)
    nu, material = nu[..., None] if nu.ndim else nu, body.material
    if body.averages_volume:
        i1, i2, j = invariants(F)
        mean = (weights * j).sum(-1, keepdim=True) / weights.sum(-1, keepdim=True)
        volumetric = material.volumetric_energy(mean, torch.log(mean), nu)
        energy = weights * (material.strain_energy(i1, i2, j, torch.log(j), nu) + volumetric)
    else:
        energy = weights * material.energy(F, nu)
    return energy if per_point else energy.sum(-1)


@dataclass(frozen=True, eq=False)
class Cell:
    """One skewed cell of five tetrahedra on springs, pressed and sheared: two load cases."""

    body: SoftBody
    supports: Supports
    inputs: dict[str, Tensor]

    def solve(self, **inputs: Tensor) -> Tensor:
        """Displacements at these inputs, the cell's own where not given."""
        given = {**self.inputs, **inputs}
        return self.body.solve(
            given["youngs"],
            given["forces"],
            self.supports,
            poisson=given["poisson"],
            points=given["points"],
        )

    def energy(self, u: Tensor, case: int) -> Tensor:
        """Total energy of a load case in plain torch operations (eq. 2 to 5)."""
        d = self.body.discretisation
        e, nu, x = (self.inputs[k] for k in ("youngs", "poisson", "points"))
        energy = element_energy(self.body.assembly, u, nu, x, per_point=e.ndim == 2)
        elastic = (energy * e).sum()
        springs = 0.5 * (torch.from_numpy(self.supports.case(case, d).springs) * u * u).sum()
        return elastic + springs - (self.inputs["forces"][case] * u).sum()


@cache
def make_cell(material: str, element: str, per_point: bool = False) -> Cell:
    grid = box_mesh(1.0, 1, tets_per_cell=5)
    rng = np.random.default_rng(0)
    mesh = TetMesh(grid.points + rng.uniform(-0.08, 0.08, grid.points.shape), grid.tets)
    body = SoftBody(mesh, make_material(material, 0.4), element=element)
    flat = SoftBody(grid, body.material, element=element)  # loads of the straight cell
    sizes = body.assembly.weights.shape if per_point else mesh.n_tets
    springs = np.zeros((mesh.n_points, 3))
    springs[face_nodes(grid, "z-")] = 0.5
    loads = torch.stack([flat.pressure("z+", 0.04), flat.traction("x+", [0.01, 0.02, 0.03])])
    return Cell(
        body,
        Supports(springs=springs),
        {
            "youngs": torch.tensor(rng.uniform(1.0, 2.0, sizes)),
            "poisson": torch.tensor(0.4, dtype=torch.float64),
            "forces": loads,
            "points": torch.tensor(mesh.points),
        },
    )


def _pairs() -> list[Any]:
    """Materials and elements know nothing of each other: each once, and the rest when slow."""
    return [
        pytest.param(
            (material, element),
            id=f"{material}-{element}",
            marks=[] if element == "tet4" or material == "neo_hookean" else [pytest.mark.slow],
        )
        for material in MATERIALS.names()
        for element in ELEMENTS.names()
    ]


@pytest.fixture(params=_pairs())
def pair(request: pytest.FixtureRequest) -> tuple[str, str]:
    """Return the names of a material and an element."""
    return request.param


@pytest.fixture
def name(pair: tuple[str, str]) -> str:
    """Return the name of the material."""
    return pair[0]


@pytest.fixture
def element(pair: tuple[str, str]) -> str:
    """Return the name of the element."""
    return pair[1]


@pytest.fixture(scope="session")
def cell() -> Callable[..., Cell]:
    """Make a cell of a material and an element; `per_point`: a modulus at each quadrature point."""
    return make_cell


@pytest.fixture(scope="session")
def clamped() -> Callable[..., np.ndarray]:
    """Mark all degrees of freedom of named faces of a mesh."""
    return clamp


@pytest.fixture(scope="session")
def block() -> TetMesh:
    """A 10 mm cube of 135 tetrahedra."""
    return box_mesh(10.0, 3, tets_per_cell=5)
