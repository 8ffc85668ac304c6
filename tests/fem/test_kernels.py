"""The compiled kernels against the plain torch reference and its autograd."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from tactorch.fem import ELEMENTS, MATERIALS, Discretisation, make_material, reference
from tactorch.fem.assembly import Assembly
from tactorch.fem.materials import EnergyDerivatives, IsotropicMaterial
from tactorch.fem.materials.isotropic import LinearElastic
from tactorch.mesh import TetMesh

from .conftest import element_energy


@pytest.fixture(params=[False, True], ids=["one-poisson", "poisson-each"])
def assembly(request, cell, name, element):
    body = cell(name, element).body
    poisson = np.linspace(0.2, 0.47, body.mesh.n_tets) if request.param else 0.4
    return Assembly(body.discretisation, body.material, poisson, body.mesh.points)


@pytest.fixture(params=MATERIALS.names())
def name(request):
    return request.param


@pytest.fixture(params=ELEMENTS.names())
def element(request):
    return request.param


@pytest.fixture
def u(assembly):
    """Displacements that leave no derivative zero."""
    n = assembly.discretisation.n_nodes
    return 0.05 * np.random.default_rng(3).standard_normal((n, 3))


@pytest.fixture(params=[False, True], ids=["per_element", "per_point"])
def per_point(request):
    """Whether each quadrature point has a modulus."""
    return request.param


@pytest.fixture
def youngs(assembly, per_point):
    sizes = assembly.weights.shape if per_point else assembly.weights.shape[:1]
    return np.random.default_rng(4).uniform(0.5, 3.0, sizes)


def energies(assembly: Assembly, u: torch.Tensor, per_point: bool = False) -> torch.Tensor:
    return element_energy(assembly, u, per_point=per_point)


def test_energy(assembly, u, per_point):
    expected = energies(assembly, torch.from_numpy(u), per_point).numpy()
    energy = assembly.respond(u, per_point=per_point).energy
    np.testing.assert_allclose(energy.reshape(expected.shape), expected, rtol=1e-12, atol=1e-15)


def test_forces_are_the_gradient_of_the_energy(assembly, u, youngs, per_point):
    field = torch.from_numpy(u).requires_grad_(True)
    total = (energies(assembly, field, per_point) * torch.from_numpy(youngs)).sum()
    (expected,) = torch.autograd.grad(total, field)
    forces = assembly.internal_force(assembly.respond(u, per_point=per_point), youngs)
    np.testing.assert_allclose(forces, expected.numpy(), rtol=1e-11, atol=1e-13)


def test_tangent_is_the_hessian_of_the_energy(assembly, u, youngs, per_point):
    e = torch.from_numpy(youngs)
    total = torch.func.hessian(lambda x: (energies(assembly, x, per_point) * e).sum())
    hessian = total(torch.from_numpy(u))
    pattern = assembly.discretisation.pattern
    expected = hessian.numpy().reshape(pattern.size, pattern.size)
    response = assembly.respond(u, per_point=per_point)
    tangent = pattern.full(assembly.tangent(response, youngs)).toarray()
    np.testing.assert_allclose(tangent, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_unit_forces_scale_with_the_moduli(assembly, u, youngs, per_point):
    """Eq. 11: the assembled force is linear in the moduli, element by element."""
    response = assembly.respond(u, per_point=per_point)
    one_by_one = np.zeros_like(u)
    for j, moduli in enumerate(youngs.reshape(len(youngs), -1)):
        for e, forces in zip(moduli, response.forces[j], strict=True):
            np.add.at(one_by_one, assembly.discretisation.nodes[j], e * forces)
    np.testing.assert_allclose(assembly.internal_force(response, youngs), one_by_one, atol=1e-14)


def test_virtual_work_is_the_slope_of_the_energy(assembly, u, per_point):
    v = torch.randn(u.shape, dtype=torch.float64)
    field = torch.from_numpy(u)
    _, expected = torch.func.jvp(lambda x: energies(assembly, x, per_point), (field,), (v,))
    work = reference.element_work(assembly, field, v, per_point=per_point)
    torch.testing.assert_close(work, expected, rtol=1e-11, atol=1e-13)


def dense_blocks(assembly, u, youngs, projected):
    """Element matrices, as hessians of single elements; negative eigenvalues set to zero."""
    moduli = torch.from_numpy(youngs.reshape(len(youngs), -1))

    def element_energies(x):
        return (energies(assembly, x, youngs.ndim == 2).reshape(moduli.shape) * moduli).sum(-1)

    full = torch.func.jacfwd(torch.func.jacrev(element_energies))(torch.from_numpy(u)).numpy()
    size = assembly.discretisation.pattern.size
    total = np.zeros((size, size))
    lowest = np.inf
    for block in full.reshape(len(youngs), size, size):
        values, vectors = np.linalg.eigh(block)
        lowest = min(lowest, values[0])
        total += (vectors * np.maximum(values, 0.0 if projected else -np.inf)) @ vectors.T
    return total, lowest


@pytest.mark.parametrize("name", ["neo_hookean", "mooney_rivlin"], indirect=True)
def test_projected_tangent_drops_negative_eigenvalues_of_elements(assembly, youngs, per_point):
    n = assembly.discretisation.n_nodes
    u = 0.09 * np.random.default_rng(5).standard_normal((n, 3))
    u[:, 2] -= 0.4 * assembly.discretisation.positions[:, 2]  # compression makes it indefinite
    response = assembly.respond(u, per_point=per_point)
    assert response is not None
    expected, lowest = dense_blocks(assembly, u, youngs, projected=True)
    assert lowest < -1e-3  # else the test shows nothing
    tangent = assembly.discretisation.pattern.full(assembly.tangent(response, youngs, project=True))
    np.testing.assert_allclose(
        tangent.toarray(), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )


def test_an_inverted_element_is_refused_except_in_linear_elasticity(assembly):
    d = assembly.discretisation
    u = np.zeros((d.n_nodes, 3))
    u[:, 2] = -2.0 * d.positions[:, 2]
    linear = isinstance(assembly.material, LinearElastic)
    assert (assembly.respond(u) is not None) == linear


def test_not_a_number_is_refused(cell, element):
    body = cell("neo_hookean", element).body
    u = np.zeros((body.n_nodes, 3))
    u[0, 0] = np.nan
    assert body.assembly.respond(u) is None


def test_the_most_compressed_element_is_named(cell, element):
    body = cell("neo_hookean", element).body
    u = np.zeros((body.n_nodes, 3))
    tet = body.mesh.tets[3]
    apex = next(v for v in tet if np.count_nonzero(body.mesh.tets == v) == 1)
    u[apex] = 0.3 * (body.mesh.points[tet].mean(0) - body.mesh.points[apex])
    element_id, j = body.assembly.respond(u).smallest_volume_ratio
    assert element_id == 3
    assert 0.0 < j < 1.0


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_quadrature_fills_the_volume(cell, element):
    body = cell("neo_hookean", element).body
    np.testing.assert_allclose(body.assembly.volumes, body.mesh.volumes, rtol=1e-13)


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_shape_gradients_give_linear_fields_exactly(cell, element):
    d = cell("neo_hookean", element).body.discretisation
    A = torch.randn(3, 3, dtype=torch.float64)
    u = torch.from_numpy(d.positions) @ A.T
    gradients, _ = d.geometry(torch.tensor(d.mesh.points))
    F = reference.deformation_gradient(d, u, gradients)
    expected = torch.eye(3, dtype=torch.float64) + A
    torch.testing.assert_close(F, expected.expand_as(F), rtol=0, atol=1e-12)


def test_quadratic_fields_are_exact_on_the_quadratic_element(cell):
    d = cell("neo_hookean", "tet10").body.discretisation
    x = torch.from_numpy(d.positions)
    u = torch.stack([x[:, 0] * x[:, 1], x[:, 2] ** 2, x[:, 1] * x[:, 2]], dim=1)
    gradients, weights = d.geometry(torch.tensor(d.mesh.points))
    F = reference.deformation_gradient(d, u, gradients)
    # Averages of linear functions over a tetrahedron are their values at its centre.
    mean = (weights[..., None, None] * F).sum(1) / weights.sum(1)[:, None, None]
    cx, cy, cz = d.mesh.centroids.T
    zero = np.zeros_like(cx)
    slope = np.array([[cy, cx, zero], [zero, zero, 2.0 * cz], [zero, cz, cy]]).transpose(2, 0, 1)
    np.testing.assert_allclose(mean.numpy(), np.eye(3) + slope, atol=1e-12)


def test_patterns_hold_every_coupling_once(element):
    mesh = TetMesh.create(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float),
        np.array([[0, 1, 2, 3], [1, 2, 3, 4]]),
    )
    d = Discretisation(mesh, ELEMENTS[element])
    dense = np.zeros((d.pattern.size,) * 2, dtype=bool)
    for unknowns in d.unknowns:
        dense[np.ix_(unknowns, unknowns)] = True
    np.testing.assert_array_equal(d.pattern.full(np.ones(d.pattern.nnz)).toarray() != 0, dense)


def test_material_parameters_reach_the_kernels(cell):
    d = cell("neo_hookean", "tet4").body.discretisation
    u = 0.05 * np.random.default_rng(3).standard_normal((d.n_nodes, 3))
    made = [
        Assembly(d, make_material("neo_hookean", 0.45, lame_factor=f), 0.45, d.mesh.points)
        for f in (1.0, 0.5)
    ]
    full, half = (a.respond(u).energy for a in made)
    assert np.all(full > half)


@dataclass(frozen=True)
class EveryDerivative(IsotropicMaterial):
    """An energy of which no derivative vanishes; those of the built-in materials do in part."""

    def strain_energy(self, i1, i2, j, log_j, poisson):
        a, b, c = i1 - 3.0, i2 - 3.0, j - 1.0
        return 0.1 * a + 0.2 * b + a * b + 0.5 * b * b + a * c + b * c + 0.3 * a * a


@dataclass(frozen=True)
class InClosedForm(EveryDerivative):
    """The same, with its derivatives."""

    def strain_derivatives(self, i1, i2, j, log_j, poisson):
        a, b, c = i1 - 3.0, i2 - 3.0, j - 1.0
        return EnergyDerivatives(
            psi=self.strain_energy(i1, i2, j, log_j, poisson),
            d1=0.1 + b + c + 0.6 * a,
            d2=0.2 + a + b + c,
            dj=a + b,
            d11=0.6,
            d12=1.0,
            d1j=1.0,
            d22=1.0,
            d2j=1.0,
            djj=0.0 * j,
        )


@pytest.mark.parametrize("kind", [EveryDerivative, InClosedForm])
def test_every_derivative_reaches_the_tangent(cell, element, kind):
    d = cell("neo_hookean", element).body.discretisation
    assembly = Assembly(d, kind(0.4), 0.4, d.mesh.points)
    u = 0.05 * np.random.default_rng(3).standard_normal((d.n_nodes, 3))
    youngs = np.linspace(0.5, 2.0, d.mesh.n_tets)
    e, field = torch.from_numpy(youngs), torch.from_numpy(u).requires_grad_(True)
    response = assembly.respond(u)
    (force,) = torch.autograd.grad((energies(assembly, field) * e).sum(), field)
    np.testing.assert_allclose(
        assembly.internal_force(response, youngs), force.numpy(), rtol=1e-11, atol=1e-13
    )
    hessian = torch.func.hessian(lambda x: (energies(assembly, x) * e).sum())(torch.from_numpy(u))
    expected = hessian.numpy().reshape(d.pattern.size, -1)
    tangent = d.pattern.full(assembly.tangent(response, youngs)).toarray()
    np.testing.assert_allclose(tangent, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
