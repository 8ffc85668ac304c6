"""Weights of presses by how well any map can fit them: for presses worse than they state."""

import logging
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.inverse.misfit import Squares
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers import GaussNewton
from tactorch.inverse.uniform import uniform_fit

_log = logging.getLogger(__name__)
_ITERATIONS = 30
_WORTH_SAYING = 2.0


def adapt(objective: Objective) -> Float[np.ndarray, " presses"]:
    """Widen the deviations of presses that stand out, and go over to least squares.

    A first inversion, by the convex cost of `Adaptive`, bounds what a bad press can do to the map.
    A press whose residuals there are larger than the median press's (and than stated) gets their
    size as its deviation. Most presses must be as good as they state. (A `Press` is one frame, so
    a bad frame of a good series is told apart.) It is Gauss-Newton whatever the optimizer of the
    inversion that follows, of a few dozen steps.

    Args:
        objective: Its problem has the misfit "adaptive"; it is changed.

    Returns:
        The factor of each press's deviation, 1 or more.

    Raises:
        ConvergenceError: no uniform map carries the presses.
    """
    problem = objective.problem
    fit = uniform_fit(problem, objective.parameterization.bounds, objective.nuisance)
    monitor = Monitor()
    start = objective.start(np.full(problem.n_elements, fit.youngs_mpa))
    GaussNewton(max_iterations=_ITERATIONS).minimize(
        replace(objective, weight=None), start, monitor
    )
    assert monitor.point is not None
    found = monitor.point.evaluation.chi2_of_presses
    factors = np.sqrt(np.maximum(1.0, found / max(1.0, float(np.median(found)))))
    problem.observations = [
        replace(seen, scale=seen.scale / factor)
        for seen, factor in zip(problem.observations, factors, strict=True)
    ]
    if problem.common is not None:  # the model's error is as large as before
        counts = [len(seen.index) for seen in problem.observations]
        problem.common = problem.common.widened(np.repeat(factors, counts))
    problem.misfit = Squares()
    for press, factor in zip(problem.recording.presses, factors, strict=True):
        if factor > _WORTH_SAYING:
            _log.warning(
                "%s is %.2g times as noisy as stated; it weighs less.", press.label, factor
            )
    return factors
