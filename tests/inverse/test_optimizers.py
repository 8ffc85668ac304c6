"""Every optimizer on a small problem: descent, bounds, reasons, and what it finds."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse import (
    LBFGS,
    OPTIMIZERS,
    PARAMETERIZATIONS,
    PRIORS,
    Bounds,
    GaussNewton,
    InverseProblem,
    Monitor,
    NoiseModel,
    Optimizer,
    Reconstruction,
    Settings,
    TotalVariation,
    invert_map,
    make_objective,
)
from tactorch.inverse.fit.optimizers.damped import projected_gradient
from tactorch.metrics import pearson
from tactorch.recording import Recording

Make = Callable[..., Recording]

SHORT: dict[str, dict[str, int]] = {
    "gauss_newton": {"max_iterations": 8},
    "newton_cg": {"max_iterations": 8},
    "tnc": {"max_evaluations": 40},
    "lbfgs": {"max_iterations": 12},
}
NAMES = sorted(OPTIMIZERS.names())
UNWEIGHTED = TotalVariation(weight=0.0)  # the data alone


@pytest.fixture(scope="module")
def recording(make_tiny: Make) -> Recording:
    """One press: no threads to start, and fewer data than unknowns."""
    return make_tiny(faces=("z+",))


def run(recording: Recording, name: str, **settings: Any) -> Reconstruction:
    optimizer = {"name": name, **SHORT[name]}
    return invert_map(recording, Settings(optimizer=optimizer, **settings))


def series(found: Reconstruction, name: str) -> np.ndarray:
    return np.array([entry[name] for entry in found.history])


@pytest.mark.parametrize("name", NAMES)
def test_result_and_history_agree(recording: Recording, name: str) -> None:
    found = run(recording, name)
    assert found.misfit_mm2 < 0.1 * found.history[0]["misfit"]
    assert found.iterations == len(found.history) - 1 > 2
    np.testing.assert_array_equal(series(found, "iteration"), np.arange(found.iterations + 1))
    for increasing in ("evaluations", "seconds"):
        assert (np.diff(series(found, increasing)) >= 0).all()
    again = InverseProblem(recording).evaluate(found.youngs)
    assert again.misfit_mm2 == pytest.approx(found.misfit_mm2, rel=1e-6)
    assert again.chi2 == pytest.approx(found.history[-1]["chi2"], rel=1e-6)
    np.testing.assert_allclose(found.displacements, again.displacements, atol=1e-9)
    assert found.youngs.min() >= 0.001
    assert found.youngs.max() <= 100.0
    assert found.history[0]["step"] == 0.0
    assert found.history[1]["step"] > 0.0
    assert found.seconds >= found.history[-1]["seconds"] > 0


@pytest.mark.parametrize(
    ("name", "prior"),
    [("gauss_newton", prior) for prior in PRIORS.names()]
    + [("tnc", "smoothness"), ("tnc", "none"), ("lbfgs", "total_variation")],
)
def test_the_objective_falls_at_a_given_weight(recording: Recording, name: str, prior: str) -> None:
    optimizer = OPTIMIZERS.build({"name": name, **SHORT[name]})
    weighted = {"name": prior} if prior == "none" else {"name": prior, "weight": 10.0}
    settings = Settings(
        optimizer=optimizer, regularization=weighted, noise=NoiseModel(relative=0.01)
    )
    found = invert_map(recording, settings)
    objective = series(found, "objective")
    assert (np.diff(objective) <= 0.0).all()
    assert objective[-1] < 0.1 * objective[0]
    if prior != "none":
        assert set(series(found, "weight")) == {10.0}
        fitted = 0.5 * found.history[-1]["chi2"] * InverseProblem(recording).n_data
        assert objective[-1] > 1.01 * fitted  # the prior counts


@pytest.mark.parametrize("name", NAMES)
def test_more_weight_makes_a_flatter_map(recording: Recording, name: str) -> None:
    rough, flat = (
        invert_map(
            recording,
            Settings(
                optimizer=OPTIMIZERS.build({"name": name, **SHORT[name]}),
                regularization={"name": "smoothness", "weight": weight},
                noise=NoiseModel(relative=0.1),
            ),
        )
        for weight in (1e-3, 1e3)
    )
    assert np.std(np.log(flat.youngs)) < 0.5 * np.std(np.log(rough.youngs))
    assert flat.misfit_mm2 > rough.misfit_mm2


@pytest.mark.parametrize(
    ("name", "parameterization"),
    [(name, p) for name in ("gauss_newton", "tnc") for p in sorted(PARAMETERIZATIONS.names())]
    + [("lbfgs", "identity")],
)
def test_every_parameterization_works(
    recording: Recording, name: str, parameterization: str
) -> None:
    found = run(recording, name, parameterization=parameterization)
    assert found.misfit_mm2 < 0.1 * found.history[0]["misfit"]
    assert found.youngs.min() >= 0.001
    assert found.youngs.max() <= 100.0


@pytest.mark.parametrize(
    ("name", "parameterization"),
    [("gauss_newton", name) for name in sorted(PARAMETERIZATIONS.names())]
    + [("tnc", "scaled"), ("lbfgs", "log")],
)
def test_bounds_hold_and_are_used(recording: Recording, name: str, parameterization: str) -> None:
    """The truth spans 0.2 to 0.36 MPa: bounds inside that must bind."""
    bounds = Bounds(0.19, 0.34)
    optimizer = OPTIMIZERS.build({"name": name, **SHORT[name]})
    settings = Settings(
        optimizer=optimizer,
        parameterization=parameterization,
        bounds=bounds,
        regularization=UNWEIGHTED,
    )
    found = invert_map(recording, settings, start_mpa=0.25)
    assert found.youngs.min() >= bounds.lower
    assert found.youngs.max() <= bounds.upper
    low, high = found.youngs == bounds.lower, found.youngs == bounds.upper
    assert low.sum() + high.sum() > 2
    assert (~low & ~high).any()
    assert found.misfit_mm2 < 0.5 * found.history[0]["misfit"]


@pytest.mark.parametrize("optimizer", [GaussNewton(), LBFGS()])
def test_the_end_is_a_constrained_minimum(recording: Recording, optimizer: Optimizer) -> None:
    prior = TotalVariation(weight=10.0)
    settings = Settings(optimizer=optimizer, regularization=prior, bounds=Bounds(0.19, 0.34))
    found = invert_map(recording, settings, start_mpa=0.25)
    objective = make_objective(recording, settings)
    x = np.log(found.youngs)
    point, start = objective.at(x), objective.at(np.full_like(x, np.log(0.25)))

    def size(p: Any) -> float:
        gradient = p.data_gradient + 10.0 * p.penalty_gradient
        limits = objective.elements.parameterization.limits
        return float(np.abs(projected_gradient(p.x, gradient, limits)).max())

    assert size(point) < 1e-3 * size(start)
    assert (np.isclose(found.youngs, 0.19) | np.isclose(found.youngs, 0.34)).sum() > 2


def test_gauss_newton_finds_the_inclusion(cube: Recording) -> None:
    """And goes much further than the paper's optimizer."""
    found = invert_map(cube)
    assert cube.truth is not None
    assert pearson(found.youngs, cube.truth) > 0.97
    theirs = run(cube, "tnc", regularization="none")
    assert pearson(theirs.youngs, cube.truth) > 0.2
    assert found.misfit_mm2 < 0.1 * theirs.misfit_mm2
    assert found.stop_reason == "the data are fitted to their noise"
    assert found.history[-1]["chi2"] <= 1.0


