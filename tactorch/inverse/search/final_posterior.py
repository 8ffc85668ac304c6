"""The posterior of a final model, with ridges where radius and contrast are uncertain."""

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.inverse.fields import SIZE
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.posterior.ridges import Ridge, RidgePoint
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import (
    MIN_GAIN,
    OPTIMISM,
    Model,
    Start,
    as_judged,
    falls_short,
    gain,
    make_posterior,
)

_log = logging.getLogger(__name__)
# Smallest standard deviations of the logarithms of radius and contrast with which the posterior is
# taken about the ridge.
_MIN_DEVIATION = np.array([0.05, 0.1])
_TOLERANCE = 0.1  # of the fit whose posterior it is: within half a standard deviation
_MAX_POINTS = 6  # on each side of the best fit: to 3.6 standard deviations of the prior
# Predicted fall of the objective below which a point of a ridge is not fitted further: the
# predicted optimum is right within a tenth then.
_RIDGE_TOLERANCE = 5.0
# Rise of half the sum of squares from one point of a ridge to the next, for which one point on each
# side of the best fit is enough where the posterior is nearly normal.
_RISE = 3.0
_MAX_RISE = 2.5  # at the last points; that of the ends of a central 90 % interval is 1.35
_MAX_STEP, _MIN_STEP = 0.6, 0.01  # of a parameter, in standard deviations of its prior


def final_posterior(problem: SearchProblem, model: Model) -> tuple[Model, ShapePosterior]:
    """Return the posterior of a final model, and the model or one of more evidence.

    The posterior is that of balls that may be ellipsoids. These are fitted, and accepted as the
    model if their evidence is larger by enough; a single one of less evidence is not fitted, and
    the posterior is linearised at the ball. Where radius or contrast of an inclusion are uncertain,
    it is about its ridge.
    """
    try:
        free = _with_ellipsoids(problem, model)
        if free is not model and gain(free.fit, model.fit) > MIN_GAIN:
            _log.info("balls as ellipsoids: log-evidence %+.4g", gain(free.fit, model.fit))
            model = free = problem.final(free)
    except ConvergenceError as error:
        _log.warning("The posterior is linearised at balls, as ellipsoids fail: %s", error)
        free = model
    posterior = make_posterior(free, problem.sites)
    if free.fit.field.families != posterior.field.families:
        return model, posterior
    uncertain = [k for k in range(len(posterior.field.parts)) if _is_uncertain(posterior, k)]
    ridges = tuple(follow_ridge(problem, free, k) for k in uncertain)
    return model, replace(posterior, ridges=ridges)


def follow_ridge(problem: SearchProblem, model: Model, inclusion: int) -> Ridge:
    """Return the posterior about the ridge of an inclusion of a model.

    It is followed from the model to both sides, to where the density has fallen by a factor of
    twelve, a press has no equilibrium, or a parameter is at its bound.
    """
    field, z = model.fit.field, model.fit.z
    radius, contrast = field.index(inclusion, *SIZE)
    direction = np.zeros(len(z))
    direction[[radius, contrast]] = 1.0, -1.0 if field.physical(z)[contrast] > 0.0 else 1.0
    direction /= np.sqrt(2.0)
    inflation = max(1.0, model.fit.chi2)
    start = _point(model, direction, inflation)
    others: list[RidgePoint] = []
    for sign in (-1.0, 1.0):
        beside = others[0] if others else None
        others += _one_side(problem, model, start, beside, direction, sign, inflation)
    return Ridge.through(start, others, inclusion, direction)


def _is_uncertain(posterior: ShapePosterior, inclusion: int) -> bool:
    rows = posterior.field.index(inclusion, *SIZE)
    deviations = np.sqrt(np.diag(posterior.covariance)) * posterior.field.deviation
    return bool((deviations[rows] > _MIN_DEVIATION).any())


def _with_ellipsoids(problem: SearchProblem, model: Model) -> Model:
    """Return the model with all balls as ellipsoids.

    They are fitted, unless there is a single one that will hardly have more evidence.
    """
    field, z = as_judged(model.fit.field, model.fit.z)
    if field is model.fit.field:
        return model
    start = Start("balls as ellipsoids", field, z, model.errors)
    # An ellipsoid without distortions is the ball.
    balls = problem.fit(start, None, np.inf, evaluation=model.evaluation)
    fit = balls.fit
    fall = OPTIMISM * fit.predicted_fall
    # Of two inclusions of saturated contrast, intervals about balls were off by a fifth.
    if len(field.parts) == 1 and falls_short(fit, fall, model.fit, margin=-MIN_GAIN):
        return balls
    return problem.fit(start, None, _TOLERANCE, evaluation=balls.evaluation)


def _one_side(
    problem: SearchProblem,
    model: Model,
    point: RidgePoint,
    beside: RidgePoint | None,
    direction: Float[np.ndarray, " size"],
    sign: float,
    inflation: float,
) -> Iterator[RidgePoint]:
    """Yield points of larger t (sign 1) or smaller t (sign -1).

    `beside` is a point near the first one, from which the bend of the ridge is known.
    """
    field, lowest = model.fit.field, point.height
    limits = ShapesOnSites(field, problem.sites).limits
    for _ in range(_MAX_POINTS):
        bend = 0.0 if beside is None else point.bend(beside, direction)
        step = point.step(sign, _RISE, _MAX_STEP, bend)
        z = np.clip(field.moved(point.z, step), *limits)
        if sign * float(direction @ (z - point.z)) < _MIN_STEP:
            return  # at a bound
        try:
            model = _fit_across(problem, model, z, direction)
        except ConvergenceError:
            return
        beside, point = point, _point(model, direction, inflation)
        if sign * float(direction @ (point.z - beside.z)) < _MIN_STEP:
            return
        yield point
        lowest = min(lowest, point.height)
        if point.height - lowest > _MAX_RISE:
            return


def _fit_across(
    problem: SearchProblem,
    model: Model,
    z: Float[np.ndarray, " size"],
    direction: Float[np.ndarray, " size"],
) -> Model:
    """Return the model fitted from other parameters, which remain along a direction."""
    family = ShapesOnSites(model.fit.field, problem.sites)
    presses = problem.full.with_data(model.evaluation.data)
    point, predicted = family.at(z), problem.displacements(model, z)
    evaluation = presses.evaluate(point.youngs, starts=predicted)
    evaluation.update_response(point.changes, model.evaluation, z - model.fit.z)
    start = Start("ridge", model.fit.field, z, model.errors)
    return problem.fit(
        start, None, tolerance=_RIDGE_TOLERANCE, held=direction, evaluation=evaluation
    )


def _point(model: Model, direction: Float[np.ndarray, " size"], inflation: float) -> RidgePoint:
    fit, scale = model.fit, np.sqrt(inflation)
    return RidgePoint.of(fit.z, fit.residuals / scale, fit.jacobian / scale, direction)
