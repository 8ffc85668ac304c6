"""History, time limit, checkpoints and what survives an interruption."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConvergenceError, FileError
from tactorch.inverse import (
    OPTIMIZERS,
    GaussNewton,
    InverseProblem,
    Monitor,
    Reconstruction,
    Settings,
    StopReason,
    invert_map,
    make_objective,
)
from tactorch.inverse.fit.monitor import StopOptimization, describe
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

NAMES = ("gauss_newton", "tnc", "lbfgs")
Fail = Callable[[int, BaseException], None]


@pytest.fixture(scope="module")
def noisy(make_tiny: Callable[..., Recording]) -> Recording:
    return make_tiny(faces=("z+",), snr_db=60.0)


@pytest.fixture
def half_way(noisy: Recording, tmp_path: Path) -> Path:
    path = tmp_path / "half.npz"
    invert_map(noisy, Settings(optimizer=GaussNewton(max_iterations=3)), checkpoint=path)
    return path


def misfits(found: Reconstruction) -> list[float]:
    return [entry["misfit"] for entry in found.history]


@pytest.mark.parametrize("stop", [1, pytest.param(4, marks=pytest.mark.slow), 7])
def test_a_resumed_gauss_newton_ends_where_an_undisturbed_one_does(
    noisy: Recording, tmp_path: Path, stop: int
) -> None:
    """Also where the weight has stopped falling: 1 is early, 7 is past it."""
    whole = invert_map(noisy)
    assert whole.iterations > 7
    path = tmp_path / "state"  # no suffix: the name is the user's
    first = invert_map(noisy, Settings(optimizer=GaussNewton(max_iterations=stop)), checkpoint=path)
    second = invert_map(noisy, checkpoint=path, resume=path)
    assert first.stop_reason == "iteration limit reached"
    assert second.stop_reason == whole.stop_reason
    np.testing.assert_allclose(second.youngs, whole.youngs, rtol=1e-6)
    assert [e["iteration"] for e in second.history] == list(range(whole.iterations + 1))
    assert second.history[: stop + 1] == first.history
    for name in ("misfit", "objective", "weight", "step"):
        np.testing.assert_allclose(
            [e[name] for e in second.history], [e[name] for e in whole.history], rtol=1e-4
        )
    evaluations = [e["evaluations"] for e in second.history]
    assert (np.diff(evaluations) > 0).all()
    assert (np.diff([e["seconds"] for e in second.history]) > 0).all()
    assert second.seconds > first.seconds


@pytest.mark.parametrize("name", NAMES)
def test_an_interrupted_run_goes_on(
    noisy: Recording, tmp_path: Path, fail_evaluation: Fail, name: str
) -> None:
    path = tmp_path / "state.npz"
    fail_evaluation(8, KeyboardInterrupt())
    first = invert_map(noisy, Settings(optimizer=OPTIMIZERS.build(name)), checkpoint=path)
    assert first.stop_reason == "interrupted"
    limit = {"max_evaluations": 40} if name == "tnc" else {"max_iterations": 10}
    second = invert_map(
        noisy, Settings(optimizer=OPTIMIZERS.build({"name": name, **limit})), resume=path
    )
    assert second.history[: len(first.history)] == first.history
    if second.history[-1]["weight"] == first.history[-1]["weight"]:
        assert second.history[-1]["objective"] < first.history[-1]["objective"]
    else:  # objectives of different weights cannot be compared: it is the unbroken run's way
        whole = invert_map(noisy, Settings(optimizer=OPTIMIZERS.build({"name": name, **limit})))
        np.testing.assert_allclose(second.youngs, whole.youngs, rtol=1e-6)
    assert [e["iteration"] for e in second.history] == list(range(len(second.history)))
    spent = second.history[-1]["evaluations"]
    assert spent > first.history[-1]["evaluations"]
    assert name != "tnc" or spent <= 41


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("error", "reason"),
    [(KeyboardInterrupt(), "interrupted"), (StopOptimization(), "time limit reached")],
)
def test_whatever_ends_it_keeps_the_best_so_far(
    noisy: Recording, fail_evaluation: Fail, name: str, error: BaseException, reason: str
) -> None:
    fail_evaluation(9, error)
    found = invert_map(noisy, Settings(optimizer=OPTIMIZERS.build(name)))
    assert found.stop_reason == reason
    last = found.history[-1]
    assert last["objective"] == min(
        entry["objective"] for entry in found.history if entry["weight"] == last["weight"]
    )
    assert found.misfit_mm2 == last["misfit"] < 0.5 * misfits(found)[0]
    again = InverseProblem(noisy).evaluate(found.youngs)
    assert again.misfit_mm2 == pytest.approx(found.misfit_mm2, rel=1e-6)


def test_an_interruption_before_the_start_is_not_swallowed(
    noisy: Recording, fail_evaluation: Fail
) -> None:
    fail_evaluation(1, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        invert_map(noisy)


def test_an_interruption_right_after_resuming_keeps_the_map(
    noisy: Recording, half_way: Path, fail_evaluation: Fail
) -> None:
    expected = invert_map(noisy, Settings(optimizer=GaussNewton(max_iterations=3)))
    fail_evaluation(2, KeyboardInterrupt())  # the first one is the point resumed from
    found = invert_map(noisy, resume=half_way)
    assert found.stop_reason == "interrupted"
    np.testing.assert_allclose(found.youngs, expected.youngs, rtol=1e-9)
    assert found.iterations == 3


def test_an_unstable_equilibrium_ends_the_run_with_its_reason(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the tangent is indefinite no derivatives exist; what was reached is kept."""
    from tactorch.inverse import Evaluation

    jacobian, count = Evaluation.jacobian, iter(range(100))

    def fail(self: Evaluation) -> Any:
        if next(count) == 3:
            raise ConvergenceError("The equilibrium is unstable")
        return jacobian(self)

    monkeypatch.setattr(Evaluation, "jacobian", fail)
    found = invert_map(noisy)
    assert found.stop_reason == StopReason.NO_DERIVATIVES
    assert found.iterations == 3
    assert misfits(found)[-1] < 0.5 * misfits(found)[0]


