"""The search for inclusions: proposals by a reduced model, decisions by the full one.

A model is a background, uniform, smooth or layered, with a number of balls and ellipsoids, and
deviations of the recorded forces and poses. From a model others follow: with a further ball where a
matched filter sees one in the residuals, with a background of more modes, with a ball as an
ellipsoid, or with larger errors of the forces or poses. Each is fitted with the reduced model,
whose data are shifted so that it agrees with the full model at the present one. The best of them
are then fitted with the full model, and one that raises the evidence enough is accepted. At the
end, models with other inclusions that are about as probable as the last one are its alternatives.
What differs between contacts, palpations, sensors and sessions is in `SearchProblem`.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from tactorch.errors import UNCOMPUTABLE, CancelledError, ConvergenceError
from tactorch.inverse.errors import Levels
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.fields import ShapeField
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.forward.gel import has_markers, is_of_grasps
from tactorch.inverse.forward.palpation import is_palpation
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import Alternative, ShapeReconstruction
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.gel import GraspSearch, SensorSearch
from tactorch.inverse.search.model import (
    MAX_LOG_ODDS,
    MIN_GAIN,
    Model,
    Proposal,
    Start,
    TimeLimit,
    faint_inclusions,
    improve,
    is_negligible,
    less,
    make_posterior,
    record,
    unexplained,
)
from tactorch.inverse.search.palpation import PalpationSearch, at_some_places
from tactorch.inverse.search.physics_image import PhysicsImage
from tactorch.inverse.search.problem import ShapeProblem, is_same_model
from tactorch.inverse.search.proposals import promising, propose
from tactorch.inverse.search.sizing import refined_at_contacts
from tactorch.progress import progress_line
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
# Places of a palpation for a provisional answer, and for a search on part of many.
_QUICK_PLACES, _FIRST_PLACES = 128, 384
_MAX_SHAPES = 4
_MAX_CHI2 = 3.0  # beyond which the equilibrium of gel and object does not explain the markers
_MAX_MODELS = 10  # one after the other
_LEAST_PROBABLE = 0.05  # alternative that is reported
_LEAST_LOG = float(np.log(_LEAST_PROBABLE))
_OFF = 2.0  # log-evidence of the reduced model, by which it may be wrong about these
_AGAIN = ", inclusion "  # in the names of proposals that were fitted again without a faint lump
_MANY = 10.0  # contrast beyond which a provisional answer states none


def find_shapes(
    recording: Recording,
    settings: Settings | None = None,
    *,
    max_shapes: int = _MAX_SHAPES,
    start: ShapeReconstruction | Start | None = None,
    stop: Callable[[], bool] = lambda: False,
    kept: KeptRims | None = None,
) -> ShapeReconstruction:
    """Find the inclusions that the presses determine, with the number that the evidence supports.

    The truth and the reference that a recording may carry are never read.

    Args:
        recording: Presses on an object.
        settings: Noise, solver, bounds, equilibrium search and time limit are used; where all
            presses are of a sensor with markers, bounds and time limit. The latter is
            that of the search, without the posterior. Elements are quadratic, and
            smaller than those of the recording at the rims of contacts, and predictions are
            corrected by finer meshes there and at inclusions, unless the provenance states that the
            presses were computed on the recording's mesh.
        max_shapes: Largest number of inclusions.
        start: Result for other presses on the object, such as the earlier ones of a session, or
            what a search had `reached` that was stopped, from whose model the search starts; by
            default, and from a model without inclusions, it starts from a uniform body.
        stop: Called before each step of a fit; where it is true the search raises `CancelledError`,
            whose `reached` is the last accepted model, if there is one.
        kept: What searches on growing presses of an object share: errors at the rims of contacts,
            which are computed for contacts that it does not have.

    Raises:
        CancelledError: see `stop`.
        ConfigError: a setting cannot be used.
        ConvergenceError: with no uniform modulus do all presses have an equilibrium, or linear
            elements have none where quadratic ones have.
    """
    settings = settings or Settings()
    limit = TimeLimit(settings.max_seconds, stop)
    with progress_line("search for inclusions") as update:
        update("elements at the contacts")
        path: _Path | None = None
        of_grasps = is_of_grasps(recording)
        if is_palpation(recording):
            options = settings, limit, max_shapes
            if start is None:
                few = at_some_places(recording, _QUICK_PLACES) or recording
                _log_provisional(PalpationSearch(few, *options, "tet4"))
                if part := at_some_places(recording, _FIRST_PLACES):
                    # The model is not kept: its predictions hold the arrays of these places.
                    path = _accept_models(PalpationSearch(part, *options), limit, None, update)[1]
            update("elements at all places")
        elif not of_grasps and has_markers(recording):
            update("gel and object")
            found = _through_gel(recording, settings, limit, max_shapes, start, update)
            if found is not None:
                return found
        problem = _problem(recording, settings, limit, max_shapes, kept)
        if start is None and isinstance(problem, ShapeProblem):
            _log_provisional(problem)
        model, result = search(problem, limit, start, update, path)
        return replace(result, predictions=problem.predictions(model, recording))


def physics_image(
    recording: Recording, settings: Settings | None = None, *, count: int = 16
) -> PhysicsImage:
    """Return the signal over noise and the sensitivity of presses about the best uniform body.

    Args:
        recording: Presses on an object; its truth is not read. Those of a sensor are presses with
            the forces that the recording states.
        settings: As of `find_shapes`.
        count: Voxels along each side of the bounding box.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: with no uniform modulus do all presses have an equilibrium.
    """
    problem = _problem(recording, settings or Settings())
    return PhysicsImage.of(problem, problem.uniform(), count)


def _problem(
    recording: Recording,
    settings: Settings,
    stop: Callable[[], bool] = lambda: False,
    max_shapes: int = 0,
    kept: KeptRims | None = None,
) -> SearchProblem:
    """Return the presses of a recording as a problem of the search."""
    if is_palpation(recording):
        return PalpationSearch(recording, settings, stop, max_shapes)
    if is_of_grasps(recording):
        return GraspSearch(recording, settings, stop, max_shapes)
    refined = recording if is_same_model(recording) else refined_at_contacts(recording)
    return ShapeProblem(refined, settings, stop, kept, max_shapes)


def _through_gel(
    recording: Recording,
    settings: Settings,
    limit: TimeLimit,
    max_shapes: int,
    start: ShapeReconstruction | Start | None,
    update: Callable[[str], None],
) -> ShapeReconstruction | None:
    """Search through the equilibrium of a sensor's gel and the object.

    None, with a warning, where that is not possible or does not explain the markers.
    """
    try:
        problem = SensorSearch(recording, settings, limit, max_shapes)
        if start is None:
            _log_provisional(problem)
        model, result = search(problem, limit, start, update)
        if result.chi2 <= _MAX_CHI2 or result.ended:
            predictions = problem.predictions(model, recording)
            return replace(result, through_gel=True, predictions=predictions)
        _log.warning(
            "Forces are those of the gel alone: gel and object in one equilibrium leave a mean "
            "squared residual of %.2g. Check the sensor's pose, and modulus and size of its "
            "gel.", result.chi2,
        )  # fmt: skip
    except CancelledError:
        raise
    except UNCOMPUTABLE as error:
        _log.warning("Forces are those of the gel alone, as gel and object have no fit: %s", error)
    return None


@dataclass(eq=False)
class _Path:
    """The last model that a search has accepted, records of all, and what was not tried.

    `rejected` are the proposals from the last model, and `fitted` their fits with the full model,
    by their `id`, which may have ended early.
    """

    state: Start
    history: list[dict[str, Any]]
    untried: list[Proposal] = field(default_factory=list)
    rejected: list[Proposal] = field(default_factory=list)
    fitted: dict[int, ShapeFit] = field(default_factory=dict)
    ended: StopReason | None = None  # what ended it early

    def accept(self, what: str, model: Model) -> None:
        """Add a model."""
        self.rejected.clear()
        self.state = _state(model)
        self.history.append(record(what, model.fit))

    def had(self, proposal: Proposal) -> bool:
        """Return whether a proposal adds an inclusion that was accepted before, and removed.

        Errors that are linearised about each model would add and remove it in turn.
        """
        adds = len(proposal.field.families) > len(self.state.field.families)
        # Without what a proposal became where it was fitted again, see `_challenge`.
        before = [entry["model"].partition(_AGAIN)[0] for entry in self.history]
        return adds and proposal.what in before

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep the last model where the search is stopped."""
        try:
            yield
        except CancelledError as error:
            error.reached = self.state
            raise


