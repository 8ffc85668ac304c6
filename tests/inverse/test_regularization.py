import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.config import option, settings_of
from tactorch.errors import ConfigError
from tactorch.inverse import PRIORS, Prior, Quadratic, Regularizer, ShiftedPrior
from tactorch.mesh import TetMesh, box_mesh

MESH = box_mesh(10.0, 2, tets_per_cell=5)
SEEDS = st.integers(0, 2**32 - 1)
SPREADS = st.sampled_from([1e-3, 0.1, 3.0])
MAJORISED = [name for name in PRIORS.names() if name != "binary_well"]
# Priors with their levels given, beside those that estimate them.
GIVEN = {"level_mpa": 0.2, "levels_mpa": (0.2, 1.0)}
OPTIONS = [{}, GIVEN]


def prior_of(name: str, options: dict[str, Any]) -> Regularizer:
    known = {setting.name for setting in settings_of(PRIORS[name])}
    return PRIORS.build({"name": name, **{k: v for k, v in options.items() if k in known}}).on(MESH)


def field_of(seed: int, spread: float = 1.0, mesh: TetMesh = MESH) -> np.ndarray:
    return spread * np.random.default_rng(seed).standard_normal(mesh.n_tets) - 1.5


@pytest.mark.parametrize("name", PRIORS.names())
@settings(max_examples=10, deadline=None)
@given(level=st.floats(-7.0, 5.0))
def test_a_uniform_field_costs_nothing(name: str, level: float) -> None:
    prior = PRIORS.build(name).on(MESH)
    field = np.full(MESH.n_tets, level)
    assert prior.value(field) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(prior.gradient(field), 0.0, atol=1e-9)


