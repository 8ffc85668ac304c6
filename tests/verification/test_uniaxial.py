"""Uniaxial compression with free sides: the field is uniform, so exact on any mesh.

The stretches solve dW/d(stretch) = -0.2 and dW/d(lateral) = 0 for the paper's energy, E = 1.
"""

import numpy as np
import pytest
import torch

from tactorch.fem import ELEMENTS, SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh, face_nodes

# Poisson's ratio, stretch, lateral stretch, d stretch / dE.
TABLE = [
    (0.30, 0.828310984658, 1.056797425871, 0.146032430),
    (0.45, 0.833017354831, 1.084927637795, 0.138215681),
    (0.49, 0.834457641796, 1.092545793302, 0.135834064),
]


@pytest.fixture(params=["5", "6", "skewed"])
def mesh(request):
    """The unit cube in three meshes."""
    if request.param != "skewed":
        return box_mesh(1.0, 2, tets_per_cell=int(request.param))
    grid = box_mesh(1.0, 3)
    inner = ((grid.points > 0) & (grid.points < 1)).all(axis=1)
    noise = np.random.default_rng(0).uniform(-0.1, 0.1, grid.points.shape)
    return TetMesh(grid.points + inner[:, None] * noise, grid.tets)


def on_rollers(mesh):
    """Each low side slides in its plane."""
    return Supports(fixed=mesh.points < 1e-9)


@pytest.mark.parametrize(("poisson", "stretch", "lateral", "slope"), TABLE)
@pytest.mark.parametrize("element", ELEMENTS.names())
def test_uniaxial_compression(mesh, element, poisson, stretch, lateral, slope):
    body = SoftBody(mesh, make_material("neo_hookean", poisson), element=element)
    youngs = torch.ones(mesh.n_tets, dtype=torch.float64, requires_grad=True)
    u = body.solve(youngs, body.traction("z+", [0.0, 0.0, -0.2]), on_rollers(mesh))
    top, side = (torch.from_numpy(face_nodes(mesh, face)) for face in ("z+", "x+"))
    mean = u[top, 2].mean()
    mean.backward()
    assert 1.0 + mean.item() == pytest.approx(stretch, abs=1e-8)
    np.testing.assert_allclose(1.0 + u[top, 2].detach(), stretch, rtol=0, atol=1e-8)
    np.testing.assert_allclose(1.0 + u[side, 0].detach(), lateral, rtol=0, atol=1e-8)
    assert youngs.grad.sum().item() == pytest.approx(slope, abs=1e-8)


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_halved_lambda_is_another_material(element):
    """`lame_factor` 0.5 at nu = 0.3 has half the lambda: nu' = lambda'/(2 (lambda' + mu))."""
    lam, mu = 0.3 / (1.3 * 0.4) / 2.0, 0.5 / 1.3
    poisson = lam / (2.0 * (lam + mu))
    scale = 2.0 * mu * (1.0 + poisson)  # its Young's modulus
    mesh = box_mesh(1.0, 2)
    found = []
    for material, youngs in (
        (make_material("neo_hookean", 0.3, lame_factor=0.5), 1.0),
        (make_material("neo_hookean", poisson), scale),
    ):
        body = SoftBody(mesh, material, element=element)
        forces = body.traction("z+", [0.0, 0.0, -0.2]).numpy()
        e = np.full(mesh.n_tets, youngs)
        found.append(body.equilibrate(e, forces, on_rollers(mesh)).displacement)
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-9)