def _state(model: Model) -> Start:
    return Start("last model", model.fit.field, model.fit.z, model.errors)


def search(
    problem: SearchProblem,
    limit: TimeLimit,
    start: ShapeReconstruction | Start | None = None,
    update: Callable[[str], None] = lambda what: None,
    before: _Path | None = None,
) -> tuple[Model, ShapeReconstruction]:
    """Accept models of more evidence until there is none; return the last one, and the result.

    `update` is called with what is done next. The search starts from the model of the one `before`,
    on a part of the presses, or from `start`, see `find_shapes`.
    """
    model, path = _accept_models(problem, limit, start, update, before)
    with path.kept():
        update("alternatives")
        likely = [_Likely(0.0, model)]

        def compare(_: int) -> bool:
            for one in _alternatives(problem, model, path.rejected, path.fitted):
                likely.append(one)
            return False

        path.ended = path.ended or improve(compare, 1, limit)
        likely.sort(key=lambda one: -one.weight)
        if likely[0].model is not model:
            model = problem.precise(likely[0].model)
            path.accept(likely[0].what, model)
        alternatives = _shares(problem, likely)
        update("final fit")
        model = _final(problem, model)
        path.state = _state(model)
        update("posterior")
        best, posterior = problem.posterior(model)
        if best is not model:
            path.history.append(record("balls as ellipsoids", best.fit))
        result = _result(problem, best, posterior, path.history)
        left = tuple(proposal.what for proposal in path.untried) if path.ended else ()
        result = replace(result, ended=path.ended, untried=left, alternatives=alternatives)
        return best, result


