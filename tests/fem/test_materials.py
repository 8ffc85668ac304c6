"""Every material: energy against its formula, stress and tangent against autograd."""

import pytest
import torch
from torch.func import grad, vmap

from tactorch.errors import ConfigError
from tactorch.fem import MATERIALS, make_material
from tactorch.fem.materials import IsotropicMaterial

NU = 0.37
MU = 0.5 / (1.0 + NU)
LAM = 2.0 * MU * NU / (1.0 - 2.0 * NU)
KAPPA = LAM + 2.0 / 3.0 * MU
ONE = torch.eye(3, dtype=torch.float64)
FINITE_STRAIN = [name for name in MATERIALS if name != "linear"]


def trace(A):
    return A.diagonal(dim1=-2, dim2=-1).sum(-1)


def linear(F):
    strain = 0.5 * (F + F.mT) - ONE
    return 0.5 * LAM * trace(strain) ** 2 + MU * (strain * strain).sum((-2, -1))


def st_venant_kirchhoff(F):
    strain = 0.5 * (F.mT @ F - ONE)
    return 0.5 * LAM * trace(strain) ** 2 + MU * (strain * strain).sum((-2, -1))


def neo_hookean(F):
    log_j = torch.linalg.slogdet(F).logabsdet
    return 0.5 * MU * (trace(F.mT @ F) - 3.0) - MU * log_j + 0.5 * LAM * log_j**2


def volumetric(J):
    return 0.25 * KAPPA * (J**2 - 1.0 - 2.0 * torch.log(J))


def isochoric_neo_hookean(F):
    J = torch.linalg.det(F)
    G = F / J[..., None, None] ** (1.0 / 3.0)
    return 0.5 * MU * (trace(G.mT @ G) - 3.0) + volumetric(J)


def mooney_rivlin(F):
    J = torch.linalg.det(F)
    G = F / J[..., None, None] ** (1.0 / 3.0)
    C = G.mT @ G
    second = 0.5 * (trace(C) ** 2 - trace(C @ C))
    return 0.4 * MU * (trace(C) - 3.0) + 0.1 * MU * (second - 3.0) + volumetric(J)


FORMULAS = {
    "neo_hookean": neo_hookean,
    "linear": linear,
    "st_venant_kirchhoff": st_venant_kirchhoff,
    "isochoric_neo_hookean": isochoric_neo_hookean,
    "mooney_rivlin": mooney_rivlin,
}


@pytest.fixture(params=MATERIALS)
def name(request):
    return request.param


@pytest.fixture
def F():
    """Forty deformations, compressed, stretched and sheared by up to a third."""
    return ONE + 0.3 * (2.0 * torch.rand(40, 3, 3, dtype=torch.float64) - 1.0)


def rotations(count):
    Q, _ = torch.linalg.qr(torch.randn(count, 3, 3, dtype=torch.float64))
    return Q * torch.linalg.det(Q)[:, None, None]


def test_every_material_has_a_formula_here():
    assert set(FORMULAS) == set(MATERIALS)


def test_energy_is_its_formula(name, F):
    material = make_material(name, NU)
    torch.testing.assert_close(material.energy(F, NU), FORMULAS[name](F), rtol=1e-12, atol=1e-14)


def test_stress_is_the_gradient_of_the_energy(name, F):
    material = make_material(name, NU)
    expected = vmap(grad(FORMULAS[name]))(F)
    torch.testing.assert_close(material.stress(F, NU), expected, rtol=1e-11, atol=1e-12)


def test_tangent_is_the_gradient_of_the_stress(name, F):
    material = make_material(name, NU)
    expected = vmap(torch.func.jacrev(lambda A: material.stress(A, NU)))(F)
    torch.testing.assert_close(material.tangent(F, NU), expected, rtol=1e-11, atol=1e-12)


def test_tangent_is_symmetric(name, F):
    tangent = make_material(name, NU).tangent(F, NU).reshape(-1, 9, 9)
    torch.testing.assert_close(tangent, tangent.mT, rtol=0, atol=1e-13)


