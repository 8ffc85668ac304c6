"""Every material: energy against its formula, stress and tangent against autograd."""

from dataclasses import dataclass

import pytest
import torch
from torch.func import grad, vmap

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.fem import MATERIALS, NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.materials import IsotropicMaterial, Material, lame
from tactorch.fem.materials.base import invariants

NU = 0.37
MU = 0.5 / (1.0 + NU)
LAM = 2.0 * MU * NU / (1.0 - 2.0 * NU)
KAPPA = LAM + 2.0 / 3.0 * MU
ONE = torch.eye(3, dtype=torch.float64)
FINITE_STRAIN = [name for name in MATERIALS.names() if name != "linear"]


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


@pytest.fixture(params=MATERIALS.names())
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
    assert set(FORMULAS) == set(MATERIALS.names())


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


@pytest.mark.parametrize("poisson", [NU, torch.linspace(0.1, 0.49, 40, dtype=torch.float64)])
def test_closed_forms_are_the_derivatives_by_autograd(name, F, poisson):
    material = make_material(name, NU)
    if not isinstance(material, IsotropicMaterial):
        stress, tangent = (
            Material.stress(material, F, poisson),
            Material.tangent(material, F, poisson),
        )
        torch.testing.assert_close(material.stress(F, poisson), stress, rtol=1e-12, atol=1e-13)
        torch.testing.assert_close(material.tangent(F, poisson), tangent, rtol=1e-12, atol=1e-13)
        return
    i1, i2, j = invariants(F)
    for method, arguments in (
        ("strain_derivatives", (i1, i2, j, torch.log(j), poisson)),
        ("volumetric_derivatives", (j, torch.log(j), poisson)),
    ):
        closed = getattr(material, method)(*arguments)
        general = getattr(IsotropicMaterial, method)(material, *arguments)
        for ours, expected in zip(closed, general, strict=True):
            ours, expected = (
                torch.as_tensor(x, dtype=F.dtype).expand(40) for x in (ours, expected)
            )
            torch.testing.assert_close(ours, expected, rtol=1e-11, atol=1e-12)


@dataclass(frozen=True)
class Exponential(IsotropicMaterial):
    """A strain energy and nothing else: Fung's exponential with a volumetric part."""

    b: float = option(2.0, "Stiffening", gt=0.0)

    def strain_energy(self, i1, i2, j, log_j, poisson):
        _, mu = lame(poisson)
        return 0.5 * mu / self.b * torch.expm1(self.b * (i1 - 3.0)) - mu * log_j

    def volumetric_energy(self, j, log_j, poisson):
        return 0.5 * lame(poisson)[0] * log_j**2


@dataclass(frozen=True)
class OfTheGradient(Material):
    """The same as a function of F."""

    def energy(self, F, poisson):
        return Exponential(self.poisson).energy(F, poisson)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_a_strain_energy_suffices_for_equilibria_and_gradients(block, clamped, element):
    material = Exponential(0.4)
    body = SoftBody(block, material, element=element, newton=NewtonOptions(rtol=1e-12))
    youngs = torch.full((block.n_tets,), 1.0, dtype=torch.float64, requires_grad=True)
    held = Supports(fixed=clamped(block, "z-"))
    forces = body.pressure("z+", 0.05)
    weights = torch.linspace(-1.0, 1.0, body.n_nodes, dtype=torch.float64)[:, None]

    def measure(e):
        return (weights * body.solve(e, forces, held)).sum()

    (gradient,) = torch.autograd.grad(measure(youngs), youngs)
    step = torch.zeros_like(gradient)
    step[17] = 1e-4
    with torch.no_grad():
        slope = (measure(youngs + step) - measure(youngs - step)) / 2e-4
    torch.testing.assert_close(gradient[17], slope, rtol=1e-5, atol=1e-9)
    if element == "tet4":  # as a function of F no volumetric part is known to be averaged
        general = SoftBody(block, OfTheGradient(0.4))
        torch.testing.assert_close(
            general.solve(youngs, forces, held), body.solve(youngs, forces, held),
            rtol=0, atol=1e-8,
        )  # fmt: skip


def test_a_registered_material_is_known_by_name(monkeypatch):
    monkeypatch.setattr(MATERIALS, "_added", {})
    MATERIALS.register("exponential", Exponential)
    assert make_material("exponential", 0.4, b=3.0) == Exponential(0.4, 3.0)
    with pytest.raises(ConfigError, match=r"material.b=-1.0: give a number above 0"):
        make_material("exponential", 0.4, b=-1.0)


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
    with pytest.raises(
        ConfigError, match=rf"material.poisson={poisson}: give a number above -1, below 0.5"
    ):
        make_material(name, poisson)


def test_unknown_material_is_refused_with_the_choices():
    with pytest.raises(ConfigError, match=r"material=ogden is unknown.*neo_hookean.*mooney_rivlin"):
        make_material("ogden", NU)


def test_unknown_parameter_is_refused():
    with pytest.raises(ConfigError, match=r"material.lame_factor'.*linear"):
        make_material("linear", NU, lame_factor=0.5)


def test_fraction_out_of_range_is_refused():
    with pytest.raises(ConfigError, match=r"second_fraction=1.5"):
        make_material("mooney_rivlin", NU, second_fraction=1.5)