def _accept_models(
    problem: SearchProblem,
    limit: TimeLimit,
    start: ShapeReconstruction | Start | None,
    update: Callable[[str], None],
    before: _Path | None = None,
) -> tuple[Model, _Path]:
    """Accept models of more evidence until there is none; see `search`."""
    update("first model")
    with nullcontext() if before is None else before.kept():
        model, path = _first(problem, start if before is None else before.state)
    if before is not None:
        path.history[:0] = before.history
        if before.ended:
            path.untried, path.ended = before.untried, before.ended
            return model, path

    def step(number: int) -> bool:
        nonlocal model
        update(f"model {number}, predictions of proposals")
        path.rejected[:] = [p for p in propose(problem, model) if not path.had(p)]
        path.untried[:] = promising(problem, path.rejected)[: problem.max_fits]
        path.fitted.clear()
        update(f"model {number}")
        if (accepted := _accept(problem, model, path.untried, path.fitted)) is None:
            return False
        model = problem.precise(accepted[1])
        path.accept(accepted[0].what, model)
        return True

    with path.kept():
        path.ended = improve(step, _MAX_MODELS, limit)
    return model, path


def _log_provisional(problem: SearchProblem) -> None:
    fit, what = problem.provisional(), "no lump stands out"
    for shape in fit.field.shapes(fit.z):
        center = ", ".join(f"{x:.1f}" for x in shape.center_mm)
        times = f"{shape.contrast:.2g} times" if shape.contrast < _MANY else "many times"
        what = (
            f"a lump at ({center}) mm, of the volume of a ball of {shape.radius_mm:.1f} mm radius, "
            f"with {times} the modulus around it"
        )
    _log.info("provisional: %s; the search goes on", what)