def test_a_prior_of_another_package_is_built_by_its_name_and_can_have_a_mean(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(PRIORS, "_added", {})

    @dataclass(frozen=True, kw_only=True)
    class Anchored(Prior):
        anchor: float = option(0.0, "Log-modulus of the minimum")

        def on(self, mesh: TetMesh) -> Quadratic:
            return Quadratic(sp.identity(mesh.n_tets), self.anchor)

    PRIORS.register("anchored", Anchored)
    own = PRIORS.build({"name": "anchored", "anchor": 0.5, "weight": 2.0})
    assert own == Anchored(anchor=0.5, weight=2.0)
    mean = np.exp(field_of(1))
    shifted = ShiftedPrior(prior=own, mean_mpa=mean).on(MESH)
    assert shifted.value(field_of(2)) == pytest.approx(
        own.on(MESH).value(field_of(2) - np.log(mean))
    )


def test_penalties_state_whether_they_are_total_variation() -> None:
    variation = PRIORS.build("total_variation").on(MESH)
    assert variation.variation_edge == 0.03
    assert PRIORS.build("log_jumps").on(MESH).variation_edge is None
    shifted = ShiftedPrior(mean_mpa=np.ones(MESH.n_tets))
    assert shifted.on(MESH).variation_edge is None
    assert dataclasses.replace(shifted, share=0.5).on(MESH).variation_edge is None


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", PRIORS.names()[1:])
@given(seed=SEEDS, spread=SPREADS)
@settings(max_examples=15, deadline=None)
def test_gradient_is_the_slope_of_the_value(
    name: str, options: dict[str, Any], seed: int, spread: float
) -> None:
    """Also where the prior's levels follow the field."""
    prior = prior_of(name, options)
    field = field_of(seed, spread)
    direction = np.random.default_rng(seed + 1).standard_normal(MESH.n_tets)
    h = 1e-6
    expected = (prior.value(field + h * direction) - prior.value(field - h * direction)) / (2 * h)
    scale = np.abs(prior.gradient(field)) @ np.abs(direction) + 1e-3 * prior.value(field)
    assert direction @ prior.gradient(field) == pytest.approx(expected, abs=1e-6 * scale + 1e-7)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", PRIORS.names())
@given(seed=SEEDS, spread=SPREADS)
@settings(max_examples=10, deadline=None)
def test_curvature_is_symmetric_and_positive_semidefinite(
    name: str, options: dict[str, Any], seed: int, spread: float
) -> None:
    prior = prior_of(name, options)
    matrix = prior.curvature(field_of(seed, spread)).toarray()
    np.testing.assert_array_equal(matrix, matrix.T)
    levels = np.linalg.eigvalsh(matrix)
    assert levels[0] >= -1e-12 * max(levels[-1], 1.0)


@pytest.mark.parametrize("name", ["smoothness", "total_variation", "log_jumps"])
@given(seed=SEEDS)
@settings(max_examples=10, deadline=None)
def test_jumps_leave_only_the_uniform_field_free(name: str, seed: int) -> None:
    matrix = PRIORS.build(name).on(MESH).curvature(field_of(seed, 0.1)).toarray()
    levels = np.linalg.eigvalsh(matrix)
    assert levels[1] > 1e-3 * levels[-1] / MESH.n_tets**2


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", MAJORISED)
@given(seed=SEEDS, spread=SPREADS, other_spread=SPREADS)
@settings(max_examples=15, deadline=None)
def test_the_quadratic_touches_and_lies_above(
    name: str, options: dict[str, Any], seed: int, spread: float, other_spread: float
) -> None:
    """What makes a reweighted step lower the penalty whatever its length."""
    prior = prior_of(name, options)
    field, other = field_of(seed, spread), field_of(seed + 1, other_spread)
    matrix, slope = prior.curvature(field), prior.gradient(field)
    change = other - field
    quadratic = prior.value(field) + float(slope @ change + 0.5 * change @ (matrix @ change))
    assert quadratic >= prior.value(other) * (1 - 1e-12) - 1e-11


def test_smoothness_is_the_squared_gradient_of_a_linear_field() -> None:
    """On a structured mesh the finite volumes see the same slope wherever they are."""
    values = []
    for divisions in (3, 6):
        mesh = box_mesh(10.0, divisions, tets_per_cell=5)
        prior = PRIORS.build("smoothness").on(mesh)
        field = 0.1 * mesh.centroids[:, 0]
        faces = mesh.adjacency
        unit = faces.areas.mean() / faces.distances.mean()  # mm: from mean-face units to mm
        values.append(prior.value(field) * unit)
    assert values[0] == pytest.approx(values[1], rel=0.25)
    assert values[1] == pytest.approx(0.5 * 0.1**2 * 1000.0, rel=0.5)


def test_total_variation_counts_jumps_by_their_size() -> None:
    prior = PRIORS.build({"name": "total_variation", "edge": 1e-6}).on(MESH)
    step = np.where(MESH.centroids[:, 2] > 5.0, 1.0, 0.0)
    across = 100.0 / MESH.adjacency.areas.mean()  # the plane between, in mean areas
    assert prior.value(step) == pytest.approx(across, rel=1e-4)
    assert prior.value(3.0 * step) == pytest.approx(3.0 * across, rel=1e-4)
    assert PRIORS.build("smoothness").on(MESH).value(3.0 * step) == pytest.approx(
        9.0 * PRIORS.build("smoothness").on(MESH).value(step)
    )


def test_total_variation_prefers_one_jump_to_none_the_ramp() -> None:
    """A sharp edge costs no more than a ramp of the same height; under smoothness it does."""
    mesh = box_mesh(10.0, 4, tets_per_cell=5)
    z = mesh.centroids[:, 2]
    sharp, ramp = np.where(z > 5.0, 1.0, 0.0), z / 10.0
    variation = PRIORS.build({"name": "total_variation", "edge": 1e-6}).on(mesh)
    smoothness = PRIORS.build("smoothness").on(mesh)
    assert variation.value(sharp) < 1.2 * variation.value(ramp)
    assert smoothness.value(sharp) > 2.0 * smoothness.value(ramp)


@pytest.mark.parametrize("name", ["total_variation", "log_jumps", "sparsity"])
@pytest.mark.parametrize("edge", [0.0, -0.1, np.nan])
def test_useless_edge_is_refused(name: str, edge: float) -> None:
    with pytest.raises(ConfigError, match=r"regularization\.edge"):
        PRIORS.build({"name": name, "edge": edge}).on(MESH)


def test_unknown_name_is_refused_with_the_choices() -> None:
    with pytest.raises(ConfigError, match=r"regularization=ridge is unknown.*total_variation"):
        PRIORS.build("ridge").on(MESH)


@pytest.mark.parametrize("name", PRIORS.names())
def test_a_single_element_has_no_jumps(name: str) -> None:
    mesh = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    prior = PRIORS.build(name).on(mesh)
    assert prior.value(np.array([0.3])) == pytest.approx(0.0, abs=1e-20)
    assert prior.curvature(np.array([0.3])).shape == (1, 1)
