"""Which description `invert` returns: inclusions, or one modulus per element."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.inverse import GaussNewton, Reconstruction, Settings, Status, invert, invert_map
from tactorch.inverse.data.observations import DataModel, Observation, group_by_contact
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.held_out import held_out_score
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

# The function of the same name hides the module.
MODULE = import_module("tactorch.inverse.invert")
SETTINGS = Settings(model_error="none", optimizer=GaussNewton(max_iterations=3))


@pytest.fixture(scope="module")
def recording() -> Recording:
    plan = PressPlan(("z+", "x+"), (0.01,))
    phantom = make_phantom("cube_sphere", radius=0.45)
    return simulate(phantom, plan, mesh=box_mesh(10.0, 3, tets_per_cell=5), snr_db=40)


@pytest.fixture(scope="module")
def elements(recording: Recording) -> Reconstruction:
    return invert_map(recording, SETTINGS, show_progress=False)


@pytest.fixture
def shapes(recording: Recording) -> ShapeReconstruction:
    """A ball of 0.8 MPa in 0.2 MPa."""
    field = ShapeField(ShapePrior.of(recording.mesh, 0.2), (BALL,))
    z = field.standard(np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.0), np.log(4.0)]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 4e-4 * np.eye(len(z)))
    history = ({"model": "ball", "chi2": 1.0, "log_evidence": 0.0},)
    return ShapeReconstruction(field, z, posterior, 1.0, (50.0,), 50.0, history=history)


@pytest.fixture
def replace_search(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], list[dict[str, Any]]]:
    """Return a function that replaces the search for inclusions by a result or an error."""

    def replaced(outcome: Any) -> list[dict[str, Any]]:
        calls: list[dict[str, Any]] = []

        def search(recording: Recording, settings: Settings, **options: Any) -> Any:
            calls.append({"settings": settings, **options})
            if isinstance(outcome, Exception):
                raise outcome
            return outcome

        monkeypatch.setattr(MODULE, "find_shapes", search)
        return calls

    return replaced


def test_inclusions_that_explain_the_presses_are_the_result(
    recording: Recording, shapes: ShapeReconstruction, replace_search: Any
) -> None:
    calls, stop = replace_search(shapes), lambda: False
    passed_on = {"start": shapes, "stop": stop, "kept": KeptRims(), "max_shapes": 2}
    result = invert(recording, SETTINGS, **passed_on)
    assert result.shapes is shapes
    assert result.other is None
    assert result.name == "inclusions"
    assert result.status is Status.FOUND
    assert calls == [{"settings": SETTINGS, **passed_on}]


@pytest.mark.parametrize("error", [ConvergenceError("the body collapses."), MemoryError()])
def test_where_none_can_be_fitted_the_element_map_is_the_result(
    recording: Recording, elements: Reconstruction, error: Exception, replace_search: Any
) -> None:
    replace_search(error)
    result = invert(recording, SETTINGS)
    assert result.name == "element map"
    np.testing.assert_array_equal(result.youngs, elements.youngs)
    reason = str(error).rstrip(".") or "not enough memory"
    assert result.warnings == (f"No inclusions can be fitted ({reason}); this is the element map.",)
    assert result.summary().count(result.warnings[0]) == 1
    with pytest.raises(type(error)):
        invert(recording, replace(SETTINGS, method="inclusions"))


def test_a_search_that_is_stopped_has_no_result(recording: Recording, replace_search: Any) -> None:
    replace_search(CancelledError("stopped"))
    with pytest.raises(CancelledError):
        invert(recording, SETTINGS)


def test_the_element_map_alone_where_it_is_asked_for(
    recording: Recording, replace_search: Any
) -> None:
    calls = replace_search(ConvergenceError("not called"))
    result = invert(recording, replace(SETTINGS, method="map"))
    assert result.shapes is None
    assert not calls


@pytest.mark.parametrize("score", [1e3, -1e3, None])
def test_the_description_that_predicts_held_out_presses_better_is_shown(
    recording: Recording, shapes: ShapeReconstruction, replace_search: Any, score: float | None
) -> None:
    count = sum(int(press.data.sum()) for press in recording.presses)
    moved = np.zeros((0, recording.mesh.n_points, 3))
    predictions = (moved, np.zeros(count), np.zeros(count))
    unexplained = replace(shapes, unexplained=0.3, held_out=score)
    replace_search(replace(unexplained, predictions=Predictions(*predictions)))
    result = invert(recording, SETTINGS)
    assert result.other is not None
    better = "element map" if score == -1e3 else "inclusions"
    assert result.name == better
    assert {result.name, result.other.name} == {"element map", "inclusions"}
    if better == "inclusions":
        assert result.status is Status.UNKNOWN
        assert "30% of the displacements unexplained" in result.reasons[0]


@pytest.mark.parametrize("error", [0.0, 0.1])
def test_an_element_map_of_wrong_forces_is_not_trusted(error: float) -> None:
    """Forces of one side too large, and of another too small, look like structure."""
    plan = PressPlan(("z+", "x+", "y+"), (0.02,))
    phantom, mesh = make_phantom("cube_sphere", radius=0.3), box_mesh(10.0, 4, tets_per_cell=5)
    right = simulate(phantom, plan, mesh=mesh, snr_db=40)
    factors = (1.0 + error, 1.0 - error, 1.0)
    presses = zip(right.presses, factors, strict=True)
    wrong = replace(right, presses=tuple(replace(p, forces=k * p.forces) for p, k in presses))
    result = invert(wrong, Settings(method="map"), show_progress=False)
    if error == 0.0:
        assert result.status is Status.FOUND
    else:
        assert result.status is Status.UNKNOWN
        assert not result.lumps
        assert "forces that are wrong by about" in result.reasons[0]


def test_held_out_presses_are_predicted_as_by_leaving_them_out() -> None:
    """A linear model with a normal prior and correlated errors, fitted without each contact."""
    rng = np.random.default_rng(0)
    counts, size = (5, 4, 6), 3
    jacobian, patterns = rng.normal(size=(15, size)), rng.normal(size=(15, 2))
    scale, values = rng.uniform(1.0, 3.0, 15), rng.normal(size=15)
    ends = np.cumsum((0, *counts))
    rows = [np.arange(a, b) for a, b in pairwise(ends)]
    observations = tuple(Observation(r, values[r], scale[r]) for r in rows)
    data = DataModel(observations).with_errors(patterns)

    def fit(kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of all data (scaled), given some."""
        total = jacobian @ jacobian.T + patterns @ patterns.T + np.eye(15)
        gain = total[:, kept] @ np.linalg.inv(total[np.ix_(kept, kept)])
        return gain @ (values * scale)[kept], total - gain @ total[kept]

    expected = np.log(scale).sum()
    for group in ([0, 2], [1]):
        out = np.concatenate([rows[i] for i in group])
        mean, covariance = fit(np.setdiff1d(np.arange(15), out))
        error, spread = (values * scale - mean)[out], covariance[np.ix_(out, out)]
        expected -= 0.5 * (error @ np.linalg.solve(spread, error) + np.linalg.slogdet(spread)[1])
    white = data.whiten(jacobian)
    posterior = np.linalg.inv(white.T @ white + np.eye(size))
    best = posterior @ white.T @ data.whiten(values * scale)
    residuals = data.whiten(jacobian @ best - values * scale)
    score = held_out_score(data, [(0, 2), (1,)], residuals, white, posterior)
    assert score == pytest.approx(expected / 15)


def test_one_contact_has_no_held_out_prediction(recording: Recording) -> None:
    observations = tuple(Observation.of(press, 1e-3) for press in recording.presses[:1])
    contacts = group_by_contact(recording.presses[:1])
    data = DataModel(observations)
    count = len(observations[0].values)
    score = held_out_score(data, contacts, np.zeros(count), np.zeros((count, 1)), np.eye(1))
    assert score is None


def test_a_large_mesh_has_an_element_map(
    recording: Recording,
    shapes: ShapeReconstruction,
    replace_search: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = replace_search(shapes)
    monkeypatch.setattr(MODULE, "MAX_ELEMENTS", recording.mesh.n_tets - 1)
    result = invert(recording, SETTINGS)
    assert result.name == "element map"
    assert f"the mesh has {recording.mesh.n_tets} elements" in result.warnings[0]
    assert "method=inclusions fits them all the same" in result.warnings[0]
    assert not calls
    assert invert(recording, replace(SETTINGS, method="inclusions")).shapes is shapes


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ConfigError, match="method"):
        Settings.from_mapping({"method": "both"})