def test_rest_has_no_energy_and_no_stress(name):
    material = make_material(name, NU)
    assert material.energy(ONE, NU).abs() < 1e-15
    assert material.stress(ONE, NU).abs().max() < 1e-15


def test_small_strains_are_hookes(name):
    tangent = make_material(name, NU).tangent(ONE, NU)
    hooke = (
        LAM * torch.einsum("iI,jJ->iIjJ", ONE, ONE)
        + MU * torch.einsum("ij,IJ->iIjJ", ONE, ONE)
        + MU * torch.einsum("iJ,jI->iIjJ", ONE, ONE)
    )
    torch.testing.assert_close(tangent, hooke, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", FINITE_STRAIN)
def test_rotations_leave_the_energy_and_carry_the_stress(name, F):
    material, Q = make_material(name, NU), rotations(len(F))
    torch.testing.assert_close(material.energy(Q @ F, NU), material.energy(F, NU))
    torch.testing.assert_close(material.stress(Q @ F, NU), Q @ material.stress(F, NU))
    assert (Q - ONE).abs().amax((1, 2)).min() > 0.1


@pytest.mark.parametrize("name", FINITE_STRAIN)
def test_no_direction_is_special(name, F):
    material, Q = make_material(name, NU), rotations(len(F))
    torch.testing.assert_close(material.energy(F @ Q, NU), material.energy(F, NU))


def test_poisson_may_differ_by_point(name, F):
    material = make_material(name, NU)
    ratios = torch.linspace(0.1, 0.49, len(F), dtype=torch.float64)
    each = torch.stack([material.stress(A, nu) for A, nu in zip(F, ratios, strict=True)])
    torch.testing.assert_close(material.stress(F, ratios), each, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    "name", [n for n, made in MATERIALS.items() if issubclass(made, IsotropicMaterial)]
)
def test_averaged_stress_of_a_uniform_element_is_the_plain_one(name, F):
    material = make_material(name, NU)
    four = F[:, None].expand(-1, 4, 3, 3)
    weights = torch.rand(len(F), 4, dtype=torch.float64)
    averaged = material.averaged_stress(four, weights, torch.tensor(NU, dtype=torch.float64))
    torch.testing.assert_close(averaged, material.stress(four, NU), rtol=1e-12, atol=1e-13)


def test_lame_factor_scales_the_part_in_lambda(F):
    half = make_material("neo_hookean", NU, lame_factor=0.5).energy(F, NU)
    log_j = torch.linalg.slogdet(F).logabsdet
    torch.testing.assert_close(neo_hookean(F) - half, 0.25 * LAM * log_j**2)


def test_second_fraction_moves_between_the_invariants(F):
    first = make_material("mooney_rivlin", NU, second_fraction=0.0)
    torch.testing.assert_close(first.energy(F, NU), isochoric_neo_hookean(F))
    second = make_material("mooney_rivlin", NU, second_fraction=1.0)
    mixed = 0.8 * first.energy(F, NU) + 0.2 * second.energy(F, NU)
    torch.testing.assert_close(mixed, mooney_rivlin(F))


@pytest.mark.parametrize("poisson", [0.5, -1.0, 0.6, float("nan")])
def test_impossible_poisson_is_refused(name, poisson):
    with pytest.raises(ConfigError, match=rf"poisson={poisson}.*outside"):
        make_material(name, poisson)


def test_unknown_material_is_refused_with_the_choices():
    with pytest.raises(ConfigError, match=r"'ogden' is unknown.*neo_hookean.*mooney_rivlin"):
        make_material("ogden", NU)


def test_unknown_parameter_is_refused():
    with pytest.raises(ConfigError, match=r"'linear'.*lame_factor"):
        make_material("linear", NU, lame_factor=0.5)


def test_fraction_out_of_range_is_refused():
    with pytest.raises(ConfigError, match=r"second_fraction=1.5"):
        make_material("mooney_rivlin", NU, second_fraction=1.5)
