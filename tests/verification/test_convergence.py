"""Refinement: errors against a manufactured solution fall at the rate theory promises.

The solution vanishes on the whole boundary; the body force that makes it an equilibrium is the
divergence of the stress, by autograd, and is integrated with the four-point rule.
"""

import numpy as np
import pytest
import torch
from torch.func import jacfwd, vmap

from tactorch.fem import ELEMENTS, MATERIALS, SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh

NU = 0.3
NEAR, FAR = 0.5854101966249685, 0.1381966011250105
AMPLITUDE = torch.tensor([0.05, -0.03, 0.04], dtype=torch.float64)


def exact(x):
    return AMPLITUDE * torch.sin(np.pi * x).prod()


def body_force(x, material):
    """Force per rest volume at one point for E = 1: minus the divergence of the stress."""

    def stress(y):
        return material.stress(torch.eye(3, dtype=torch.float64) + jacfwd(exact)(y), NU)

    return -jacfwd(stress)(x).diagonal(dim1=1, dim2=2).sum(-1)


def shapes(quadratic):
    """Shape functions at the four points, (points, nodes)."""
    L = FAR + (NEAR - FAR) * np.eye(4)
    if not quadratic:
        return L
    edges = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    middles = np.stack([4.0 * L[:, a] * L[:, b] for a, b in edges], axis=1)
    return np.concatenate([L * (2.0 * L - 1.0), middles], axis=1)


def mesh_of(divisions):
    """A unit cube whose inner nodes are off the grid."""
    grid = box_mesh(1.0, divisions, tets_per_cell=5)
    points = np.array(grid.points)
    inner = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    noise = np.random.default_rng(0).uniform(-0.1, 0.1, points.shape) / divisions
    return TetMesh(points + np.where(inner[:, None], noise, 0.0), grid.tets), ~inner


def error(material, element, divisions):
    """Norm in L2 of the difference from the manufactured solution."""
    mesh, boundary = mesh_of(divisions)
    body = SoftBody(mesh, material, element=element)
    d = body.discretisation
    N = shapes(d.element.quadratic)
    L = shapes(False)
    x = torch.from_numpy(np.einsum("qc,mci->mqi", L, mesh.points[mesh.tets])).reshape(-1, 3)
    force = vmap(lambda y: body_force(y, material))(x).reshape(-1, 4, 3).numpy()
    weights = np.repeat(mesh.volumes[:, None], 4, axis=1) / 4.0
    forces = np.zeros((d.n_nodes, 3))
    np.add.at(forces, d.nodes, np.einsum("mq,qa,mqi->mai", weights, N, force))
    supports = Supports(fixed=np.repeat(boundary[:, None], 3, axis=1))
    found = body.equilibrate(np.ones(mesh.n_tets), forces, supports)
    assert found.converged, found.reason
    u = np.einsum("qa,mai->mqi", N, found.displacement[d.nodes])
    truth = vmap(exact)(x).reshape(-1, 4, 3).numpy()
    return np.sqrt((weights * ((u - truth) ** 2).sum(-1)).sum())


@pytest.mark.parametrize(
    ("name", "element", "order", "below"),
    [
        # Linear elements: order 2.
        ("neo_hookean", "tet4", 1.99, 1.2e-3),
        # Quadratic ones: order 3 where the whole energy is taken point by point ...
        pytest.param("st_venant_kirchhoff", "tet10", 2.95, 2.7e-4, marks=pytest.mark.slow),
        # ... and 2 at last where the dilatation is averaged: the price of not locking.
        ("neo_hookean", "tet10", 2.54, 3.2e-4),
    ],
)
def test_errors_fall_at_the_rate_of_the_element(name, element, order, below):
    material = make_material(name, NU)
    coarse, fine = (error(material, element, n) for n in (4, 8))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.1)
    assert fine < below


@pytest.mark.slow
@pytest.mark.parametrize("name", MATERIALS.names())
@pytest.mark.parametrize("element", ELEMENTS.names())
def test_rates_of_all_materials(name, element):
    material = make_material(name, NU)
    sizes = (8, 12) if element == "tet10" else (8, 16)
    coarse, fine = (error(material, element, n) for n in sizes)
    rate = np.log(coarse / fine) / np.log(sizes[1] / sizes[0])
    pointwise = name in ("linear", "st_venant_kirchhoff")
    assert rate > (2.9 if element == "tet10" and pointwise else 1.9)