def test_either_space_gives_the_same_map(cube: Recording) -> None:
    maps = [
        invert_map(cube, Settings(optimizer=GaussNewton(max_iterations=3, space=space))).youngs
        for space in ("data", "parameter")
    ]
    np.testing.assert_allclose(maps[0], maps[1], rtol=1e-6)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_noise_is_not_fitted(make_cube: Make, seed: int) -> None:
    """The discrepancy principle ends near a mean squared residual of one, from either side."""
    noisy = make_cube(snr_db=30.0, seed=seed)
    found = invert_map(noisy)
    assert found.stop_reason == "the data are fitted to their noise"
    assert 0.9 <= found.history[-1]["chi2"] <= 1.02
    assert noisy.truth is not None
    assert pearson(found.youngs, noisy.truth) > 0.6
    assert found.youngs.max() < 4.0  # nothing runs off to the bounds


def test_understated_noise_is_said_so(make_tiny: Make) -> None:
    noisy = make_tiny(faces=("z+", "x+", "y-"), snr_db=20.0)
    presses = tuple(replace(press, noise_mm=None) for press in noisy.presses)
    optimizer = GaussNewton(max_iterations=100)
    found = invert_map(replace(noisy, presses=presses), Settings(optimizer=optimizer))
    assert found.history[-1]["chi2"] > 10.0
    assert "fitted to their noise" not in found.stop_reason or "larger" in found.stop_reason


@pytest.mark.parametrize("name", NAMES)
def test_limits_of_iterations_hold(recording: Recording, name: str) -> None:
    limit = {"tnc": "max_evaluations"}.get(name, "max_iterations")
    found = invert_map(recording, Settings(optimizer=OPTIMIZERS.build({"name": name, limit: 4})))
    assert "limit reached" in found.stop_reason
    spent = found.history[-1]["evaluations"] if name == "tnc" else found.iterations
    assert spent <= 5
    assert found.misfit_mm2 < found.history[0]["misfit"]


@pytest.mark.parametrize("name", NAMES)
def test_starting_at_the_solution_stops(recording: Recording, name: str) -> None:
    optimizer = OPTIMIZERS.build({"name": name, **SHORT[name]})
    assert recording.truth is not None
    settings = Settings(optimizer=optimizer, regularization=UNWEIGHTED)
    found = invert_map(recording, settings, start_mpa=recording.truth)
    np.testing.assert_allclose(found.youngs, recording.truth, rtol=1e-3)
    assert found.stop_reason


