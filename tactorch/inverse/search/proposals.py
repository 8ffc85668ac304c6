"""Proposals of the search for shapes: models that may be better than the present one."""

import logging
from collections.abc import Iterator, Sequence

import numpy as np

from tactorch.inverse.fields.family import families_beyond
from tactorch.inverse.search.model import (
    DEGREES,
    MIN_CANDIDATE_GAIN,
    MIN_GAIN,
    Model,
    Proposal,
    Start,
    moderate,
    varied,
    with_ball,
    with_family,
    without,
)
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.linalg import map_cases

_log = logging.getLogger(__name__)
_STARTS = 3  # fits of each further inclusion
_LAYERS = 8  # largest wave number of layers: half a wave is an eighth of the body
_SAME = 2.0  # distance of centres, in radii, below which two starts are of the same ball: touching


def propose(problem: ShapeProblem, model: Model, max_shapes: int) -> list[Proposal]:
    """Return models that seem better than the present one, the best first.

    Whether they are better is judged at the noise of the one that explains the data best: at the
    noise that the present model would need, small differences are lost. They are ordered by their
    evidence at the latter, which prefers an inclusion to large errors of the forces that explain
    as much.
    """
    fit = model.fit
    starts = list(_starts(problem, model, max_shapes))
    proposals = [*_with_other_errors(problem, model), *_fitted(problem, model, starts)]
    inflation = max(1.0, min([fit.chi2, *(p.trial.chi2 for p in proposals)]))
    gains = [p.trial.log_evidence(inflation) - fit.log_evidence(inflation) for p in proposals]
    ranks = [p.trial.log_evidence(max(1.0, fit.chi2)) for p in proposals]
    for proposal, gain in zip(proposals, gains, strict=True):
        chi2 = proposal.trial.chi2
        _log.debug("proposal: %s, chi2 %.4g, log-evidence %+.4g", proposal.what, chi2, gain)
    order = np.argsort(ranks)[::-1]
    return [proposals[k] for k in order if gains[k] > MIN_GAIN]


def _fitted(problem: ShapeProblem, model: Model, starts: Sequence[Start]) -> list[Proposal]:
    """Return starts fitted with the reduced model, several at once.

    Those with a further inclusion are fitted one after the other, as a start inside a ball that was
    fitted already would lead to it again.
    """
    offsets, count = problem.offsets(model), len(model.fit.field.families)
    further = [start for start in starts if len(start.field.families) > count]
    others = [start for start in starts if len(start.field.families) <= count]

    def fit(start: Start) -> Proposal:
        trial, z = problem.try_model(start, offsets)
        if len(start.field.families) > count:
            z = moderate(start.field, z)
        return Proposal(start.what, start.field, z, start.errors, trial)

    def fit_in_turn(chain: Sequence[Start]) -> list[Proposal]:
        found: list[Proposal] = []
        for start in chain:
            if not any(_is_inside(start, proposal) for proposal in found):
                found.append(fit(start))
        return found

    chains = [further, *([start] for start in others)]
    parts = map_cases(lambda k: fit_in_turn(chains[k]), len(chains))
    return [proposal for part in parts for proposal in part]


def _with_other_errors(problem: ShapeProblem, model: Model) -> Iterator[Proposal]:
    """Yield the model with other errors of the data; the fits are linearised."""
    fit = model.fit
    jacobian = problem.jacobian(model)
    for what, errors in problem.errors.others(model.errors):
        trial = problem.linearised(model, fit.z, jacobian, errors)
        yield Proposal(what, fit.field, fit.z, errors, trial)


def _starts(problem: ShapeProblem, model: Model, max_shapes: int) -> Iterator[Start]:
    field, z, errors = model.fit.field, model.fit.z, model.errors
    if len(field.families) < max_shapes:
        yield from _further(problem, model)
    for degree in DEGREES:
        if degree > field.background.degree:
            yield Start(f"background of degree {degree}", *varied(field, z, degree=degree), errors)
            break
    if not any(field.background.layers):
        yield from _layers(problem, model)
    if field.families and len(field.background.waves):
        # Inclusions may explain what the background was found to vary for.
        uniform = varied(field, z, degree=0, layers=(0, 0, 0))
        yield Start("uniform background", *uniform, errors)
    for k, family in enumerate(field.families):
        # A further part of the model, or further presses, may explain what it was found for.
        yield Start(f"inclusion {k} removed", *without(field, z, [k]), errors)
        for other in families_beyond(family):
            yield Start(f"inclusion {k} as {other.noun}", *with_family(field, z, k, other), errors)


def _layers(problem: ShapeProblem, model: Model) -> Iterator[Start]:
    """Yield the model with layers across the axis that explains most, by linearised fits."""
    inflation = max(1.0, model.fit.chi2)
    best, best_evidence = None, model.fit.log_evidence(inflation)
    for axis in range(3):
        layers = tuple(_LAYERS if k == axis else 0 for k in range(3))
        field, z = varied(model.fit.field, model.fit.z, layers=layers)
        jacobian = problem.coarse_jacobian(model, field, z)
        trial = problem.linearised(model, z, jacobian, model.errors)
        if trial.log_evidence(inflation) > best_evidence:
            best = Start(f"layers across {'xyz'[axis]}", field, z, model.errors)
            best_evidence = trial.log_evidence(inflation)
    if best:
        yield best


def _further(problem: ShapeProblem, model: Model) -> Iterator[Start]:
    """Yield the model with a further ball, at the places where it would explain most."""
    fit, data = model.fit, problem.data(model.errors)
    for candidate in problem.matched.whitened(data).best(fit.residuals, fit.jacobian, _STARTS):
        if candidate.gain < MIN_CANDIDATE_GAIN:
            return
        yield Start(*with_ball(fit, candidate), model.errors)


def _is_inside(start: Start, proposal: Proposal) -> bool:
    """Whether both are with a further ball, whose centres are near each other."""
    field = proposal.field
    first, last = (one.field.own(field.physical(one.z), -1) for one in (start, proposal))
    apart = np.linalg.norm(first.center - last.center)
    return bool(apart < _SAME * np.exp(last.log_radius))
