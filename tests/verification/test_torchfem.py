"""Agreement with torch-fem: an independent code, its energies written by hand, its own autodiff."""

import numpy as np
import pytest
import torch

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh, face_nodes

torchfem = pytest.importorskip("torchfem")
from torchfem.materials import Hyperelastic3D  # noqa: E402

NU = 0.45
MU = 0.5 / (1.0 + NU)
LAM = 2.0 * MU * NU / (1.0 - 2.0 * NU)
KAPPA = LAM + 2.0 / 3.0 * MU
ONE = torch.eye(3, dtype=torch.float64)


def log_volume(C):
    return 0.5 * torch.logdet(C)  # torch-fem's advice: det's second derivative is not finite


def volumetric(log_j):
    return 0.25 * KAPPA * (torch.exp(2.0 * log_j) - 1.0 - 2.0 * log_j)


def neo_hookean(C):
    log_j = log_volume(C)
    return 0.5 * MU * (C.trace() - 3.0) - MU * log_j + 0.5 * LAM * log_j**2


def st_venant_kirchhoff(C):
    strain = 0.5 * (C - ONE)
    return 0.5 * LAM * strain.trace() ** 2 + MU * (strain * strain).sum()


def isochoric_neo_hookean(C):
    log_j = log_volume(C)
    return 0.5 * MU * (torch.exp(-2.0 / 3.0 * log_j) * C.trace() - 3.0) + volumetric(log_j)


def mooney_rivlin(C):
    log_j = log_volume(C)
    first = torch.exp(-2.0 / 3.0 * log_j) * C.trace()
    second = torch.exp(-4.0 / 3.0 * log_j) * 0.5 * (C.trace() ** 2 - (C * C).sum())
    return 0.4 * MU * (first - 3.0) + 0.1 * MU * (second - 3.0) + volumetric(log_j)


ENERGIES = {
    "neo_hookean": neo_hookean,
    "st_venant_kirchhoff": st_venant_kirchhoff,
    "isochoric_neo_hookean": isochoric_neo_hookean,
    "mooney_rivlin": mooney_rivlin,
}


@pytest.fixture(autouse=True)
def double_precision():
    """torch-fem makes its arrays in the default type."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)


@pytest.fixture(scope="module")
def mesh():
    grid = box_mesh(10.0, 3, tets_per_cell=5)
    inner = ((grid.points > 0) & (grid.points < 10)).all(axis=1)
    noise = np.random.default_rng(0).uniform(-0.8, 0.8, grid.points.shape)
    return TetMesh(grid.points + inner[:, None] * noise, grid.tets)


@pytest.fixture(scope="module")
def youngs(mesh):
    """Soft tissue with a stiff corner, MPa."""
    return torch.tensor(np.where(mesh.centroids.min(axis=1) > 4.0, 1.0, 0.2))


@pytest.fixture(scope="module")
def clamped(mesh):
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    return fixed


def by_torchfem(nodes, elements, energy, youngs, forces, fixed):
    """Displacement and the gradient of its weighted sum."""
    e = youngs.clone().requires_grad_(True)
    model = torchfem.Solid(torch.tensor(nodes), torch.tensor(elements), None)
    model.material = Hyperelastic3D(lambda F, p: p[0] * energy(F.T @ F), e[:, None])
    model.forces = forces
    model.constraints = torch.tensor(fixed)
    u = model.solve(rtol=1e-12, atol=1e-30, method="direct", differentiable_parameters=e)[0]
    return finish(u, e)


def by_tactorch(body, youngs, forces, supports):
    e = youngs.clone().requires_grad_(True)
    return finish(body.solve(e, forces, supports), e)


def finish(u, e):
    weights = torch.linspace(-1.0, 1.0, u.numel()).reshape(u.shape)
    return u.detach(), torch.autograd.grad((weights * u).sum(), e)[0]


def close(ours, theirs, tolerance):
    for mine, other in zip(ours, theirs, strict=True):
        assert other.abs().max() > 0.05
        assert (mine - other).abs().max() < tolerance * other.abs().max()


@pytest.mark.parametrize("name", ENERGIES)
def test_displacement_and_gradient_agree(name, mesh, youngs, clamped):
    body = SoftBody(mesh, make_material(name, NU))
    forces = body.traction("z+", [0.004, 0.0, -0.015])
    ours = by_tactorch(body, youngs, forces, Supports(fixed=clamped))
    theirs = by_torchfem(mesh.points, mesh.tets, ENERGIES[name], youngs, forces, clamped)
    close(ours, theirs, 1e-8)


def test_stiff_springs_agree_with_their_clamped_boundary(mesh, youngs, clamped):
    body = SoftBody(mesh, make_material("neo_hookean", NU))
    forces = body.traction("z+", [0.004, 0.0, -0.015])
    ours = by_tactorch(body, youngs, forces, Supports(springs=1e10 * clamped))
    theirs = by_torchfem(mesh.points, mesh.tets, neo_hookean, youngs, forces, clamped)
    close(ours, theirs, 1e-8)


def test_quadratic_elements_agree(mesh, youngs, clamped):
    """Saint Venant-Kirchhoff has no dilatation to average, so both elements are the plain one."""
    body = SoftBody(mesh, make_material("st_venant_kirchhoff", NU), element="tet10")
    d = body.discretisation
    # Midsides stand on edges 01 02 03 12 13 23 here, on 01 12 02 03 13 23 there.
    elements = d.nodes[:, [0, 1, 2, 3, 4, 7, 5, 6, 8, 9]]
    forces = body.traction("z+", [0.003, 0.0, -0.01])
    fixed = np.zeros((d.n_nodes, 3), dtype=bool)
    fixed[d.positions[:, 2] == 0.0] = True
    ours = by_tactorch(body, youngs, forces, Supports(fixed=clamped))
    theirs = by_torchfem(d.positions, elements, st_venant_kirchhoff, youngs, forces, fixed)
    close(ours, theirs, 5e-8)  # torch-fem writes its quadrature points to eight digits