def _final(problem: SearchProblem, model: Model) -> Model:
    """Return the model fitted closely, or as it is where this fails."""
    try:
        return problem.final(model)
    except ConvergenceError as error:
        _log.warning("The last fit fails, and the model is that of the search: %s", error)
        return model


def _result(
    problem: SearchProblem, model: Model, posterior: ShapePosterior, history: list[dict[str, Any]]
) -> ShapeReconstruction:
    fit = model.fit
    history.append(record("final fit", fit))
    _log.info("final fit: chi2 %.4g", fit.chi2)
    score, count = problem.held_out_score(fit, model.errors), len(fit.field.parts)
    each = [_over_rival(problem, model, [k]) for k in range(count)]
    odds_any = each[0].log_odds if count == 1 else 0.0
    if count > 1:
        odds_any = _over_rival(problem, model, range(count)).log_odds
    gains = [problem.predictive_gain(score, one.rival, one.errors) for one in each]
    result = ShapeReconstruction(
        fit.field, fit.optimum, posterior, fit.chi2,
        tuple(one.log_odds for one in each), odds_any, model.errors,
        unexplained(model, problem.full.data), tuple(history), held_out=score,
        predictive=tuple(gains),
    )  # fmt: skip
    return replace(result, at_medians=problem.belong_together(model, result.estimate))


def _first(
    problem: SearchProblem, before: ShapeReconstruction | Start | None
) -> tuple[Model, _Path]:
    """Fit the model of an earlier result, or where there is none a uniform body."""
    what, model = "uniform", None
    # A background that varies, found of few presses, would hide the inclusion that more show.
    if before is not None and before.field.families:
        start = problem.continued(before)
        try:
            what, model = start.what, problem.first(start)
        except ConvergenceError as error:
            _log.info("%s fails, and the search starts from a uniform body: %s", start.what, error)
    model = model or problem.uniform()
    _log.info("%s: chi2 %.4g", what, model.fit.chi2)
    return model, _Path(_state(model), [record(what, model.fit)])


def _accept(
    problem: SearchProblem, model: Model, untried: list[Proposal], fitted: dict[int, ShapeFit]
) -> tuple[Proposal, Model] | None:
    """Return the proposal of most evidence by the full model, if that is more than the model's.

    Once there is one, only the first of each other kind are fitted that do not promise much less
    than the best. Those that were fitted are removed from the list, and their fits kept.
    """
    best: tuple[Proposal, Model] | None = None
    least = problem.rival_share * max((proposal.promise for proposal in untried), default=0.0)
    kinds = set[tuple[bool, ...]]()
    while untried:
        proposal = untried[0]
        if best is None or (proposal.promise > least and proposal.kind not in kinds):
            kinds.add(proposal.kind)
            best = _challenge(problem, proposal, model, best and best[1], fitted) or best
        del untried[0]
    return best


def _challenge(
    problem: SearchProblem,
    proposal: Proposal,
    model: Model,
    rival: Model | None,
    fitted: dict[int, ShapeFit],
) -> tuple[Proposal, Model] | None:
    """Return a proposal fitted with the full model; None without enough evidence."""
    first = proposal
    with suppress(ConvergenceError), progress_line(proposal.what):
        missing = -proposal.least_gain if rival is None else 0.0
        trial = problem.challenge(proposal, model, missing, rival)
        fitted[id(first)] = trial.fit
        if faint := faint_inclusions(trial.fit):
            # The rest may explain as much, such as another form beside which a lump was tried.
            rest = less(trial, faint)
            proposal = replace(proposal, what=f"{proposal.what}, {rest.what}")
            trial = problem.challenge(rest, model, missing, rival)
            fitted[id(first)] = trial.fit
        change = problem.gain(trial.fit, model.fit)
        _log.info("%s: chi2 %.4g, log-evidence %+.4g", proposal.what, trial.fit.chi2, change)
        is_better = rival is None or problem.gain(trial.fit, rival.fit) > 0.0
        if change > proposal.least_gain and is_better and not is_negligible(trial.fit):
            return proposal, trial
    return None


