"""The one call from a recording to a map: honesty, settings, messages."""

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import (
    OPTIMIZERS,
    Bounds,
    Composite,
    GaussNewton,
    Monitor,
    NoiseModel,
    Objective,
    Optimizer,
    Settings,
    ShiftedPrior,
    Smoothness,
    StopReason,
    invert_map,
)
from tactorch.inverse.data.misfit import Huber
from tactorch.inverse.fit.starts import START_MPA
from tactorch.inverse.invert import _task_digest
from tactorch.recording import Recording

SHORT = Settings(optimizer=GaussNewton(max_iterations=3))


@pytest.mark.parametrize(
    "name", ["gauss_newton", "tnc", pytest.param("lbfgs", marks=pytest.mark.slow)]
)
def test_the_truth_does_not_leak(recording: Recording, name: str) -> None:
    """Bit for bit the same map whatever truth or reference a recording carries."""
    rng = np.random.default_rng(0)
    random = rng.uniform(0.01, 2.0, recording.mesh.n_tets)
    limit = {"max_evaluations": 12} if name == "tnc" else {"max_iterations": 4}
    maps = [
        invert_map(
            other, Settings(optimizer=OPTIMIZERS.build({"name": name, **limit}))
        ).youngs.tobytes()
        for other in (
            recording,
            replace(recording, truth=None),
            replace(recording, truth=random, reference=random),
        )
    ]
    assert len(set(maps)) == 1


def test_runs_repeat_bit_for_bit(recording: Recording) -> None:
    one, other = invert_map(recording, SHORT), invert_map(recording, SHORT)
    assert one.youngs.tobytes() == other.youngs.tobytes()
    assert one.displacements.tobytes() == other.displacements.tobytes()


