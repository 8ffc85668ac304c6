from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import Log
from tactorch.inverse.posterior import GaussianState
from tactorch.mesh import TetMesh, box_mesh
from tactorch.sampling import (
    ExpectedError,
    ExpectedInformation,
    LargestUncertainty,
    Patch,
    Random,
    Rule,
    SamplingState,
    UniformGrid,
)
from tactorch.sampling.rules import area_means

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box_mesh((8.0, 8.0, 2.0), (8, 8, 2), tets_per_cell=5)


@pytest.fixture(scope="module")
def patches() -> list[Patch]:
    """A grid of 4 x 4 places on top, 2 mm apart."""
    ends = np.arange(1.0, 8.0, 2.0)
    return [Patch(np.array([x, y, 2.0]), DOWN, 1.0) for x in ends for y in ends]


@pytest.fixture
def state(mesh: TetMesh, patches: list[Patch]) -> SamplingState:
    """Place 0 was pressed, sensitive to the left half; data of a place are of elements near it."""
    m = mesh.n_tets

    def jacobians(places: Sequence[int]) -> list[np.ndarray | None]:
        flat = mesh.centroids[:, :2]
        near = [np.linalg.norm(flat - patches[i].center[:2], axis=1) < 1.2 for i in places]
        return [np.eye(m)[mask][:6] for mask in near]

    credibility = (mesh.centroids[:, 0] < 4.0).astype(float)[None]
    posterior = GaussianState(np.zeros(m), np.eye(m))
    return SamplingState(mesh, patches, (0,), Log(), credibility, jacobians, posterior)


def peaked(state: SamplingState, at: int) -> SamplingState:
    """The same where the elements around one place are much less certain than others."""
    gaps = np.linalg.norm(state.mesh.centroids - state.candidates[at].center, axis=1)
    variance = np.where(gaps < 1.5, 4.0, 0.01)
    return replace(state, posterior=GaussianState(state.posterior.mean, np.diag(variance)))


@pytest.mark.parametrize(
    "rule", [LargestUncertainty(), ExpectedInformation(), ExpectedError(), UniformGrid(5), Random()]
)
def test_rules_choose_places_not_pressed(state: SamplingState, rule: Rule) -> None:
    assert isinstance(rule, Rule)
    first = rule.first(state.candidates)
    chosen = rule.choose(replace(state, pressed=(first,)))
    assert chosen in range(16)
    assert chosen != first


def test_papers_rule_goes_where_presses_are_insensitive(state: SamplingState) -> None:
    chosen = LargestUncertainty().choose(state)
    assert state.candidates[chosen].center[0] > 4.0
    turned = replace(state, credibility=1.0 - state.credibility)
    assert state.candidates[LargestUncertainty().choose(turned)].center[0] < 4.0


def test_papers_variance_is_that_of_its_update(state: SamplingState) -> None:
    credibility = np.random.default_rng(0).uniform(0, 3, (2, state.mesh.n_tets))
    credibility[:, :50] = 0.0
    posterior = GaussianState(np.zeros(state.mesh.n_tets), 0.25 * np.eye(state.mesh.n_tets))
    for one in credibility:
        posterior = posterior.after_press(np.diag(np.sqrt(one)), np.zeros(len(one)))
    means = area_means(state.mesh, state.candidates, posterior.deviation() ** 2)
    chosen = LargestUncertainty(0.5).choose(replace(state, credibility=credibility))
    assert means[chosen] == pytest.approx(means[state.remaining].max())


@pytest.mark.parametrize("rule", [ExpectedInformation(), ExpectedError()])
def test_ours_go_where_the_belief_is_wide(state: SamplingState, rule: Rule) -> None:
    for at in (5, 10, 15):
        assert rule.choose(peaked(state, at)) == at


def test_error_of_the_moduli_counts_more_where_it_is_stiff(state: SamplingState) -> None:
    for at in (5, 10, 15):
        gaps = np.linalg.norm(state.mesh.centroids - state.candidates[at].center, axis=1)
        logs = np.log(np.where(gaps < 1.5, 0.5, 0.1))
        stiff = replace(state, posterior=GaussianState(logs, state.posterior.covariance))
        assert ExpectedError().choose(stiff) == at
        assert ExpectedError("parameters").choose(stiff) == ExpectedError("parameters").choose(
            state
        )
    with pytest.raises(ConfigError, match="of='energy'"):
        ExpectedError("energy")


@pytest.mark.parametrize("rule", [ExpectedInformation(), ExpectedError()])
def test_places_that_would_collapse_are_passed_over(state: SamplingState, rule: Rule) -> None:
    wide = peaked(state, 5)

    def collapsing(places: Sequence[int]) -> list[np.ndarray | None]:
        return [None if i == 5 else j for i, j in zip(places, state.jacobians(places), strict=True)]

    assert rule.choose(replace(wide, jacobians=collapsing)) not in (0, 5)
    none: Callable[[Sequence[int]], list[np.ndarray | None]] = lambda places: [None] * len(places)  # noqa: E731
    assert rule.choose(replace(wide, jacobians=none)) == 1


def test_grid_is_even_and_each_place_once(patches: list[Patch]) -> None:
    places = UniformGrid(4).places(patches)
    centers = np.array([patches[i].center for i in places])
    assert len(set(places)) == 4
    quadrants = {(x > 4.0, y > 4.0) for x, y, _ in centers}
    assert len(quadrants) == 4
    assert sorted(UniformGrid(16).places(patches)) == list(range(16))
    with pytest.raises(ConfigError, match="budget=17"):
        UniformGrid(17).places(patches)


def test_random_is_seeded_and_reaches_all(state: SamplingState) -> None:
    orders = []
    for seed in (0, 0, 1):
        rule, pressed = Random(seed), ()
        for _ in range(16):
            pressed = (*pressed, rule.choose(replace(state, pressed=pressed)))
        assert sorted(pressed) == list(range(16))
        orders.append(pressed)
    assert orders[0] == orders[1] != orders[2]


def test_means_are_by_volume_and_near(state: SamplingState) -> None:
    mesh = state.mesh
    ones = area_means(mesh, state.candidates, np.ones(mesh.n_tets))
    np.testing.assert_allclose(ones, 1.0)
    x = area_means(mesh, state.candidates, mesh.centroids[:, 0])
    np.testing.assert_allclose(x, [p.center[0] for p in state.candidates], atol=0.1)
    far = [*state.candidates, Patch(np.full(3, 90.0), DOWN, 1.0)]
    assert area_means(mesh, far, np.ones(mesh.n_tets))[-1] == 0.0
