"""Correlated errors of forces and displacements in an inversion."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse import InverseProblem, Settings
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.covariance import ErrorModel
from tactorch.inverse.errors.stated import Stated
from tactorch.inverse.invert import make_objective
from tactorch.inverse.search import find_shapes
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Press, PressErrors, Recording
from tactorch.simulation import PressPlan, simulate

STIFFNESS = 0.6  # of a gel, N/mm for each node


def gel_errors(press: Press, count: int, seed: int, size_mm: float = 0.004) -> PressErrors:
    """Smooth errors of displacements, with forces that a soft gel has with them."""
    nodes = np.flatnonzero(press.forces.any(axis=1))
    rng = np.random.default_rng(seed)
    moved = size_mm * rng.normal(size=(count, len(nodes), 3))
    return PressErrors(nodes, -STIFFNESS * moved, moved)


def disturbed(press: Press, errors: PressErrors, numbers: np.ndarray) -> Press:
    """The press as recorded with a sum of the errors."""
    forces, displacement = press.forces.copy(), press.displacement.copy()
    forces[errors.nodes] += np.einsum("q,qla->la", numbers, errors.forces)
    displacement[errors.nodes] += np.einsum("q,qla->la", numbers, errors.displacement)
    return replace(press, forces=forces, displacement=displacement, errors=errors)


def with_errors(recording: Recording, numbers: np.ndarray | None, **more: float) -> Recording:
    """A recording with errors of ten patterns in each press."""
    presses = []
    for i, press in enumerate(recording.presses):
        errors = gel_errors(press, 10, i, **more)
        drawn = np.random.default_rng(100 + i).normal(size=10) if numbers is None else numbers
        presses.append(disturbed(press, errors, drawn))
    return replace(recording, presses=tuple(presses))


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_patterns_are_changes_of_the_residuals(
    recording: Recording, moduli: np.ndarray, element: str
) -> None:
    given = with_errors(recording, np.zeros(10))
    problem = InverseProblem(given, element=element)
    stated = Stated()
    stated.smallest = 0.0
    found = stated.patterns(MeasuredPresses(problem, linearised=problem.evaluate(moduli)))

    def residuals(numbers: np.ndarray) -> np.ndarray:
        other = InverseProblem(with_errors(recording, numbers), element=element)
        # The residual is the prediction less the data.
        change = problem.data.scale * np.concatenate(
            [o.values - x for o, x in zip(
                other.data.observations, other.evaluate(moduli).predicted, strict=True
            )]
        )  # fmt: skip
        return change

    step = 1e-3 * np.eye(10)
    wanted = np.column_stack([(residuals(n) - residuals(-n)) / 2e-3 for n in step])
    ends = np.cumsum(problem.data.counts)
    for begin, end in zip([0, *ends[:-1]], ends, strict=True):
        own = wanted[begin:end] @ wanted[begin:end].T
        np.testing.assert_allclose(
            (found @ found.T)[begin:end, begin:end], own, atol=1e-4 * np.abs(own).max()
        )
    assert not (found @ found.T)[: ends[0], ends[0] :].any()


def test_residuals_are_as_large_as_the_errors_allow(recording: Recording) -> None:
    truth = np.asarray(recording.truth)
    given = with_errors(recording, None, size_mm=0.0005)
    noisy = replace(given, presses=tuple(replace(p, noise_mm=1e-4) for p in given.presses))
    problem = InverseProblem(noisy)
    evaluation = problem.evaluate(truth)
    patterns = Stated().patterns(MeasuredPresses(problem, linearised=evaluation))
    data = problem.data.with_errors(patterns)
    squares = [float(np.sum(d.whiten(evaluation.residuals) ** 2)) for d in (problem.data, data)]
    assert squares[1] < 40.0  # twenty numbers of unit deviation
    assert squares[0] > 100.0


def test_their_response_is_kept_while_the_map_hardly_changes(
    recording: Recording, moduli: np.ndarray
) -> None:
    problem = InverseProblem(with_errors(recording, np.zeros(10)))
    errors = ErrorModel(MeasuredPresses(problem), [Stated()])

    def after(youngs: np.ndarray) -> np.ndarray:
        errors.linearise(problem.evaluate(youngs), "quadratic")
        return errors.data({"stated": 1.0}).whiten(np.eye(len(problem.data.values))[:, 0])

    first = after(moduli)
    np.testing.assert_array_equal(after(1.04 * moduli), first)
    changed = after(1.1 * moduli)
    assert np.abs(changed - first).max() > 1e-6
    # Changes add up: they are from the model that it was computed at.
    np.testing.assert_array_equal(after(1.06 * moduli), changed)
    assert np.abs(after(1.04 * moduli) - changed).max() > 1e-6


def test_a_map_counts_them(recording: Recording) -> None:
    problems = [
        make_objective(r, Settings()).problem for r in (recording, with_errors(recording, None))
    ]
    assert [Stated().least(MeasuredPresses(problem)) for problem in problems] == [None, 1.0]
    correlated = [problem.data.correlated for problem in problems]
    assert correlated[0] is None
    assert correlated[1] is not None
    assert correlated[1].patterns.shape == (len(problems[1].data.scale), 20)


def test_no_inclusion_is_found_in_their_place() -> None:
    mesh = box_mesh(10.0, 4, tets_per_cell=5)
    plan = PressPlan(("z+", "x+"), (0.01,))
    body = simulate(make_phantom("uniform_cube"), plan, mesh=mesh, element="tet10", snr_db=40.0)
    given = with_errors(body, None, size_mm=0.003)
    unknown = replace(given, presses=tuple(replace(p, errors=None) for p in given.presses))
    known, white = (ShapeProblem(each, Settings()).uniform().fit.chi2 for each in (given, unknown))
    assert white > 100.0 * known
    assert not find_shapes(given).inclusions