class _Likely(NamedTuple):
    """A model that may be the right one, with its log-probability, but for a constant."""

    weight: float
    model: Model
    what: str = ""


def _alternatives(
    problem: SearchProblem,
    model: Model,
    rejected: Sequence[Proposal],
    fitted: Mapping[int, ShapeFit],
) -> Iterator[_Likely]:
    """Yield models of other inclusions that are about as probable as a model.

    One of two models has less probability beforehand by the gain of evidence for which it would be
    accepted after the other. They are fitted as far as they may be probable, and not only as far as
    they may be accepted.
    """
    scale, size = problem.min_gain / MIN_GAIN, model.fit.field.size
    best: dict[object, tuple[float, float, Proposal]] = {}
    for proposal in rejected:
        gain = proposal.gain
        if (known := fitted.get(id(proposal))) is not None:  # a fit that may have ended early
            gain = max(gain, problem.gain(known, model.fit))
            if len(known.field.families) < len(proposal.field.families):
                proposal = replace(proposal, what=f"{proposal.what}, without its faint lump")
            proposal = replace(proposal, field=known.field, z=known.z)
        form = _form(proposal.field)
        handicap = proposal.least_gain / scale - MIN_GAIN * (proposal.field.size <= size)
        weight = gain / scale - handicap
        if form == _form(model.fit.field) or is_negligible(proposal.trial):
            continue
        if weight > best.get(form, (-np.inf,))[0]:
            best[form] = weight, handicap, proposal
    tried = sorted(best.values(), key=lambda one: -one[0])[: problem.max_alternatives]
    for weight, handicap, proposal in tried:
        if weight < _LEAST_LOG - _OFF:
            continue
        with suppress(ConvergenceError), progress_line(proposal.what):
            other = problem.challenge(proposal, model, -scale * (_LEAST_LOG + handicap))
            gain = problem.gain(other.fit, model.fit)
            _log.info("alternative, %s: log-evidence %+.4g", proposal.what, gain)
            if gain / scale - handicap > _LEAST_LOG and not is_negligible(other.fit):
                yield _Likely(gain / scale - handicap, other, proposal.what)


def _shares(problem: SearchProblem, likely: Sequence[_Likely]) -> tuple[Alternative, ...]:
    """Return all models but the first, with the probabilities that they have."""
    weights = np.exp([one.weight - likely[0].weight for one in likely])
    found = []
    for p, one in zip((weights / weights.sum()).tolist()[1:], likely[1:], strict=True):
        if p > _LEAST_PROBABLE:
            fit, posterior = one.model.fit, make_posterior(one.model, problem.sites)
            found.append(Alternative(p, fit.field, fit.optimum, posterior))
    return tuple(found)


def _form(shapes: ShapeField) -> object:
    """Return what distinguishes alternatives: the families of inclusions, and steps."""
    families = tuple(sorted(family.judged_as for family in shapes.families))
    return families, shapes.background.steps


class _Over(NamedTuple):
    """The log-evidence of a model over that of a rival."""

    log_odds: float
    rival: ShapeFit
    errors: Levels


def _over_rival(problem: SearchProblem, model: Model, removed: Sequence[int]) -> _Over:
    """Compare a model with the best one without some of its inclusions."""
    inflation = max(1.0, model.fit.chi2)
    others = [
        _Over(model.fit.log_evidence(inflation) - fit.log_evidence(inflation), fit, errors)
        for errors, fit in problem.without(model, removed)
    ]
    best = min(others, key=lambda other: other.log_odds)
    return best._replace(log_odds=min(best.log_odds, MAX_LOG_ODDS))
