"""Models of the search for shapes: fields with errors of the data, and what follows from them."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import Levels
from tactorch.inverse.errors.discrepancy import Discrepancy
from tactorch.inverse.fields import (
    FAMILIES,
    SIZE,
    Candidate,
    Cloud,
    Family,
    ShapeField,
    Sites,
    Vector,
)
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.posterior.shapes import ShapePosterior

_log = logging.getLogger(__name__)

# Gain of the log-evidence for a model that is accepted: strong evidence by R. E. Kass and A. E.
# Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995), 773-795.
MIN_GAIN = 3.0
# Mean squared residual beyond which the signal that a model does not explain exceeds the noise: the
# error of the discretisation does not matter yet, and what one proposal may explain is hidden.
MAX_ROUGH_CHI2 = 3.0
DEGREES = (2, 4)  # of smooth backgrounds
# Smallest linearised reduction of the misfit that is worth a fit: the best of n independent ones
# reduces that of pure noise by about log n, which is 6.7 for the balls of the matched filter.
MIN_CANDIDATE_GAIN = 8.0
OPTIMISM = 1.5  # falls of the objective over those of its quadratic model, at best
MAX_LOG_ODDS = 1e6  # where the model without an inclusion has no equilibrium
_LEAST_CONTRAST = 0.05  # of an inclusion or a step, in the logarithm
# Range of the log-contrast of a start with the reduced model, and its limit with quadratic
# elements: the far field of a ball, (c - 1) / (c + 3/2), is 0.6 and 0.7 of its limit there, see
# `moderate`.
_START_CONTRAST, _MAX_START_CONTRAST = (0.3, 1.5), 2.0


@dataclass(frozen=True, eq=False)
class Start:
    """A model to be fitted."""

    what: str
    field: ShapeField
    z: Vector
    errors: Levels


@dataclass(frozen=True, eq=False)
class Proposal(Start):
    """A model with its fit with the reduced model.

    Attributes:
        trial: The fit.
        gain: Its log-evidence over that of the present model.
        least_gain: Gain of log-evidence for which it is accepted.
        promise: Gain of the trial at the noise that the present model would need.
        kind: What it changes of the present model: number of inclusions, families, background,
            errors, and whether one becomes an irregular lump.
    """

    trial: ShapeFit
    gain: float = 0.0
    least_gain: float = 0.0
    promise: float = 0.0
    kind: tuple[bool, ...] = ()


@dataclass(frozen=True, eq=False)
class Model:
    """A model fitted with the full model of the presses."""

    fit: ShapeFit
    evaluation: Evaluation
    errors: Levels


def gain(fit: ShapeFit, rival: ShapeFit, groups: Int[np.ndarray, " data"] | None = None) -> float:
    """Return the log-evidence of a fit over that of another one.

    They are compared at the noise of the one that explains the data better, but at least at the
    stated noise; where data are in groups, at that of each group.
    """
    return weighted_gain(fit, rival, noise_weights(groups, fit.residuals, rival.residuals))


def weighted_gain(fit: ShapeFit, rival: ShapeFit, weights: Float[np.ndarray, " data"]) -> float:
    """Return the log-evidence of a fit over that of another one, where data have weights."""
    misfit = 0.5 * float(weights @ (rival.residuals**2 - fit.residuals**2))
    return misfit + rival.complexity - fit.complexity


def noise_weights(
    groups: Int[np.ndarray, " data"] | None, *residuals: Float[np.ndarray, " data"]
) -> Float[np.ndarray, " data"]:
    """Return one over the least chi2 of each group of data (None for one group), at most one."""
    if groups is None:
        groups = np.zeros(len(residuals[0]), dtype=int)
    counts = np.maximum(np.bincount(groups), 1)
    chi2 = np.min([np.bincount(groups, r**2) / counts for r in residuals], axis=0)
    return np.asarray((1.0 / np.maximum(chi2, 1.0))[groups])


def falls_short(
    fit: ShapeFit,
    fall: float,
    rival: ShapeFit,
    groups: Int[np.ndarray, " data"] | None = None,
    margin: float = 0.0,
) -> bool:
    """Return whether a fit will have less evidence than another one, by more than a margin.

    `fall` is the largest fall of the objective that is expected of it; see `gain` for `groups`.
    """
    remaining = max(0.0, 1.0 - fall / max(fit.misfit, 1e-300))
    best = replace(fit, residuals=np.sqrt(remaining) * fit.residuals)
    return gain(best, rival, groups) < -margin


class StopSearch(Exception):  # noqa: N818  (a signal, not an error)
    """The time in which models are accepted is over."""


class TimeLimit:
    """A limit of the time in which models are accepted, from its construction on.

    Args:
        seconds: The limit, s, or None.
        stop: Function that tells whether a search is stopped, without the limit.
    """

    def __init__(self, seconds: float | None, stop: Callable[[], bool]) -> None:
        self._seconds, self._stop, self.holds = seconds, stop, False
        self._began = time.monotonic()

    def __call__(self) -> bool:
        """Return whether the search is stopped.

        Raises:
            StopSearch: the limit is exceeded while it `holds`.
        """
        if self.holds and time.monotonic() - self._began > (self._seconds or np.inf):
            raise StopSearch
        return self._stop()


def improve(step: Callable[[int], bool], models: int, limit: TimeLimit) -> StopReason | None:
    """Accept models, by a step each, until there is no better one, the time limit, or Ctrl-C.

    A step is a function of the number of the model, from 2, which returns whether it was accepted.
    What ended it early is returned, or None; the last accepted model is then the result.
    """
    limit.holds = True
    try:
        for number in range(2, models + 2):
            limit()
            if not step(number):
                break
    except StopSearch:
        _log.warning("The search reaches its time limit and ends with the last accepted model.")
        return StopReason.TIME_LIMIT
    except KeyboardInterrupt:
        _log.warning(
            "Ctrl-C: the search ends with the last accepted model, whose intervals are computed. "
            "Ctrl-C again ends at once."
        )
        return StopReason.INTERRUPTED
    finally:
        limit.holds = False
    return None


def record(what: str, fit: ShapeFit) -> dict[str, Any]:
    """Return the record of an accepted model for the history of a search."""
    evidence = fit.log_evidence(max(1.0, fit.chi2))
    return {"model": what, "chi2": fit.chi2, "log_evidence": evidence}


def unexplained(model: Model, data: DataModel) -> float:
    """Return the root mean square of what is neither explained nor noise, over the data's.

    It is that of the residuals, and of the discrepancy of the model.
    """
    observed, chi2 = data.values * data.scale, model.fit.chi2
    discrepancy = model.errors.get(Discrepancy.name, 0.0)
    return float(np.sqrt(max(chi2 - 1.0, 0.0) / np.mean(observed**2) + discrepancy**2))


def make_posterior(model: Model, sites: Sites) -> ShapePosterior:
    """Return the posterior of a model, where balls may be ellipsoids.

    The data of a ball's evidence do not exclude an ellipsoid, whose modulus and size are less
    certain, and differ. The model is linearised at the balls.
    """
    fit = model.fit
    field, z = as_judged(fit.field, fit.z)
    inflation = max(1.0, fit.chi2)
    jacobian = fit.jacobian
    if field is not fit.field:
        jacobian = ShapesOnSites(field, sites).at(z).jacobian(model.evaluation)
    covariance = np.linalg.inv(jacobian.T @ jacobian / inflation + np.eye(len(z)))
    gradient = jacobian.T @ fit.residuals / inflation + z
    return ShapePosterior(field, z, -covariance @ gradient, covariance)


def with_ball(fit: ShapeFit, candidate: Candidate) -> tuple[str, ShapeField, Vector]:
    """Return the description, field and parameters of a model with a further ball or rod."""
    candidate = candidate._replace(log_contrast=start_contrast(candidate.log_contrast))
    births = ((FAMILIES[name], FAMILIES[name].birth(candidate)) for name in FAMILIES)
    family, inclusion = next((family, own) for family, own in births if own is not None)
    kind = "rod" if candidate.half_mm.any() else "ball"
    where = np.round(candidate.center_mm, 1).tolist()
    return f"{kind} at {where} mm", *replaced(fit, (), (family,), [inclusion])


def start_contrast(contrast: float) -> float:
    """Return the log-contrast of a start, of that which a linear model has."""
    return float(np.copysign(np.clip(abs(contrast), *_START_CONTRAST), contrast))


def varied(field: ShapeField, z: Vector, **background: Any) -> tuple[ShapeField, np.ndarray]:
    """Return the model with more modes of the background, which start at zero."""
    return field.changed(z, background=replace(field.background, **background))


def with_step(
    field: ShapeField, z: Vector, side: str, place_mm: float, log_contrast: float
) -> tuple[ShapeField, np.ndarray]:
    """Return the model with a further step of the background, see `Background`."""
    background, end = field.background, field.n_background
    other = replace(field, background=replace(background, steps=(*background.steps, side)))
    return other, other.standard(np.insert(field.physical(z), end, [place_mm, log_contrast]))


def faint_inclusions(fit: ShapeFit) -> list[int]:
    """Return the numbers of inclusions with hardly any contrast: one material varies as much.

    Faint structure explains what is left of errors that a model has not quite described.
    """
    logs = [abs(np.log(shape.contrast)) for shape in fit.field.shapes(fit.z)]
    return [k for k, log in enumerate(logs) if log < _LEAST_CONTRAST]


def is_negligible(fit: ShapeFit) -> bool:
    """Return whether an inclusion or a step has hardly any contrast."""
    field, values = fit.field, fit.field.physical(fit.z)
    steps = [values[field.background.step_at(k)][1] for k in range(len(field.background.steps))]
    return bool(faint_inclusions(fit) or (np.abs(steps) < _LEAST_CONTRAST).any())


def less(model: Model, removed: Sequence[int]) -> Start:
    """Return a model without some of its inclusions."""
    what = f"inclusion {', '.join(map(str, removed))} removed"
    return Start(what, *replaced(model.fit, removed, (), []), model.errors)


def rivals(model: Model, removed: Sequence[int]) -> list[Start]:
    """Return the model without some of its inclusions, and so with the next smooth background."""
    start = less(model, removed)
    degrees = [d for d in DEGREES if d > start.field.background.degree][:1]
    smooth = [varied(start.field, start.z, degree=degree) for degree in degrees]
    return [start, *(replace(start, field=field, z=z) for field, z in smooth)]


def as_one(model: Model, inclusions: Sequence[int], family: Family) -> Start:
    """Return a model with one inclusion of a family in place of some of its inclusions."""
    shapes = list(model.fit.field.shapes(model.fit.z))
    values = family.like(Cloud.of([shapes[k] for k in inclusions]))
    what = f"inclusion {' and '.join(map(str, inclusions))} as {family.noun}"
    return Start(what, *replaced(model.fit, inclusions, (family,), [values]), model.errors)


def replaced(
    fit: ShapeFit,
    removed: Sequence[int],
    families: tuple[Family, ...],
    values: list[Float[np.ndarray, " _"]],
) -> tuple[ShapeField, Vector]:
    """Return the model with other inclusions, by their values in mm and logarithms, for some."""
    field, old = fit.field, fit.field.physical(fit.z)
    kept = [k for k in range(len(field.parts)) if k not in removed]
    other = replace(field, families=(*(field.families[k] for k in kept), *families))
    parts = [old[: field.n_background], *(old[field.parts[k]] for k in kept), *values]
    return other, other.standard(np.concatenate(parts))


def with_family(
    field: ShapeField, z: Vector, inclusion: int, family: Family
) -> tuple[ShapeField, np.ndarray]:
    """Return the model with an inclusion of another family, whose further parameters are zero."""
    before, after = field.families[:inclusion], field.families[inclusion + 1 :]
    return field.changed(z, families=(*before, family, *after))


def as_judged(field: ShapeField, z: Vector) -> tuple[ShapeField, np.ndarray]:
    """Return the model with inclusions of the families by which their posterior is computed."""
    families = tuple(FAMILIES[family.judged_as] for family in field.families)
    return (field, z) if families == field.families else field.changed(z, families=families)


def moderate(field: ShapeField, z: Vector) -> Vector:
    """Return the model with the last ball of moderate contrast and of the same far field.

    A ball in a uniform strain acts from afar by its volume times (c - 1) / (c + 3/2), with c its
    contrast (Eshelby, 1957, for nearly incompressible bodies). Where the contrast is large the
    data hardly depend on it, and the steps of a fit become small.
    """
    values = field.physical(z)
    radius, contrast = field.index(-1, *SIZE)
    log = np.clip(values[contrast], -_MAX_START_CONTRAST, _MAX_START_CONTRAST)
    old, new = ((np.exp(x) - 1.0) / (np.exp(x) + 1.5) for x in (values[contrast], log))
    if old != new:
        values[radius] += np.log(old / new) / 3.0
        values[contrast] = log
    return field.standard(values)