@pytest.mark.parametrize("name", NAMES)
def test_no_time_gives_the_start_back(noisy: Recording, name: str) -> None:
    found = invert_map(
        noisy, Settings(optimizer=OPTIMIZERS.build(name), max_seconds=1e-9), start_mpa=0.3
    )
    assert (found.stop_reason, found.iterations) == ("time limit reached", 0)
    np.testing.assert_allclose(found.youngs, 0.3)


@pytest.mark.parametrize("name", NAMES)
def test_time_is_watched_within_an_iteration(
    noisy: Recording, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Line searches and rejected steps solve all presses too."""
    objective, monitor = make_objective(noisy, Settings()), Monitor(max_seconds=4e5)
    evaluate = InverseProblem.evaluate

    def age(self: InverseProblem, *args: Any, **others: Any) -> Any:
        monitor._earlier_seconds += 3e5
        if monitor._earlier_seconds > 4e5:
            raise ConvergenceError("collapsed")
        return evaluate(self, *args, **others)

    monkeypatch.setattr(InverseProblem, "evaluate", age)
    start = objective.elements.parameterization.parameters(np.full(noisy.mesh.n_tets, 0.2))
    with pytest.raises(StopOptimization):
        OPTIMIZERS.build(name).minimize(objective, start, monitor)
    assert monitor._earlier_seconds == 6e5


@pytest.mark.parametrize("name", NAMES)
def test_time_is_watched_at_every_iteration(noisy: Recording, name: str) -> None:
    objective = make_objective(noisy, Settings())
    monitor = Monitor(max_seconds=1e6)

    def age(entry: dict[str, Any]) -> None:
        monitor._earlier_seconds += 3e5

    monitor.on_record = age
    start = objective.elements.parameterization.parameters(np.full(noisy.mesh.n_tets, 0.2))
    with pytest.raises(StopOptimization):
        OPTIMIZERS.build(name).minimize(objective, start, monitor)
    assert 3 <= monitor.iteration <= 4
    assert monitor.history[-1]["misfit"] < monitor.history[0]["misfit"]
    assert monitor.point is not None
    assert monitor.point.evaluation.misfit_mm2 == monitor.history[-1]["misfit"]


def test_a_failed_write_leaves_the_former_checkpoint(
    noisy: Recording, half_way: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = half_way.read_bytes()

    def fail(file: Any, **arrays: Any) -> None:
        file.write(b"half a check")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(KeyboardInterrupt):
        invert_map(noisy, Settings(optimizer=GaussNewton(max_iterations=1)), checkpoint=half_way)
    assert half_way.read_bytes() == before
    assert [path.name for path in half_way.parent.iterdir()] == ["half.npz"]


def test_checkpoints_are_written_on_the_way(
    noisy: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import tactorch.inverse.fit.monitor as module

    monkeypatch.setattr(module, "_CHECKPOINT_PERIOD", 0.0)
    saved: list[int] = []
    save = Monitor.save

    def watch(self: Monitor) -> None:
        save(self)
        saved.append(len(self.history))

    monkeypatch.setattr(Monitor, "save", watch)
    path = tmp_path / "state.npz"
    found = invert_map(noisy, Settings(optimizer=GaussNewton(max_iterations=3)), checkpoint=path)
    assert saved == [1, 2, 3, 4, 4]  # each record, and the end
    monitor = Monitor()
    monitor.restore(path, noisy.mesh.n_tets)
    assert monitor.history == found.history
    assert monitor.evaluations == found.history[-1]["evaluations"]
    assert monitor.best is not None
    np.testing.assert_allclose(np.exp(monitor.best), found.youngs, rtol=1e-12)


@pytest.mark.parametrize("keep", [0, 1, 10, 0.3, 0.9, -1])
def test_a_truncated_checkpoint_is_refused(noisy: Recording, half_way: Path, keep: float) -> None:
    data = half_way.read_bytes()
    half_way.write_bytes(data[: int(keep * len(data)) if 0 < keep < 1 else int(keep)])
    with pytest.raises(FileError, match=r"half\.npz' cannot be read.*start again"):
        invert_map(noisy, resume=half_way)


def test_other_files_are_refused(noisy: Recording, tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    with path.open("wb") as file:
        np.save(file, np.zeros(noisy.mesh.n_tets))
    with pytest.raises(FileError, match=r"other\.npz' cannot be read"):
        invert_map(noisy, resume=path)
    np.savez(path, x=np.zeros(noisy.mesh.n_tets))
    with pytest.raises(FileError, match=r"other\.npz' cannot be read"):
        invert_map(noisy, resume=path)
    path.write_text("not an archive")
    with pytest.raises(FileError, match=r"other\.npz' cannot be read"):
        invert_map(noisy, resume=path)
    with pytest.raises(FileError, match=r"checkpoint not found: .*absent\.npz"):
        invert_map(noisy, resume=tmp_path / "absent.npz")


def test_a_checkpoint_of_another_mesh_is_refused(noisy: Recording, half_way: Path) -> None:
    ball = make_phantom("cube_sphere")
    finer = simulate(ball, PressPlan(pressures_mpa=(0.01,)), mesh=box_mesh(10.0, 3))
    with pytest.raises(FileError, match=r"40 moduli but the recording has 162.*another mesh"):
        invert_map(finer, resume=half_way)
    larger = simulate(
        make_phantom("cube_sphere", side_mm=12.0),
        PressPlan(pressures_mpa=(0.01,)),
        mesh=box_mesh(12.0, 2, tets_per_cell=5),
    )
    with pytest.raises(FileError, match="another mesh"):
        invert_map(larger, resume=half_way)


def test_a_checkpoint_of_other_parameters_is_refused(noisy: Recording, half_way: Path) -> None:
    with pytest.raises(FileError, match=r"another parameterization: Log\(.*, not Identity"):
        invert_map(noisy, Settings(parameterization="identity"), resume=half_way)


def test_description_names_units() -> None:
    text = describe(
        {
            "iteration": 7, "seconds": 1.25, "misfit": 0.001, "chi2": 2.0, "weight": 0.5,
            "step": 0.1, "evaluations": 9,
        }
    )  # fmt: skip
    assert "iteration    7" in text
    assert "1.2 s" in text
    assert "misfit 1.0000e-03 mm2" in text
    assert "weight 0.5" in text


def test_a_run_that_had_ended_has_nothing_more_to_do(noisy: Recording, tmp_path: Path) -> None:
    """Killed between the end of the search and the end of the run."""
    path = tmp_path / "ended.npz"
    settings = Settings(optimizer=GaussNewton(tolerance=1e-2))
    whole = invert_map(noisy, settings, checkpoint=path)
    again = invert_map(noisy, settings, checkpoint=path, resume=path)
    assert again.history == whole.history
    assert again.stop_reason == whole.stop_reason
    np.testing.assert_allclose(again.youngs, whole.youngs, rtol=1e-12)
    finer = invert_map(noisy, Settings(optimizer=GaussNewton(tolerance=1e-6)), resume=path)
    assert finer.iterations > whole.iterations
