"""Proposals of a search for inclusions: models that may be better than the present one."""

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from tactorch.inverse.errors import Levels
from tactorch.inverse.fields import FAMILIES, Cloud, InclusionShape
from tactorch.inverse.fields.family import families_beyond
from tactorch.inverse.fields.star import STAR
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import (
    DEGREES,
    MAX_ROUGH_CHI2,
    MIN_CANDIDATE_GAIN,
    Model,
    Proposal,
    Start,
    as_one,
    is_negligible,
    less,
    moderate,
    noise_weights,
    replaced,
    varied,
    weighted_gain,
    with_ball,
    with_family,
)
from tactorch.inverse.search.slabs import crosses
from tactorch.linalg import map_cases

_log = logging.getLogger(__name__)
_STARTS = 3  # fits of each further inclusion
_FORMS = 2  # other forms of an inclusion beside which a further one is tried
_MUCH_LESS = 0.5  # misfit of a pair of changes, over that of the best one
_SAME = 2.0  # distance of centres, in radii, below which two starts are of the same ball: touching


def propose(problem: SearchProblem, model: Model) -> list[Proposal]:
    """Return models that may be better than the present one, fitted with the reduced model.

    A model with other errors beside a change of the map has to be better than the present map with
    these errors.
    """
    fit = model.fit
    starts = [start for source in problem.proposals for start in source(problem, model)]
    starts += [*_specific(problem, model, starts)]
    proposals = _fitted(problem, model, starts)
    proposals += _fitted(problem, model, [*_further_beside(problem, model, proposals)])
    least_chi2 = min((p.trial.chi2 for p in proposals), default=0.0)
    if least_chi2 > MAX_ROUGH_CHI2:
        pairs = _fitted(problem, model, _pairs(problem, model, proposals))
        proposals += [pair for pair in pairs if pair.trial.chi2 < _MUCH_LESS * least_chi2]
    same_map = {_key(p.errors): p for p in proposals if p.field is fit.field}
    judged, weights = list[Proposal](), noise_weights(problem.groups, fit.residuals)
    for proposal in proposals:
        gain, least = problem.gain(proposal.trial, fit), problem.min_gain
        other = same_map.get(_key(proposal.errors), proposal)
        if other is not proposal:
            least += max(0.0, problem.gain(other.trial, fit))
        if proposal.field.size < fit.field.size:
            least = 0.0  # of two models that explain as much it is the simpler one
        what, chi2 = proposal.what, proposal.trial.chi2
        _log.debug("proposal: %s, chi2 %.4g, log-evidence %+.4g", what, chi2, gain)
        promise, kind = weighted_gain(proposal.trial, fit, weights), _kind(proposal, model)
        judged.append(replace(proposal, gain=gain, least_gain=least, promise=promise, kind=kind))
    return judged


def promising(problem: SearchProblem, proposals: Sequence[Proposal]) -> list[Proposal]:
    """Return proposals that seem better than the present model, the best of each kind first.

    Those of a kind are ordered by their evidence at the noise that the present model would need,
    which prefers an inclusion to large errors of the forces that explain as much.
    """
    better = [
        proposal
        for proposal in proposals
        if proposal.gain > problem.trial_share * proposal.least_gain
        and not is_negligible(proposal.trial)
    ]
    return _by_kind(sorted(better, key=lambda p: -p.promise))


def _kind(other: Start, model: Model) -> tuple[bool, ...]:
    """Return `Proposal.kind`."""
    field, families = model.fit.field, other.field.families
    adds = len(families) > len(field.families)
    same = families[: len(field.families)] == field.families[: len(families)]
    changes = other.field.background != field.background, other.errors != model.errors
    # An irregular lump resembles any form in the reduced model, and hides the one that it is.
    return adds, same, *changes, STAR in families and STAR not in field.families