@pytest.mark.parametrize("name", NAMES)
def test_maps_without_equilibrium_are_stepped_back_from(
    recording: Recording, name: str, fail_evaluation: Callable[[int, BaseException], None]
) -> None:
    fail_evaluation(4, ConvergenceError("collapsed"))
    found = run(recording, name)
    assert found.misfit_mm2 < 0.1 * found.history[0]["misfit"]
    assert "collapsed" not in found.stop_reason
    assert found.iterations > 4


@pytest.mark.parametrize("name", NAMES)
def test_parameters_stay_in_their_limits(recording: Recording, name: str) -> None:
    """Not the moduli alone, which are cut to the bounds in any case."""
    settings = Settings(bounds=Bounds(0.19, 0.34), regularization=UNWEIGHTED)
    objective = make_objective(recording, settings)
    monitor = Monitor()
    start = np.full(recording.mesh.n_tets, np.log(0.25))
    OPTIMIZERS.build({"name": name, **SHORT[name]}).minimize(objective, start, monitor)
    low, high = objective.elements.parameterization.limits
    assert monitor.best is not None
    assert low <= monitor.best.min() < monitor.best.max() == high


@pytest.mark.parametrize("name", NAMES)
def test_a_start_without_equilibrium_is_refused(
    recording: Recording, name: str, fail_evaluation: Callable[[int, BaseException], None]
) -> None:
    fail_evaluation(1, ConvergenceError("collapsed"))
    with pytest.raises(ConvergenceError, match="collapsed"):
        run(recording, name)


@pytest.mark.parametrize("name", ["tnc", "lbfgs"])
@pytest.mark.parametrize("end", ["limit", "interruption"])
def test_the_lowest_point_seen_is_the_result(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, name: str, end: str
) -> None:
    """SciPy's methods may end between two of their iterations."""
    seen: list[float] = []
    evaluate = InverseProblem.evaluate

    def watched(problem: InverseProblem, *args: Any, **kwargs: Any) -> Any:
        found = evaluate(problem, *args, **kwargs)
        seen.append(found.misfit_mm2)
        if end == "interruption" and len(seen) == 12:
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr(InverseProblem, "evaluate", watched)
    limit = {"max_evaluations": 9} if name == "tnc" else {"max_iterations": 9}
    limit = {k: 100 if end == "interruption" else v for k, v in limit.items()}
    settings = Settings(optimizer={"name": name, **limit}, regularization=UNWEIGHTED)
    found = invert_map(recording, settings)
    complete = seen[:-1] if end == "interruption" else seen
    assert found.misfit_mm2 == min(complete)
    assert found.stop_reason == ("interrupted" if end == "interruption" else found.stop_reason)


def test_lbfgs_lowers_the_weight_in_stages(recording: Recording) -> None:
    optimizer = LBFGS(max_iterations=12, stage_iterations=3)
    found = invert_map(recording, Settings(optimizer=optimizer))
    weight = series(found, "weight")
    assert (np.diff(weight) <= 0).all()
    assert len(np.unique(weight)) == 4


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("gauss_newton", {"max_iterations": 0}, "max_iterations=0"),
        ("gauss_newton", {"tolerance": -1.0}, "tolerance"),
        ("gauss_newton", {"damping": 0.0}, "damping"),
        ("gauss_newton", {"max_trials": 0}, "max_trials"),
        ("gauss_newton", {"space": "dual"}, "space='dual': give auto, data or parameter"),
        ("gauss_newton", {"step": 1}, "optimizer.step"),
        ("tnc", {"max_evaluations": 0}, "max_evaluations"),
        ("tnc", {"ftol": 0.0}, "ftol"),
        ("lbfgs", {"memory": 0}, "memory"),
        ("lbfgs", {"stage_iterations": -3}, "stage_iterations=-3"),
        (
            "adam",
            {},
            "optimizer=adam is unknown; choose one of gauss_newton, newton_cg, tnc, lbfgs",
        ),
    ],
)
def test_wrong_settings_are_refused(name: str, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        OPTIMIZERS.build({"name": name, **settings})


@pytest.mark.parametrize("name", NAMES)
def test_names_lead_to_optimizers(name: str) -> None:
    optimizer = OPTIMIZERS.build(name)
    assert isinstance(optimizer, Optimizer)
    assert OPTIMIZERS.name_of(type(optimizer)) == name


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_wrong_weights_are_refused(weight: float) -> None:
    with pytest.raises(ConfigError, match=rf"regularization\.weight={weight}: give a number, at"):
        TotalVariation(weight=weight)


def test_projected_gradient_drops_what_pushes_outward() -> None:
    x = np.array([0.0, 0.0, 0.5, 1.0, 1.0])
    gradient = np.array([1.0, -1.0, 1.0, 1.0, -1.0])
    np.testing.assert_array_equal(
        projected_gradient(x, gradient, (0.0, 1.0)), [0.0, -1.0, 1.0, 1.0, 0.0]
    )
