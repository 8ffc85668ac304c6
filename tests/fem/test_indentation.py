"""Presses of a ball at many places of a linear body, against analytic solutions."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact.pressures import (
    ball_force,
    contact_coefficients,
    contact_radius,
    disc_rule,
    half_space_compliance,
    restriction_ratio,
)
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.mesh import box_mesh, face_nodes

BALL = 3.0
UP = np.array([0.0, 0.0, 1.0])


def block(width: float, height: float, edge: float, poisson: float = 0.45) -> tuple:
    counts = [round(width / edge), round(width / edge), max(round(height / edge), 2)]
    mesh = box_mesh(
        (width, width, height), counts, center_mm=(0.0, 0.0, -height / 2), tets_per_cell=5
    )
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    nothing = np.zeros((mesh.n_points, 3))
    body = SoftBody(mesh, make_material("linear", poisson), element="tet10")
    return body, Supports(fixed, nothing, nothing)


def places(*positions: tuple[float, float], deepest: float = 1.5) -> list[BallPlace]:
    return [BallPlace(np.array([x, y, 0.0]), UP, BALL, deepest) for x, y in positions]


def test_a_hertz_profile_has_its_moments() -> None:
    radii, directions, weights = disc_rule()
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ radii**2 == pytest.approx(0.4)
    assert np.abs(weights @ (radii[:, None] * directions)).max() < 1e-12


def test_a_single_profile_of_the_right_radius_is_hertz_contact() -> None:
    ball, depth = 100.0, 0.01
    radius = np.array([np.sqrt(ball * depth)])
    compliance = half_space_compliance(radius[None], 0.3)
    mean = np.array([[depth - 0.2 * radius[0] ** 2 / ball]])
    force = contact_coefficients(compliance, mean)[0].sum()
    hertz = 4.0 / 3.0 / (1.0 - 0.3**2) * np.sqrt(ball) * depth**1.5
    assert force == pytest.approx(hertz, rel=1e-9)


def test_the_force_on_a_ball_is_that_of_hertz_at_small_depths_and_less_at_large() -> None:
    small, large = np.array([1e-4]), np.array([1.5])
    hertz = [4.0 / 3.0 * np.sqrt(BALL) * d**1.5 for d in (small, large)]
    assert ball_force(small, BALL) == pytest.approx(hertz[0], rel=1e-4)
    # The radius of contact a from the depth by Sneddon's eq., solved here by hand: a = 1.967 mm.
    a = 1.9672
    depth = 0.5 * a * np.log((BALL + a) / (BALL - a))
    force = 0.5 * ((a**2 + BALL**2) * np.log((BALL + a) / (BALL - a)) - 2.0 * a * BALL)
    assert ball_force(np.array([depth]), BALL)[0] == pytest.approx(force, rel=1e-3)
    assert contact_radius(np.array([depth]), BALL)[0] == pytest.approx(a, rel=1e-3)
    assert contact_radius(small, BALL) == pytest.approx(np.sqrt(BALL * small), rel=1e-3)
    assert ball_force(large, BALL)[0] < hertz[1][0]
    assert not ball_force(np.array([-1.0, 0.0]), BALL).any()


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_pressures_have_the_least_energy_that_does_not_pull(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size)) + 2.0 * np.eye(size)
    matrix, depth = root.T @ root, rng.standard_normal(size)
    found, rates = contact_coefficients(matrix[None], depth[None])
    expected, _ = nnls(root, np.linalg.solve(root.T, depth))
    assert found[0] == pytest.approx(expected, rel=1e-9, abs=1e-6)
    step = 1e-6
    moved, _ = contact_coefficients(matrix[None], depth[None] + step)
    if ((found > 0.0) == (moved > 0.0)).all():
        assert (moved - found)[0] / step == pytest.approx(rates[0], abs=1e-3, rel=1e-3)


def test_the_restriction_to_few_profiles_costs_little() -> None:
    depths = np.linspace(0.3, 1.5, 13)
    radii = contact_radius(depths[-1:], BALL) * np.array([1.0, 0.72, 0.48])
    many = np.broadcast_to(radii, (13, 3))
    ratios = restriction_ratio(many, np.full(13, BALL), depths)
    assert np.abs(ratios - 1.0).max() < 0.06


def layer_factor(poisson: float, chi: float) -> float:
    """E. K. Dimitriadis et al., Biophys. J. 82 (2002), p. 2798: a bonded layer."""
    nu, pi = poisson, np.pi
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
    terms = (
        1.0,
        -2.0 * a / pi * chi,
        4.0 * a**2 / pi**2 * chi**2,
        -8.0 / pi**3 * (a**3 + 4.0 * pi**2 / 15.0 * b) * chi**3,
        16.0 * a / pi**4 * (a**3 + 3.0 * pi**2 / 5.0 * b) * chi**4,
    )
    return float(sum(terms))


@pytest.mark.parametrize(("edge", "poisson"), [(2.5, 0.3), (2.5, 0.45), (2.0, 0.49)])
def test_the_force_on_a_bonded_layer(edge: float, poisson: float) -> None:
    height, depth, modulus = 10.0, 0.4, 0.1
    body, supports = block(36.0, height, edge, poisson)
    depths = np.array([depth])
    indented = Indentation(body, supports, places((0.6, -0.4), deepest=depth)).at(
        np.full(body.mesh.n_tets, modulus)
    )
    thin = layer_factor(poisson, np.sqrt(BALL * depth) / height)
    assert thin > 1.1
    expected = modulus / (1.0 - poisson**2) * ball_force(depths, BALL) * thin
    assert indented.press(np.array([0]), depths).force_n == pytest.approx(expected, rel=0.025)


def test_the_force_hardly_depends_on_the_mesh_or_the_place_on_it() -> None:
    depths, which = np.array([0.5, 1.5] * 3), np.repeat([0, 1, 2], 2)
    where = places((0.0, 0.0), (0.7, 1.1), (-1.6, 0.4))
    forces = []
    for edge in (3.0, 2.0):
        body, supports = block(24.0, 12.0, edge)
        indented = Indentation(body, supports, where).at(np.full(body.mesh.n_tets, 0.1))
        forces.append(indented.press(which, depths).force_n.reshape(3, 2))
    assert np.abs(forces[0] / forces[1] - 1.0).max() < 0.02
    assert np.abs(forces[0] / forces[0].mean(axis=0) - 1.0).max() < 0.02


@pytest.mark.parametrize("per_point", [False, True])
def test_derivatives_by_the_moduli(per_point: bool) -> None:
    body, supports = block(18.0, 9.0, 3.0)
    indentation = Indentation(body, supports, places((0.0, 0.0), (1.0, 2.0)))
    rng = np.random.default_rng(0)
    shape = body.assembly.weights.shape if per_point else body.assembly.weights.shape[:1]
    youngs = 0.1 * np.exp(0.3 * rng.standard_normal(shape))
    change = youngs * rng.standard_normal(shape)
    which, depths = np.array([0, 0, 1, 1]), np.array([0.5, 1.4, 0.4, 1.5])
    present = indentation.at(youngs)
    forces = present.press(which, depths)
    rates = (present.rates @ change.ravel()).reshape(-1, 2).T
    derivative = np.einsum("sp,sp->s", forces.terms, rates[which])
    streamed = present.compliance_changes(change.reshape(1, -1)).reshape(-1, 2).T
    assert streamed == pytest.approx(rates, rel=1e-3, abs=1e-6)
    step = 1e-2
    ends = [indentation.at(youngs + sign * step * change).press(which, depths).force_n
            for sign in (1.0, -1.0)]  # fmt: skip
    expected = (ends[0] - ends[1]) / (2.0 * step)
    # Fields are in single precision.
    assert derivative == pytest.approx(expected, rel=5e-3, abs=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("per_point", [False, True])
def test_derivatives_by_the_logarithms_of_the_elements_moduli(per_point: bool) -> None:
    body, supports = block(18.0, 9.0, 3.0)
    indentation = Indentation(body, supports, places((0.0, 0.0), (1.0, 2.0)))
    rng = np.random.default_rng(0)
    shape = body.assembly.weights.shape if per_point else body.assembly.weights.shape[:1]
    present = indentation.at(0.1 * np.exp(0.3 * rng.standard_normal(shape)))
    chain = sp.csr_matrix(rng.standard_normal((3, 12)))
    elements = len(present.youngs)
    by_moduli = (present.combined_rates(chain) * present.youngs.ravel()).reshape(3, elements, -1)
    found = present.combined_rates(chain, logarithmic=True)
    assert found.shape == (3, elements)
    expected = by_moduli.sum(axis=2)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("per_point", [False, True])
def test_a_change_of_a_small_part_is_that_of_the_whole_solved_anew(
    per_point: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    body, supports = block(18.0, 9.0, 3.0)
    at = [(float(x), float(y)) for x in range(-4, 5, 2) for y in range(-4, 5, 2)]
    mesh, shape = body.mesh, body.assembly.weights.shape if per_point else (body.mesh.n_tets,)
    distances = np.linalg.norm(mesh.centroids - [1.0, 1.0, -2.0], axis=1)
    lump = np.argsort(distances)[:2]
    rng = np.random.default_rng(1)
    youngs = np.full(shape, 0.1)
    youngs[lump] *= np.exp(rng.uniform(-1.0, 3.0, youngs[lump].shape))
    changes = np.stack([youngs, np.zeros(shape), youngs, np.zeros(shape)])
    changes[1][lump] = youngs[lump]
    changes[2][lump] *= 3.0
    changes[3][: mesh.n_tets // 2] = 0.1  # of a large part
    results = []
    for limit in (3000, 0):
        monkeypatch.setattr("tactorch.fem.indentation._MAX_LOCAL", limit)
        indented = Indentation(body, supports, places(*at)).at(youngs)
        assert (indented._local is not None) == (limit > 0)
        results.append((indented.compliance, indented.compliance_changes(changes.reshape(4, -1))))
    (local, changed), (anew, expected) = results
    unit = Indentation(body, supports, places(*at)).at(np.full(mesh.n_tets, 0.1)).compliance
    assert np.abs(anew - unit).max() > 0.1 * unit.max()
    assert local == pytest.approx(anew, rel=1e-4, abs=1e-4 * anew.max())
    for column, wanted in zip(changed.T, expected.T, strict=True):
        assert column == pytest.approx(wanted, abs=1e-3 * np.abs(wanted).max())
    step = 1e-3
    moved = Indentation(body, supports, places(*at)).at(youngs * (1.0 + step)).compliance
    first = (anew - moved)[:, 0, 0] / step
    assert changed[: len(at), 0] == pytest.approx(first, rel=5e-3)


def test_places_are_solved_in_parts_of_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    body, supports = block(18.0, 9.0, 3.0)
    youngs = 0.1 * np.exp(0.3 * np.random.default_rng(0).standard_normal(body.mesh.n_tets))
    chain = sp.random(5, 30, 0.3, "csr", random_state=0)
    where = places(*((x, 0.0) for x in (-2.0, -1.0, 0.0, 1.0, 2.0)))

    def results() -> tuple[np.ndarray, ...]:
        present = Indentation(body, supports, where).at(youngs)
        changes = present.compliance_changes(np.stack([youngs, youngs**2]))
        return present.compliance, changes, present.combined_rates(chain), present.rates

    whole = results()
    monkeypatch.setattr("tactorch.fem.indentation._CHUNK_BYTES", 100)
    monkeypatch.setattr("tactorch.fem.indentation._KEPT", 0.0)  # solved again for derivatives
    for one, other in zip(results(), whole, strict=True):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-4 * float(np.abs(other).max()))
    assert whole[2] == pytest.approx(chain @ whole[3], rel=1e-4, abs=1e-4 * np.abs(whole[2]).max())
    monkeypatch.setenv("TACTORCH_WORK_GIB", "1e-6")
    with pytest.raises(ConfigError, match="TACTORCH_WORK_GIB=1 if the memory"):
        results()


def test_forces_are_proportional_to_the_modulus() -> None:
    body, supports = block(18.0, 9.0, 3.0)
    indentation = Indentation(body, supports, places((0.0, 0.0)))
    which, depths = np.zeros(1, dtype=int), np.ones(1)
    soft, stiff = (
        indentation.at(np.full(body.mesh.n_tets, e)).press(which, depths).force_n
        for e in (0.1, 0.3)
    )
    assert stiff == pytest.approx(3.0 * soft, rel=1e-5)
    nearly = np.full(body.mesh.n_tets, 0.1)
    nearly[0] *= 1.002  # solved anew, not scaled
    assert indentation.at(nearly).press(which, depths).force_n == pytest.approx(soft, rel=1e-4)


def test_another_material_is_refused() -> None:
    body, supports = block(12.0, 6.0, 3.0)
    other = SoftBody(body.mesh, make_material("neo_hookean", 0.45), element="tet10")
    with pytest.raises(ConfigError, match="material 'linear'"):
        Indentation(other, supports, places((0.0, 0.0)))
