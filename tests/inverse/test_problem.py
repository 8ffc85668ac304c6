"""Predictions, misfit and derivatives of a recording, against autograd and finite differences."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import ELEMENTS, SoftBody, Supports, make_material
from tactorch.inverse import Evaluation, InverseProblem, NoiseModel
from tactorch.inverse.data.observations import DataModel, Observation, group_by_contact, signal_rms
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.forces import Forces
from tactorch.inverse.errors.pose import RigidMotion
from tactorch.linalg import limit_workers
from tactorch.recording import Press, Recording

Make = Callable[..., Recording]


def with_press(recording: Recording, index: int, **changes: object) -> Recording:
    presses = list(recording.presses)
    presses[index] = replace(presses[index], **changes)
    return replace(recording, presses=tuple(presses), check_units=False)


def solve_with_autograd(recording: Recording, element: str, youngs: torch.Tensor) -> torch.Tensor:
    """Observed displacements of all presses by the public mechanics."""
    law = recording.material
    body = SoftBody(recording.mesh, make_material(law.name, law.poisson), element=element)
    seen = []
    for press in recording.presses:
        supports = Supports(press.fixed, press.prescribed, press.springs)
        u = body.solve(youngs, torch.from_numpy(press.forces), supports)
        seen.append(u[: recording.mesh.n_points][torch.from_numpy(press.data)])
    return torch.cat(seen)


def half_chi2_sum(problem: InverseProblem, youngs: np.ndarray) -> float:
    evaluation = problem.evaluate(youngs)
    return 0.5 * evaluation.chi2 * problem.n_data


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_jacobian_is_autograds(recording: Recording, moduli: np.ndarray, element: str) -> None:
    problem = InverseProblem(recording, element=element)
    deviation = problem.noise.deviations(recording)[0]
    jacobian = problem.evaluate(moduli).jacobian() * deviation
    expected = torch.autograd.functional.jacobian(
        lambda e: solve_with_autograd(recording, element, e), torch.from_numpy(moduli)
    ).numpy()
    assert jacobian.shape == (problem.n_data, problem.n_elements) == expected.shape
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_jacobian_is_the_finite_difference(
    recording: Recording, moduli: np.ndarray, element: str
) -> None:
    problem = InverseProblem(recording, element=element)
    jacobian = problem.evaluate(moduli).jacobian()
    direction = np.random.default_rng(0).standard_normal(len(moduli))
    h = 1e-5
    plus, minus = (problem.evaluate(moduli + s * h * direction).residuals for s in (1, -1))
    expected = (plus - minus) / (2 * h)
    np.testing.assert_allclose(
        jacobian @ direction, expected, rtol=0, atol=1e-6 * np.abs(expected).max()
    )


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_products_are_those_of_the_matrix(
    recording: Recording, moduli: np.ndarray, element: str
) -> None:
    rng = np.random.default_rng(1)
    for sensitivity in InverseProblem(recording, element=element).evaluate(moduli).sensitivities:
        matrix = sensitivity.matrix()
        change, weights = rng.standard_normal(matrix.shape[1]), rng.standard_normal(len(matrix))
        scale = np.abs(matrix).max()
        np.testing.assert_allclose(
            sensitivity.times_each(change[None])[0][:, 0], matrix @ change, atol=1e-9 * scale
        )
        np.testing.assert_allclose(
            sensitivity.transpose_times(weights), matrix.T @ weights, atol=1e-9 * scale
        )


def test_gradient_is_that_of_half_the_sum_of_squares(make_tiny: Make, moduli: np.ndarray) -> None:
    recording = make_tiny(snr_db=30.0)
    weights = np.random.default_rng(5).uniform(0.5, 2.0, recording.presses[0].forces.shape)
    problem = InverseProblem(with_press(recording, 0, weights=weights))
    evaluation = problem.evaluate(moduli)
    gradient = evaluation.gradient()
    np.testing.assert_allclose(gradient, evaluation.jacobian().T @ evaluation.residuals, rtol=1e-8)
    for element in (0, 17, 39):
        h = 1e-6 * np.eye(len(moduli))[element]
        slope = (half_chi2_sum(problem, moduli + h) - half_chi2_sum(problem, moduli - h)) / 2e-6
        assert gradient[element] == pytest.approx(slope, rel=1e-5)


def test_gradient_first_and_jacobian_first_agree(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    one, other = problem.evaluate(moduli), problem.evaluate(moduli)
    other.jacobian()  # renews the factorisation
    np.testing.assert_allclose(one.gradient(), other.gradient(), rtol=1e-9)


def test_misfit_is_equation_7_in_mm2(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    evaluation = problem.evaluate(moduli)
    by_hand = 0.0
    for press, u in zip(recording.presses, evaluation.displacements, strict=True):
        for node, axis in zip(*np.nonzero(press.observed), strict=True):
            by_hand += 0.5 * (u[node, axis] - press.displacement[node, axis]) ** 2
    assert evaluation.misfit_mm2 == pytest.approx(by_hand, rel=1e-12)
    sigma = 1e-4 * signal_rms(recording.presses)
    assert evaluation.chi2 == pytest.approx(2 * by_hand / sigma**2 / problem.n_data, rel=1e-12)


def test_misfit_vanishes_at_the_truth(make_tiny: Make) -> None:
    for element in ELEMENTS.names():  # a recording has springs on vertices only, so hold it exactly
        recording = make_tiny(support="fixed", element=element)
        assert recording.truth is not None
        evaluation = InverseProblem(recording, element=element).evaluate(recording.truth)
        assert evaluation.misfit_mm2 < 1e-16
        assert InverseProblem(recording, element=element).n_data == 54


def test_weights_scale_residuals_and_leave_the_misfit(
    recording: Recording, moduli: np.ndarray
) -> None:
    plain = InverseProblem(recording).evaluate(moduli)
    weights = np.full(recording.presses[1].forces.shape, 3.0)
    weighted = InverseProblem(with_press(recording, 1, weights=weights)).evaluate(moduli)
    factor = np.repeat([1.0, 3.0], 27)
    np.testing.assert_allclose(weighted.residuals, plain.residuals * factor, rtol=1e-9)
    assert weighted.misfit_mm2 == pytest.approx(plain.misfit_mm2, rel=1e-9)


def test_data_of_no_weight_count_nowhere(recording: Recording, moduli: np.ndarray) -> None:
    """Were they kept, the mean squared residual would look better than the fit is."""
    press = recording.presses[0]
    weights = np.where(np.cumsum(press.observed).reshape(-1, 3) % 2 == 1, 1.0, 0.0)
    fewer = np.where(weights > 0, press.observed, False)
    weighted = InverseProblem(with_press(recording, 0, weights=weights))
    unseen = InverseProblem(with_press(recording, 0, observed=fewer))
    assert weighted.n_data == unseen.n_data == 14 + 27
    one, other = weighted.evaluate(moduli), unseen.evaluate(moduli)
    assert one.misfit_mm2 == other.misfit_mm2
    assert one.jacobian().shape == (41, 40)


def test_fixed_freedoms_are_no_data(recording: Recording, moduli: np.ndarray) -> None:
    press = recording.presses[0]
    fixed = np.zeros_like(press.observed)
    fixed[np.flatnonzero(press.observed[:, 0])[0]] = True
    problem = InverseProblem(with_press(recording, 0, fixed=fixed))
    assert problem.n_data == 51
    assert np.isfinite(problem.evaluate(moduli).gradient()).all()


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_gravity_enters(make_tiny: Make, element: str) -> None:
    heavy = make_tiny(support="fixed", density=1.07e-7, element=element)  # a hundred times silicone
    assert heavy.truth is not None
    problem = InverseProblem(heavy, element=element)
    assert problem.evaluate(heavy.truth).misfit_mm2 < 1e-14
    light = InverseProblem(replace(heavy, density=None, gravity=np.zeros(3)), element=element)
    assert light.evaluate(heavy.truth).misfit_mm2 > 1e-2


def test_prediction_is_second_order(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    here = problem.evaluate(moduli)
    change = moduli * np.random.default_rng(2).uniform(-1, 1, len(moduli))
    unchanged = here.predict(moduli + 0.01 * change)
    np.testing.assert_array_equal(unchanged, here.displacements)
    assert here.sensitivities  # linearised presses predict

    def errors(size: float) -> np.ndarray:
        there = moduli + size * change
        truth = problem.evaluate(there).displacements
        return np.array(
            [np.abs(p - u).max() for p, u in zip(here.predict(there), truth, strict=True)]
        )

    ratios = errors(0.02) / errors(0.01)
    assert ((ratios > 3.5) & (ratios < 4.5)).all()


def test_no_prediction_far_away(recording: Recording, moduli: np.ndarray) -> None:
    here = InverseProblem(recording).evaluate(moduli)
    far = moduli.copy()
    far[3] *= 2.0
    for guess, u in zip(here.predict(far), here.displacements, strict=True):
        np.testing.assert_array_equal(guess, u)


def test_a_near_start_changes_nothing(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    other = moduli * 1.1
    cold = problem.evaluate(other)
    warm = problem.evaluate(other, near=problem.evaluate(moduli))
    np.testing.assert_allclose(warm.displacements, cold.displacements, rtol=0, atol=1e-9)
    assert problem.evaluations == 3


def test_collapse_names_the_press(make_tiny: Make) -> None:
    recording = make_tiny(faces=("z+",), pressures=(1e-4, 0.02))
    problem = InverseProblem(recording)
    soft = np.full(problem.n_elements, 0.001)
    with pytest.raises(ConvergenceError, match=r"'z\+, 20 kPa' \(index 1\).*collapses"):
        problem.evaluate(soft)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_useless_moduli_are_refused(recording: Recording, moduli: np.ndarray, bad: float) -> None:
    moduli[7] = bad
    with pytest.raises(ConfigError, match=r"youngs\[7\]"):
        InverseProblem(recording).evaluate(moduli)


def test_wrong_number_of_moduli_is_refused(recording: Recording) -> None:
    with pytest.raises(ConfigError, match="40 elements"):
        InverseProblem(recording).evaluate(np.ones(41))


@pytest.mark.parametrize(("field", "name"), [("element", "hex8"), ("solver", "magic")])
def test_unknown_numerics_are_refused(recording: Recording, field: str, name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        InverseProblem(recording, **{field: name}).evaluate(np.ones(40))


def test_stated_noise_is_taken_above_the_floor(make_tiny: Make) -> None:
    recording = make_tiny(snr_db=40.0)
    recording = with_press(recording, 1, noise_mm=0.0)
    floor = 1e-4 * signal_rms(recording.presses)
    stated = recording.presses[0].noise_mm
    assert stated is not None
    assert stated > floor
    assert NoiseModel().deviations(recording) == [stated, floor]
    np.testing.assert_allclose(NoiseModel(relative=0.5).deviations(recording), 5000 * floor)
    assert NoiseModel(mm=0.25).deviations(recording) == [0.25] * 2
    assert not NoiseModel().assumed(recording)
    assert NoiseModel().floored(recording)
    assert not NoiseModel(relative=1e-9).floored(make_tiny(snr_db=40.0))
    assert not NoiseModel(mm=0.25).floored(recording)
    assert NoiseModel(mm=1e-9).floored(recording)


def test_unstated_noise_is_assumed_and_said_so(recording: Recording) -> None:
    values = np.concatenate([p.displacement[p.observed] for p in recording.presses])
    rms = np.sqrt(np.mean(values**2))
    np.testing.assert_allclose(NoiseModel(relative=0.01).deviations(recording), 0.01 * rms)
    assert NoiseModel().assumed(recording)
    assert NoiseModel().floored(recording)
    assert not NoiseModel(mm=0.1).assumed(recording)


def test_unloaded_frames_tell_the_noise(recording: Recording) -> None:
    """A drift, stray markers and unseen nodes do not count."""
    rng = np.random.default_rng(0)
    frames = 0.01 * rng.standard_normal((12, recording.mesh.n_points, 3))
    frames += 0.002 * np.arange(12)[:, None, None]
    frames[rng.random(frames.shape) < 0.02] = 5.0
    frames[:, :3] = np.nan
    shown = replace(recording, unloaded=frames)
    np.testing.assert_allclose(NoiseModel().deviations(shown), 0.01, rtol=0.12)
    assert not NoiseModel().assumed(shown)
    assert not NoiseModel().floored(shown)
    assert NoiseModel(mm=0.25).deviations(shown) == [0.25] * 2
    stated = with_press(shown, 0, noise_mm=0.03)
    assert NoiseModel().deviations(stated)[0] == 0.03


@pytest.mark.parametrize("settings", [{"relative": 0.0}, {"relative": 1.0}, {"mm": 0.0}])
def test_useless_noise_is_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"noise.{next(iter(settings))}"):
        NoiseModel(**settings)


def test_presses_that_moved_nothing_are_refused(recording: Recording) -> None:
    still: list[Press] = [
        replace(press, displacement=np.zeros_like(press.displacement))
        for press in recording.presses
    ]
    with pytest.raises(ConfigError, match="moved nothing"):
        InverseProblem(replace(recording, presses=tuple(still), check_units=False))


@pytest.mark.parametrize("threads", [1, 2])
def test_a_chain_of_presses_predicts_the_same(recording: Recording, threads: int) -> None:
    problem = InverseProblem(recording)
    youngs = np.random.default_rng(0).uniform(0.1, 0.4, problem.n_elements)
    beside = problem.evaluate(youngs)
    with limit_workers(threads):
        chained = problem.evaluate(youngs, chained=True)
    for a, b in zip(beside.reported, chained.reported, strict=True):
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-9 * np.abs(a).max())
    searches = [chained.search(i) for i in range(len(recording.presses))]
    assert sum(search.lease._solver is not None for search in searches) == threads


def test_the_linear_response_has_each_change(recording: Recording, moduli: np.ndarray) -> None:
    evaluation = InverseProblem(recording).evaluate(moduli)
    changes = np.random.default_rng(0).normal(size=(3, len(moduli)))
    found = evaluation.linear_response(changes)[0]
    for column, change in zip(found.T, changes, strict=True):
        np.testing.assert_allclose(column, evaluation.jacobian_times(change), rtol=1e-9)


def test_the_last_linear_response_is_kept_with_other_data(
    recording: Recording, moduli: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluation = InverseProblem(recording).evaluate(moduli)
    first, second = np.random.default_rng(0).normal(size=(2, 3, len(moduli)))
    found, fields = evaluation.linear_response(first)
    wider = evaluation.with_data(evaluation.data.widened(np.full(len(recording.presses), 2.0)))
    with monkeypatch.context() as patch:
        patch.setattr("tactorch.fem.Sensitivity.times_each", None)  # nothing is solved
        same, same_fields = wider.linear_response(first.copy())
    np.testing.assert_allclose(same, 0.5 * found, rtol=1e-12)
    np.testing.assert_array_equal(same_fields, fields)
    for column, change in zip(wider.linear_response(second)[0].T, second, strict=True):
        np.testing.assert_allclose(column, wider.jacobian_times(change), rtol=1e-9)


@pytest.mark.parametrize(("size", "wider"), [(0.05, 1e6), (3.0, 1e6), (0.05, 1.0)])
def test_the_linear_response_after_a_step_is_derived_from_that_before_where_it_is_accurate(
    recording: Recording, moduli: np.ndarray, size: float, wider: float
) -> None:
    """The moduli change in two parts of the body by the logarithms of two factors.

    With wider deviations the data are explained.
    """
    problem = InverseProblem(recording, derivative_rtol=1e-9)
    widened = problem.data.widened(np.full(len(recording.presses), wider))
    problem = problem.with_data(widened)
    parts = np.arange(len(moduli)) % 3 == np.arange(2)[:, None]
    step = size * np.array([1.0, 0.5])
    before = problem.evaluate(moduli)
    old, _ = before.linear_response(parts * moduli)
    youngs = moduli * np.exp(step @ parts)
    exact, derived = problem.evaluate(youngs), problem.evaluate(youngs)
    derived.update_response(parts * youngs, before, step)
    assert (derived._response is not None) == (size < 1.0 and wider > 1.0)
    columns, fields = derived.linear_response(parts * youngs)
    true, true_fields = exact.linear_response(parts * youngs)
    along = true @ step
    error = np.linalg.norm(columns @ step - along)
    assert error < 0.1 * np.linalg.norm(old @ step - along)
    for field, known in zip(fields, true_fields, strict=True):
        change = np.tensordot(step, known, 1)
        np.testing.assert_allclose(
            np.tensordot(step, field, 1), change, atol=5e-3 * np.abs(change).max()
        )


def force_patterns(problem: InverseProblem, evaluation: Evaluation, smallest: float) -> np.ndarray:
    forces = Forces()
    forces.smallest = smallest
    return forces.patterns(MeasuredPresses(problem, linearised=evaluation)).toarray()


def test_force_patterns_are_changes_by_errors_of_the_forces(
    recording: Recording, moduli: np.ndarray
) -> None:
    problem = InverseProblem(recording)
    patterns = force_patterns(problem, problem.evaluate(moduli), 0.0)
    counts, step = problem.data.counts, 1e-5
    forces, points = recording.presses[0].forces, recording.mesh.points
    loaded = np.flatnonzero(forces.any(axis=1))
    first = patterns[: counts[0], patterns[: counts[0]].any(axis=0)]
    assert not patterns[counts[0] :, : first.shape[1]].any()

    def change(shape: np.ndarray) -> np.ndarray:
        ends = [
            InverseProblem(
                with_press(recording, 0, forces=forces * np.exp(sign * step * shape[:, None]))
            ).evaluate(moduli)
            for sign in (1, -1)
        ]
        residuals: np.ndarray = (ends[0].residuals - ends[1].residuals)[: counts[0]]
        return residuals / (2.0 * step)

    offsets = points - np.average(points, axis=0, weights=np.linalg.norm(forces, axis=1))
    sizes = np.sqrt(np.average(offsets**2, axis=0, weights=np.linalg.norm(forces, axis=1)))
    # A square side: its gradients are those along any two axes in it.
    gradients = [offsets[:, k] / sizes[k] for k in range(3) if sizes[k] > 1e-9]
    shapes = [np.ones(len(points)), *gradients, *np.eye(len(points))[loaded]]
    expected = np.column_stack([change(shape) for shape in shapes])
    covariance = expected @ expected.T
    np.testing.assert_allclose(first @ first.T, covariance, atol=1e-3 * covariance.max())


def test_a_press_without_forces_has_no_force_patterns(
    recording: Recording, moduli: np.ndarray
) -> None:
    forces = recording.presses[0].forces
    fixed, prescribed = np.zeros(forces.shape, dtype=bool), np.zeros_like(forces)
    fixed[:, 2] = forces[:, 2] != 0.0
    prescribed[fixed] = -0.1
    moved = {"forces": np.zeros_like(forces), "fixed": fixed, "prescribed": prescribed}
    problem = InverseProblem(with_press(recording, 0, **moved))
    patterns = force_patterns(problem, problem.evaluate(moduli), 0.0)
    assert len(patterns) == sum(problem.data.counts)
    assert not patterns[: problem.data.counts[0]].any()
    assert patterns.any()


def test_small_force_patterns_are_left_out(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    evaluation = problem.evaluate(moduli)
    norms = np.linalg.norm(force_patterns(problem, evaluation, 0.0), axis=0)
    middle = float(np.median(norms))
    kept = np.linalg.norm(force_patterns(problem, evaluation, middle), axis=0)
    np.testing.assert_allclose(np.sort(kept), np.sort(norms[norms > middle]))


def test_rigid_patterns_are_motions_of_a_place(recording: Recording) -> None:
    """Two presses of one place and one of another: twelve motions, linear in the positions."""
    problem = InverseProblem(recording)
    points, observations = recording.mesh.points, problem.data.observations
    first, *others = observations
    other = next(
        o for o in others if len(o.index) != len(first.index) or (o.index != first.index).any()
    )
    data = DataModel((first, replace(first, values=2.0 * first.values), other))
    presses = MeasuredPresses(problem.with_data(data), [(0, 1), (2,)])
    patterns = RigidMotion().patterns(presses)
    n = len(first.index)
    assert patterns.shape == (2 * n + len(other.index), 12)
    np.testing.assert_allclose(patterns[n : 2 * n, :6], 2.0 * patterns[:n, :6])
    assert not patterns[2 * n :, :6].any()
    assert not patterns[: 2 * n, 6:].any()
    span = patterns[:n, :6] / first.scale[:, None]
    for axis in np.eye(3):
        turn = np.cross(axis, points).ravel()[first.index]
        shift = np.tile(axis, len(points))[first.index]
        for motion in (turn, shift):
            found = span @ np.linalg.lstsq(span, motion, rcond=None)[0]
            np.testing.assert_allclose(found, motion, atol=1e-9 * np.abs(motion).max())
    # A shift along x, of unit deviation, is as large as the displacement.
    shift = np.tile([1.0, 0.0, 0.0], len(points))[first.index]
    part = np.linalg.lstsq(span, shift, rcond=None)[0]
    rms = np.linalg.norm(first.values) / np.sqrt(n)
    assert 1.0 / np.linalg.norm(part) == pytest.approx(rms, rel=1e-6)


def test_rigid_patterns_of_one_observed_axis(recording: Recording) -> None:
    """A shift, and two turns about axes in the plane, of the whole size of the displacement."""
    problem = InverseProblem(recording)
    first = problem.data.observations[0]
    kept = first.index % 3 == 2
    single = Observation(first.index[kept], first.values[kept], first.scale[kept])
    presses = MeasuredPresses(problem.with_data(DataModel((single,))), [(0,)])
    span = RigidMotion().patterns(presses) / single.scale[:, None]
    assert span.shape == (kept.sum(), 3)
    part = np.linalg.lstsq(span, np.ones(kept.sum()), rcond=None)[0]
    rms = np.linalg.norm(single.values) / np.sqrt(kept.sum())
    assert 1.0 / np.linalg.norm(part) == pytest.approx(rms, rel=1e-6)


def test_presses_of_one_contact_differ_by_a_factor(recording: Recording) -> None:
    press = recording.presses[0]
    stronger = replace(press, forces=2.0 * press.forces)
    weights = np.ones_like(press.forces)
    weights[np.flatnonzero(press.observed.any(axis=1))[0]] = 0.0
    masked = replace(press, weights=weights)
    oblique = replace(press, forces=press.forces + np.abs(press.forces[:, [2, 0, 1]]))
    softer = replace(press, springs=0.5 * press.springs)
    presses = (press, stronger, masked, oblique, softer)
    assert group_by_contact(presses) == [(0, 1), (2,), (3,), (4,)]


def test_other_statistics_of_the_same_data(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    evaluation = problem.evaluate(moduli)
    patterns = np.random.default_rng(0).normal(size=(sum(problem.data.counts), 2))
    data = problem.data.with_errors(patterns)
    expected = problem.with_data(data).evaluate(moduli)
    found = evaluation.with_data(data)
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-8, atol=1e-10)
    covariance = np.eye(len(patterns)) + patterns @ patterns.T
    assert data.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])
    raw, white = evaluation.residuals, found.residuals
    assert white @ white == pytest.approx(raw @ np.linalg.solve(covariance, raw))
    both = data.with_errors(patterns).log_determinant
    covariance += patterns @ patterns.T
    assert both == pytest.approx(np.linalg.slogdet(covariance)[1])


def test_shifted_data_shift_the_residuals(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    shifts = [np.full(count, 0.01) for count in problem.data.counts]
    before = problem.evaluate(moduli)
    after = before.with_data(problem.data.shifted(shifts))
    expected = before.residuals - 0.01 * problem.data.scale
    np.testing.assert_allclose(after.residuals, expected, rtol=1e-9, atol=1e-12)


def test_equilibria_start_where_they_are_told(recording: Recording, moduli: np.ndarray) -> None:
    problem = InverseProblem(recording)
    first = problem.evaluate(moduli)
    again = problem.evaluate(moduli, starts=first.displacements)
    np.testing.assert_allclose(again.residuals, first.residuals, atol=1e-7)
    assert again.search(0) is not first.search(0)


@pytest.mark.parametrize("derivative_rtol", [0.0, 1e-3])  # one lease each, and a shared one
def test_presses_at_other_rest_shapes_are_those_of_another_mesh(
    recording: Recording, moduli: np.ndarray, derivative_rtol: float
) -> None:
    """Presses whose elements are inverted are left out."""
    mesh = recording.mesh
    evaluation = InverseProblem(recording, derivative_rtol=derivative_rtol).evaluate(moduli)
    wider = mesh.points * np.array([1.02, 1.0, 1.0])
    inverted = mesh.points * np.array([-1.0, 1.0, 1.0])
    found = evaluation.at_rest_shapes({0: wider, 1: inverted})
    assert found.keys() == {0}
    other = replace(recording, mesh=replace(mesh, points=wider), check_units=False)
    expected = InverseProblem(other).evaluate(moduli).predicted[0]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found[0], expected, atol=1e-7 * scale)
    assert np.abs(found[0] - evaluation.predicted[0]).max() > 1e-3 * scale
