"""Weights of presses by how well any map can fit them, for presses noisier than stated."""

import logging
from dataclasses import replace

import numpy as np

from tactorch.inverse.misfit import Squares
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.starts import uniform_fit

_log = logging.getLogger(__name__)
_MAX_ITERATIONS = 30
_MIN_REPORTED = 2.0  # factor of the noise that is logged


def adapt(objective: Objective) -> Objective:
    """Return the objective with widened deviations of outlying presses, and least squares.

    A first inversion with the convex cost of `Adaptive` bounds the effect of a bad press on the
    map; it is damped Gauss-Newton with any optimizer. A press whose residuals there are larger than
    those of the median press (and than stated) gets their size as its deviation. Most presses must
    be as good as they state. A `Press` is one frame, so a bad frame of a good series is separate.
    """
    problem = objective.problem
    fit = uniform_fit(problem, objective.parameterization.bounds, objective.nuisance)
    monitor = Monitor()
    start = objective.start(np.full(problem.n_elements, fit.youngs_mpa))
    GaussNewton(max_iterations=_MAX_ITERATIONS).minimize(
        replace(objective, weight=None), start, monitor
    )
    assert monitor.point is not None
    chi2 = np.array([np.mean(r**2) for r in monitor.point.evaluation.deviations])
    factors = np.sqrt(np.maximum(1.0, chi2 / max(1.0, float(np.median(chi2)))))
    for press, factor in zip(problem.recording.presses, factors, strict=True):
        if factor > _MIN_REPORTED:
            _log.warning(
                "%s is %.2g times as noisy as stated; its weight is reduced.", press.label, factor
            )
    data = replace(problem.data.widened(factors), misfit=Squares())
    return replace(objective, problem=problem.with_data(data))
