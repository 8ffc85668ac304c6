"""The one search: provisional answers, sources of proposals and what models are compared by."""

import logging
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from tactorch.errors import CancelledError
from tactorch.inverse import Settings, find_shapes
from tactorch.inverse.fields import (
    BALL,
    ELLIPSOID,
    FAMILIES,
    Background,
    Candidate,
    ShapeField,
    ShapePrior,
)
from tactorch.inverse.fields.tube import RING
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search import search
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.draft import DraftShapes
from tactorch.inverse.search.draft_errors import DraftOptions
from tactorch.inverse.search.model import (
    Model,
    Proposal,
    Start,
    TimeLimit,
    gain,
    noise_weights,
)
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.proposals import (
    _by_kind,
    _further_beside,
    _kind,
    promising,
    propose,
)
from tactorch.inverse.search.search import _accept, _alternatives, _Likely, _shares
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 4, tets_per_cell=5)
PLAN = PressPlan(("z+", "x+"), (0.01, 0.02))


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Presses on a ball of radius 2.5 mm and 1 MPa at (5, 5, 6) mm, from a finer other mesh."""
    phantom = make_phantom("cube_sphere", depth=0.4, radius=0.25)
    fine = box_mesh(10.0, 7)
    return simulate(phantom, PLAN, mesh=MESH, fine_mesh=fine, element="tet10", snr_db=40.0)


@pytest.fixture(scope="module")
def uniform() -> Recording:
    """Presses on a body without an inclusion."""
    return simulate(make_phantom("uniform_cube"), PLAN, mesh=MESH, element="tet4", snr_db=30.0)


def test_a_provisional_answer_comes_first(
    recording: Recording, caplog: pytest.LogCaptureFixture
) -> None:
    def has_first_model() -> bool:
        return "uniform: chi2" in caplog.text

    with caplog.at_level(logging.INFO), pytest.raises(CancelledError):
        find_shapes(recording, stop=has_first_model)
    assert 0 < caplog.text.index("provisional: a lump at") < caplog.text.index("uniform: chi2")
    (shape,) = (fit := ShapeProblem(recording, Settings()).provisional()).field.shapes(fit.z)
    assert shape.center_mm == pytest.approx((5.0, 5.0, 6.0), abs=0.5)
    assert shape.radius_mm == pytest.approx(2.5, rel=0.25)


def test_no_provisional_lump_where_there_is_none(uniform: Recording) -> None:
    # Predictions of linear elements, so that errors of the discretisation are no structure.
    same = replace(uniform, provenance={"inverse_crime": True, "element": "tet4"})
    assert not ShapeProblem(same, Settings()).provisional().field.families


def test_further_inclusions_are_proposed_up_to_the_limit(recording: Recording) -> None:
    for limit, expected in ((0, 0), (1, 1)):
        problem = ShapeProblem(recording, Settings(), max_shapes=limit)
        proposals = promising(problem, propose(problem, model := problem.uniform()))
        assert max(len(p.field.families) for p in proposals) == expected
        gains = [problem.gain(p.trial, model.fit) for p in proposals]
        assert min(gains) > problem.min_gain


def test_parameters_belong_together_as_far_as_they_explain_the_presses(uniform: Recording) -> None:
    problem = ShapeProblem(uniform, Settings())
    model = problem.uniform()
    deviation = float(np.sqrt(model.fit.covariance[0, 0]))
    accepted = [problem.belong_together(model, model.fit.z + k * deviation) for k in range(5)]
    assert accepted == [True, True, True, False, False]  # of one parameter, up to 5.2 ** 0.5


def test_groups_that_no_model_explains_count_less() -> None:
    rng = np.random.default_rng(0)
    groups, noise = np.repeat([0, 1], 50), rng.standard_normal(100)
    noise /= np.sqrt(np.mean(noise**2))
    wrong = np.where(groups == 1, 30.0, 1.0) * noise  # the second group is off by 30
    weights = noise_weights(groups, wrong, 2.0 * wrong)
    assert weights[groups == 0] == pytest.approx(1.0 / max(1.0, float(np.mean(noise[:50] ** 2))))
    assert weights[groups == 1] == pytest.approx(1.0 / np.mean(wrong[50:] ** 2))
    better = wrong - 0.5 * np.where(groups == 0, noise, 0.0)
    pairs = ((better, 1.0), (wrong, 0.0))
    fits = [Mock(spec=ShapeFit, residuals=r, complexity=c) for r, c in pairs]
    change = gain(*fits, groups)
    squares = float(np.sum(wrong[:50] ** 2 - better[:50] ** 2))
    assert change == pytest.approx(0.5 * squares - 1.0, rel=0.2)
    assert change > 10.0 * (gain(*fits) + 1.0)


def test_a_session_gives_up_a_ball_that_further_presses_contradict(
    recording: Recording,
) -> None:
    options = DraftOptions(model_deviation=0.01)
    found = DraftShapes(options=options).fit(recording)
    assert len(found.field.families) == 1
    body = make_phantom("uniform_cube")
    presses = simulate(body, PLAN, mesh=MESH, element="tet10", snr_db=30.0)
    after = DraftShapes(options=options).fit(presses, start=found)
    assert not after.field.families
    assert after.history[0]["model"] == "the model before"


def _evidence(value: float) -> Mock:
    return Mock(spec=ShapeFit, residuals=np.zeros(4), complexity=-value)


def _proposal(what: str, promise: float, model: Mock, **changes: Any) -> Proposal:
    field = replace(model.fit.field, **changes)
    start = Start(what, field, np.zeros(field.size), {})
    values = vars(start).values()
    return Proposal(*values, _evidence(promise), promise, 3.0, promise, _kind(start, model))


@pytest.fixture
def model() -> Mock:
    """A model of one ball in a uniform background."""
    field = ShapeField(ShapePrior.of(MESH, 0.2), (BALL,))
    fit = Mock(spec=ShapeFit, field=field, residuals=np.zeros(4), complexity=0.0)
    return Mock(spec=Model, fit=fit, errors={})


def test_the_best_of_each_kind_are_tried_first(model: Mock) -> None:
    two = (BALL, BALL)
    proposals = [
        _proposal("one place", 40.0, model, families=two),
        _proposal("another place", 30.0, model, families=two),
        _proposal("irregular", 25.0, model, families=(FAMILIES["irregular lump"],)),
        _proposal("a ring", 20.0, model, families=(RING,)),
        _proposal("a third place", 15.0, model, families=two),
        _proposal("smooth", 10.0, model, background=Background(2)),
    ]
    order = [proposal.what for proposal in _by_kind(proposals)]
    first = ["one place", "irregular", "a ring", "smooth"]
    assert order == [*first, "another place", "a third place"]


def test_a_further_inclusion_is_tried_beside_other_forms(model: Mock) -> None:
    proposals = [
        _proposal("a further ball", 40.0, model, families=(BALL, BALL)),
        _proposal("a ring", 20.0, model, families=(RING,)),
        _proposal("an ellipsoid", 30.0, model, families=(ELLIPSOID,)),
        _proposal("a rod", 10.0, model, families=(FAMILIES["rod"],)),
        _proposal("smooth", 50.0, model, background=Background(2)),
    ]
    for proposal in proposals:
        fitted = {"field": proposal.field, "z": proposal.z, "jacobian": np.zeros((4, 1))}
        proposal.trial.configure_mock(**fitted)
    problem = Mock(spec=SearchProblem, groups=None, forms=("ring",), max_shapes=2)
    found = Candidate(np.full(3, 4.0), 1.0, 0.5, 20.0, np.zeros(3))
    problem.filter.return_value.best.return_value = [found]
    starts = [*_further_beside(problem, model, proposals)]
    assert [start.field.families for start in starts] == [(ELLIPSOID, BALL), (RING, BALL)]
    np.testing.assert_allclose(starts[0].field.physical(starts[0].z)[-5:-2], 4.0)
    problem.filter.return_value.best.return_value = [found._replace(gain=1.0)]
    assert not [*_further_beside(problem, model, proposals)]
    problem.filter.return_value.best.return_value = [found]
    problem.max_shapes = 1
    assert not [*_further_beside(problem, model, proposals)]


@pytest.mark.parametrize(
    ("gains", "share", "accepted", "fitted"),
    [
        # The best by the full model, not the most promising; another place is not fitted.
        ([34.0, 117.0, 50.0, 5.0], 0.1, "ring", ["ball", "ring"]),
        ([34.0, 2.0, 50.0, 5.0], 0.1, "ball", ["ball", "ring"]),
        ([2.0, 1.0, 50.0, 5.0], 0.1, "place", ["ball", "ring", "place"]),
        # One that promises little is fitted where all before it are refused.
        ([2.0, 1.0, 1.0, 5.0], 0.1, "smooth", ["ball", "ring", "place", "smooth"]),
        ([2.0, 1.0, 1.0, 2.0], 0.1, None, ["ball", "ring", "place", "smooth"]),
        ([34.0, 117.0, 50.0, 5.0], 1.0, "ball", ["ball"]),  # the first is accepted
    ],
)
def test_the_best_proposal_is_accepted(
    model: Mock, gains: list[float], share: float, accepted: str | None, fitted: list[str]
) -> None:
    two = (BALL, BALL)
    proposals = [
        _proposal("ball", 40.0, model, families=two),
        _proposal("ring", 16.0, model, families=(RING,)),
        _proposal("place", 12.0, model, families=two),
        _proposal("smooth", 3.5, model, background=Background(2)),
    ]
    full = dict(zip([proposal.what for proposal in proposals], gains, strict=True))
    calls: list[str] = []

    def challenge(proposal: Proposal, _: Model, margin: float, rival: Model | None) -> Mock:
        calls.append(proposal.what)
        # A fit goes on while it may have the gain that is needed.
        assert margin == (-proposal.least_gain if rival is None else 0.0)
        fit = _evidence(full[proposal.what])
        fit.configure_mock(field=proposal.field, z=np.ones(proposal.field.size))
        return Mock(spec=Model, fit=fit)

    problem = Mock(spec=SearchProblem, challenge=challenge, rival_share=share)
    problem.gain = lambda fit, rival: rival.complexity - fit.complexity
    kept = dict[int, ShapeFit]()
    found = _accept(problem, model, proposals, kept)
    assert calls == fitted
    assert len(kept) == len(fitted)
    assert (found and found[0].what) == accepted
    assert not proposals


def test_a_form_is_accepted_without_the_faint_lump_beside_it(model: Mock) -> None:
    """What a proposal explains must not be lost where one of its inclusions explains nothing."""
    proposal = _proposal("ring, ball", 9.0, model, families=(RING, BALL))
    fields: list[tuple[Any, ...]] = []

    def challenge(start: Start, *_: Any) -> Model:
        fields.append(start.field.families)
        fit = _evidence(12.0 if start.field.families == (RING,) else 10.0)
        z = np.ones(start.field.size)
        if BALL in start.field.families:
            z[-1] = 0.0  # its log-contrast
        fit.configure_mock(field=start.field, z=z)
        return Model(fit, Mock(spec=Evaluation), {})

    problem = Mock(spec=SearchProblem, challenge=challenge, rival_share=0.1)
    problem.gain = lambda fit, rival: rival.complexity - fit.complexity
    kept = dict[int, ShapeFit]()
    found = _accept(problem, model, [proposal], kept)
    assert found is not None
    assert fields == [(RING, BALL), (RING,)]
    assert found[0].what == "ring, ball, inclusion 1 removed"
    assert found[1].fit.field.families == (RING,)
    assert kept[id(proposal)] is found[1].fit


@pytest.mark.parametrize("scale", [1.0, 13.0])
def test_alternatives_share_the_probability(
    model: Mock, scale: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gains of a palpation are those of several presses a place; the weights are not."""
    rod = FAMILIES["rod"]
    proposals = [
        _proposal("ring", 2.0 * scale, model, families=(RING,)),
        _proposal("another ring", 1.0 * scale, model, families=(RING,)),
        replace(_proposal("none", -1.0 * scale, model, families=()), least_gain=0.0),
        _proposal("rod", -9.0 * scale, model, families=(rod,)),
        _proposal("ellipsoid", 2.9 * scale, model, families=(ELLIPSOID,)),  # as a ball is judged
        _proposal("smooth", 2.9 * scale, model, background=Background(2)),
    ]
    gains, calls = {"ring": 2.5, "none": -3.5}, dict[str, float]()
    starts = dict[str, np.ndarray]()

    def challenge(proposal: Proposal, _: Model, margin: float) -> Mock:
        calls[proposal.what], starts[proposal.what] = margin, proposal.z
        fit = _evidence(scale * gains[proposal.what])
        # The fitted lump has a contrast, so that it is not negligible.
        z = np.ones(proposal.field.size)
        fit.configure_mock(field=proposal.field, z=z, optimum=z)
        return Mock(spec=Model, fit=fit)

    for proposal in proposals:
        fitted = {"field": proposal.field, "z": np.ones(proposal.field.size)}
        proposal.trial.configure_mock(**fitted)
        if proposal.what != "none":
            object.__setattr__(proposal, "least_gain", 3.0 * scale)
    problem = Mock(
        spec=SearchProblem, challenge=challenge, min_gain=3.0 * scale, max_alternatives=2
    )
    problem.gain = lambda fit, rival: rival.complexity - fit.complexity
    found = [*_alternatives(problem, model, proposals, {})]
    # A fit ends where the probability will be below 5 %.
    least = np.log(0.05) * scale
    assert calls == pytest.approx({
        "none": -(least - 3.0 * scale), "ring": -(least + 3.0 * scale)
    })  # fmt: skip
    # The ring has more parameters, and would have been accepted with a gain of 3; after a uniform
    # body the ball would have been.
    model.fit.configure_mock(optimum=np.zeros(model.fit.field.size))
    assert {one.what: one.weight for one in found} == pytest.approx({"none": -0.5, "ring": -0.5})
    monkeypatch.setattr(search, "make_posterior", lambda model, sites: Mock(spec=ShapePosterior))
    problem.sites = None
    shares = _shares(problem, [_Likely(0.0, model), *found])
    weights = np.exp([0.0, -0.5, -0.5])
    assert [a.probability for a in shares] == pytest.approx(weights[1:] / weights.sum())
    assert {a.field.families for a in shares} == {(), (RING,)}
    # Of two models the one that was accepted first may be the less probable.
    (first,) = _shares(problem, [found[0], _Likely(-1.5, model)])
    assert first.field is model.fit.field
    assert first.probability == pytest.approx(1.0 / (1.0 + np.exp(1.0)))
    # A fit that ended early goes on from where it was.
    ring = next(one.model for one in found if one.what == "ring")
    ring.fit.z[:] = 0.5
    [*_alternatives(problem, model, proposals, {id(proposals[0]): ring.fit})]
    assert starts["ring"] == pytest.approx(0.5)
    # A step without contrast is none, and does not take the place of others.
    faint = replace(proposals[0], what="faint", gain=9.0 * scale, trial=_evidence(9.0 * scale))
    faint.trial.configure_mock(field=proposals[0].field, z=np.zeros(proposals[0].field.size))
    assert [*_alternatives(problem, model, [faint], {})] == []
    # With other errors, the gain that these have without the ring is no gain of the ring.
    other = replace(proposals[0], least_gain=4.5 * scale)
    (one,) = _alternatives(problem, model, [other], {})
    assert one.weight == pytest.approx(2.5 - 4.5)
    gains |= {"ring": -0.2, "none": -6.2}
    assert not [*_alternatives(problem, model, proposals, {})]
    assert not [*_alternatives(problem, model, _only(proposals, "smooth", "ellipsoid"), {})]