def _by_kind(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Return the best proposal of each kind first, then the second best ones.

    The reduced model compares proposals of one kind, such as two places of a further inclusion,
    better than those of two kinds, such as a further inclusion and another form.
    """
    seen = Counter[tuple[bool, ...]]()
    ranks = []
    for proposal in proposals:
        ranks.append(seen[proposal.kind])
        seen[proposal.kind] += 1
    return [proposals[k] for k in np.argsort(ranks, kind="stable")]


def _key(errors: Levels) -> frozenset[tuple[str, float]]:
    return frozenset(errors.items())


def _pairs(problem: SearchProblem, model: Model, proposals: list[Proposal]) -> list[Start]:
    """Return the best inclusion and the best background with each of the other errors.

    An inclusion that explains little while contacts are misplaced, or forces wrong, may explain the
    rest of what they do not.
    """
    fit, weights = model.fit, noise_weights(problem.groups, model.fit.residuals)
    best = sorted(proposals, key=lambda p: -weighted_gain(p.trial, fit, weights))
    errors = [p for p in best if p.field is fit.field and problem.gain(p.trial, fit) > 0.0]
    maps = [p for p in best if p.field is not fit.field and p.errors == model.errors]
    count = len(fit.field.families)
    kinds = [[p for p in maps if (len(p.field.families) > count) is adds] for adds in (True, False)]
    return [
        Start(f"{kind[0].what}, {error.what}", kind[0].field, kind[0].z, error.errors)
        for kind in filter(None, kinds)
        for error in errors
    ]


def _fitted(problem: SearchProblem, model: Model, starts: Sequence[Start]) -> list[Proposal]:
    """Return proposals fitted with the reduced model, several at once.

    Those with a further inclusion are fitted one after the other for each errors of the data, as a
    start inside a ball that was fitted already would lead to it again.
    """
    offsets, count = problem.offsets(model), len(model.fit.field.families)
    chains: dict[object, list[Start]] = {}
    for start in starts:
        adds = len(start.field.families) > count
        chains.setdefault(_key(start.errors) if adds else start.what, []).append(start)

    def fit(start: Start) -> Proposal:
        trial = problem.try_model(start, offsets)
        z = moderate(start.field, trial.z) if len(start.field.families) > count else trial.z
        return Proposal(start.what, start.field, z, start.errors, trial)

    def fit_in_turn(chain: Sequence[Start]) -> list[Proposal]:
        found: list[Proposal] = []
        for start in chain:
            if not any(_is_inside(start, proposal) for proposal in found):
                found.append(fit(start))
        return found

    parts = map_cases(lambda k: fit_in_turn([*chains.values()][k]), len(chains))
    return [proposal for part in parts for proposal in part]


def _further_beside(
    problem: SearchProblem, model: Model, proposals: list[Proposal]
) -> Iterator[Start]:
    """Yield the best other forms of an inclusion with a further one beside it.

    Two balls may explain more than any one inclusion, and less than another form with a ball.
    """
    fit, weights = model.fit, noise_weights(problem.groups, model.fit.residuals)
    count = len(fit.field.families)
    forms = [p for p in proposals if len(p.field.families) == count and p.errors == model.errors]
    forms = [p for p in forms if p.field.families != fit.field.families]
    forms.sort(key=lambda p: -weighted_gain(p.trial, fit, weights))
    for form in forms[:_FORMS] if problem.forms and count < problem.max_shapes else ():
        trial, matched = form.trial, problem.filter(form.errors)
        for candidate in matched.best(trial.residuals, trial.jacobian, 1):
            if candidate.gain >= MIN_CANDIDATE_GAIN:
                what, field, z = with_ball(trial, candidate)
                yield Start(f"{form.what}, {what}", field, z, form.errors)


def _specific(problem: SearchProblem, model: Model, starts: Sequence[Start]) -> Iterator[Start]:
    """Yield changes of the map without the general errors that the present one may need."""
    specific = problem.errors.specific(model.errors)
    for start in starts if specific != model.errors else ():
        if start.errors == model.errors and start.field is not model.fit.field:
            yield replace(start, what=f"{start.what}, no general errors", errors=specific)


def other_errors(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with other errors of the data."""
    for what, errors in problem.errors.others(model.errors):
        yield Start(what, model.fit.field, model.fit.z, errors)


def further(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with a further inclusion, at the places where it would explain most.

    Where the misfit is large for some groups of data it hides others: all data are seen alike at
    first, and then each by its weight.
    """
    fit = model.fit
    if len(fit.field.families) >= problem.max_shapes:
        return
    white, jacobian = problem.raw(model).residuals, problem.jacobian(model)
    for errors in problem.error_levels(model):
        data, matched = problem.data(errors), problem.filter(errors)
        residuals, explained = data.whiten(white), data.whiten(jacobian)
        found = matched.best(residuals, explained, _STARTS)
        if problem.groups is not None:
            weights = np.sqrt(noise_weights(problem.groups, residuals))
            found += matched.best(residuals, explained, _STARTS, weights)
        for candidate in found:
            if candidate.gain >= MIN_CANDIDATE_GAIN:
                yield Start(*with_ball(fit, candidate), errors)


def backgrounds(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with a background of the next degree."""
    fit = model.fit
    for degree in DEGREES:
        if degree > fit.field.background.degree:
            varying = varied(fit.field, fit.z, degree=degree)
            yield Start(f"background of degree {degree}", *varying, model.errors)
            return


def removed(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model without each inclusion.

    A further part of the model, or further presses, may explain what it was found for.
    """
    for k in range(len(model.fit.field.families)):
        yield less(model, [k])


def changed(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with each inclusion of each other family.

    Plates remain cuboids: as another form they would be nearly all of the body.
    """
    fit, shapes = model.fit, list(model.fit.field.shapes(model.fit.z))
    for k, family in enumerate(fit.field.families):
        beyond = families_beyond(family)
        for other in beyond:
            what = f"inclusion {k} as {other.noun}"
            yield Start(what, *with_family(fit.field, fit.z, k, other), model.errors)
        forms = () if crosses(shapes[k], fit.field.prior) else problem.forms
        for form in map(FAMILIES.__getitem__, forms):
            if form is not family and form not in beyond:
                yield as_one(model, [k], form)


def joined(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with neighbours that are all stiffer, or softer, as one of each family.

    They are no irregular lump: as one, it would blur the edges between them.
    """
    shapes = list(model.fit.field.shapes(model.fit.z))
    numbers = range(len(shapes))
    groups = list(combinations(numbers, 2)) + ([tuple(numbers)] if len(shapes) > 2 else [])
    for group in groups if problem.forms else ():
        parts = [shapes[k] for k in group]
        stiffer = [shape.contrast > 1.0 for shape in parts]
        if (all(stiffer) or not any(stiffer)) and _are_near(parts):
            for name in problem.forms:
                if FAMILIES[name] is not STAR:
                    yield as_one(model, group, FAMILIES[name])


def split(problem: SearchProblem, model: Model) -> Iterator[Start]:
    """Yield the model with each inclusion that is no ball as two balls, along its longest axis."""
    fit, ball = model.fit, FAMILIES["ball"]
    if len(fit.field.families) >= problem.max_shapes:
        return
    for k, shape in enumerate(fit.field.shapes(fit.z)):
        if fit.field.families[k] is not ball and not crosses(shape, fit.field.prior):
            halves = Cloud.of([shape]).halves()
            added = replaced(fit, [k], (ball, ball), [ball.like(half) for half in halves])
            yield Start(f"inclusion {k} as two balls", *added, model.errors)


def _are_near(shapes: Sequence[InclusionShape]) -> bool:
    """Whether each of some inclusions is near another one."""
    centers = np.array([shape.center_mm for shape in shapes])
    reach = np.array([max(shape.semi_axes_mm) for shape in shapes])
    apart = np.linalg.norm(centers[:, None] - centers, axis=2) - reach[:, None] - reach
    np.fill_diagonal(apart, np.inf)
    return bool((apart.min(axis=0) < reach).all())


def _is_inside(start: Start, proposal: Proposal) -> bool:
    """Whether both have a further inclusion of one family, with centres near each other."""
    if start.field.families != proposal.field.families:
        return False
    first, last = (one.field.own(one.field.physical(one.z), -1) for one in (start, proposal))
    apart = np.linalg.norm(first.center - last.center)
    return bool(apart < _SAME * np.exp(last.log_radius))