def test_starts(recording: Recording) -> None:
    stay = Settings(max_seconds=1e-9)
    np.testing.assert_allclose(invert_map(recording, stay).youngs, START_MPA)
    np.testing.assert_allclose(invert_map(recording, stay, start_mpa=1).youngs, 1.0)
    field = np.linspace(0.1, 0.9, recording.mesh.n_tets)
    np.testing.assert_allclose(invert_map(recording, stay, start_mpa=field).youngs, field)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (0.0, "outside the bounds"),
        (1e-4, r"spans 0\.0001 to 0\.0001 MPa, outside the bounds \[0\.001, 100\]"),
        (200.0, "outside the bounds"),
        (float("nan"), "outside the bounds"),
        (np.full(39, 0.2), r"shape \(39,\)"),
    ],
)
def test_useless_starts_are_refused(
    recording: Recording, start: float | np.ndarray, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        invert_map(recording, start_mpa=start)


@pytest.mark.parametrize(
    "settings",
    [
        {"optimizer": "adam"},
        {"parameterization": "cubic"},
        {"regularization": "entropy"},
        {"element": "hex8"},
        {"solver": "mumps"},
    ],
)
def test_unknown_names_are_refused(recording: Recording, settings: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match=next(iter(settings.values()))):
        invert_map(recording, Settings(**settings))


def test_names_do_for_optimizers(recording: Recording) -> None:
    by_name = invert_map(recording, Settings(optimizer="gauss_newton"))
    assert by_name.youngs.tobytes() == invert_map(recording).youngs.tobytes()
    assert by_name.config["optimizer"]["name"] == "gauss_newton"


def test_quadratic_elements_invert(make_tiny: Callable[..., Recording]) -> None:
    recording = make_tiny(faces=("z+",), support="fixed", element="tet10")
    found = invert_map(
        recording, Settings(optimizer=GaussNewton(max_iterations=6), element="tet10")
    )
    assert found.misfit_mm2 < 1e-3 * found.history[0]["misfit"]
    assert found.displacements.shape == (1, recording.mesh.n_points, 3)


def test_config_says_what_was_done(recording: Recording) -> None:
    settings = replace(SHORT, bounds=Bounds(0.01, 10.0), noise=NoiseModel(relative=1e-3))
    config = json.loads(json.dumps(invert_map(recording, settings).config))
    assert config["optimizer"] == {
        "name": "gauss_newton", "max_iterations": 3, "tolerance": 1e-3,
        "damping": 1e-6, "max_trials": 12, "space": "auto", "weight_rule": "discrepancy",
    }  # fmt: skip
    assert config["settings"]["bounds"] == {"lower": 0.01, "upper": 10.0}
    assert config["settings"]["noise"]["relative"] == 1e-3
    assert config["settings"]["regularization"] == {
        "name": "total_variation", "weight": None, "edge": 0.03
    }  # fmt: skip
    assert config["material"]["poisson"] == recording.material.poisson
    assert config["recording"] == recording.provenance
    assert "tactorch" in config["versions"]
    assert config["start_mpa"] == 0.2


def test_an_optimizer_of_ones_own(recording: Recording) -> None:
    @dataclass(frozen=True)
    class Guess(Optimizer):
        def minimize(self, objective: Objective, start: np.ndarray, monitor: Monitor) -> StopReason:
            monitor.accept(objective.at(start + 0.5))
            return StopReason.CONVERGED

    found = invert_map(recording, Settings(optimizer=Guess()))
    assert (found.stop_reason, found.config["optimizer"]) == (
        StopReason.CONVERGED,
        {"name": OPTIMIZERS.name_of(Guess)},
    )
    np.testing.assert_allclose(found.youngs, 0.2 * np.exp(0.5))


def test_assumed_noise_is_warned_of(
    make_tiny: Callable[..., Recording], caplog: pytest.LogCaptureFixture
) -> None:
    stay = Settings(max_seconds=1e-9)
    with caplog.at_level(logging.WARNING, logger="tactorch"):
        invert_map(make_tiny(snr_db=40.0), stay)
        assert not caplog.records
        invert_map(make_tiny(), stay)
    assert "does not state its noise; 0.0001 of the signal is assumed" in caplog.text


def test_iterations_are_logged(recording: Recording, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="tactorch"):
        invert_map(recording, SHORT)
    lines = [r.getMessage() for r in caplog.records if "misfit" in r.getMessage()]
    assert [line.split()[1] for line in lines] == ["0", "1", "2", "3"]


def test_progress_shows_iteration_and_misfit(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []

    class Line:
        def show(self, text: str) -> None:
            shown.append(text)

        def close(self, seconds: float) -> None:
            shown.append("closed")

    monkeypatch.setattr("tactorch.progress._new_line", lambda forced: Line())
    result = invert_map(recording, Settings(GaussNewton(max_iterations=1)))
    label = "inversion by gauss_newton"
    assert shown[:2] == [label, f"{label}: model of the presses"]
    assert f"{label}: first equilibrium" in shown
    last = result.history[-1]
    state = f"iteration 1, misfit {last['misfit']:.3e} mm2, step {last['step']:.2g}"
    assert f"{label}: {state}" in shown
    assert shown[-1] == "closed"


def test_no_progress_where_it_is_not_wanted(
    recording: Recording, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactorch.progress.is_terminal", lambda _: True)
    invert_map(recording, Settings(GaussNewton(max_iterations=1)), show_progress=False)
    assert capfd.readouterr().err == ""


def test_everything_that_decides_the_result_is_in_the_digest_of_a_task(
    recording: Recording,
) -> None:
    """A finished run of another task is not taken for this one when it is resumed."""
    tasks = [
        _task_digest(other, settings)
        for other, settings in (
            (recording, Settings()),
            (replace(recording, density=1e-9), Settings()),
            (replace(recording, density=1e-9, gravity=np.array([0.0, 0.0, 9810.0])), Settings()),
            (recording, Settings(regularization=Smoothness())),
            (recording, Settings(regularization=Composite(parts={"smoothness": 1.0}))),
            (recording, Settings(regularization=Composite(parts={"smoothness": 2.0}))),
            (recording, Settings(regularization=ShiftedPrior(mean_mpa=recording.truth))),
            (recording, Settings(regularization=ShiftedPrior(mean_mpa=2.0 * recording.truth))),
            (recording, Settings(misfit=Huber(edge=2.0))),
        )
    ]
    assert len(set(tasks)) == len(tasks)
    assert _task_digest(recording, Settings(max_seconds=5.0)) == tasks[0]


def test_functions_are_no_priors() -> None:
    """Two functions could not be told apart when a run is resumed."""
    with pytest.raises(ConfigError, match="regularization="):
        Settings(regularization=lambda mesh: Smoothness().on(mesh))