def _only(proposals: list[Proposal], *names: str) -> list[Proposal]:
    return [proposal for proposal in proposals if proposal.what in names]


def test_the_most_probable_model_is_the_result(
    model: Mock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupted comparison keeps what it has, and is noted."""
    better, worse = (Mock(spec=Model, fit=model.fit, errors={}, name=name) for name in "ab")
    path = Mock(rejected=[], fitted={}, history=[], untried=[], ended=None)
    path.kept = nullcontext

    def alternatives(*_: Any) -> Iterator[_Likely]:
        yield _Likely(1.0, better, "a ring")
        yield _Likely(-1.0, worse, "a rod")
        raise KeyboardInterrupt

    field = ShapeField(ShapePrior.of(MESH, 0.2))
    posterior = ShapePosterior(field, np.zeros(1), np.zeros(1), np.eye(1))
    result = ShapeReconstruction(field, np.zeros(1), posterior, 1.0, (), 0.0)
    problem = Mock(spec=SearchProblem, sites=None)
    problem.precise = problem.final = lambda model: model
    problem.posterior = lambda model: (model, posterior)
    model.fit.configure_mock(z=np.zeros(6), optimum=np.zeros(6))
    for name, value in {
        "_accept_models": lambda *_: (model, path), "_alternatives": alternatives,
        "_result": lambda *_: result, "make_posterior": lambda *_: posterior,
    }.items():  # fmt: skip
        monkeypatch.setattr(search, name, value)
    best, found = search.search(problem, TimeLimit(None, lambda: False))
    assert best is better
    path.accept.assert_called_once_with("a ring", better)
    assert found.ended is StopReason.INTERRUPTED
    weights = np.exp([0.0, -1.0, -2.0])
    shares = [other.probability for other in found.alternatives]
    assert shares == pytest.approx(weights[1:] / weights.sum())
