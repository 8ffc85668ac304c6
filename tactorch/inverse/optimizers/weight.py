"""The weight of the prior, chosen without the truth: cooled until the data are fitted.

Discrepancy principle (Morozov, 1966): lower the weight until the mean squared residual reaches
one, that is, the noise, and no further. What converges to less than the noise at that weight was
overfitted: the weight is raised again, and bisected. Other rules: see `weight_rules`.
"""

from dataclasses import dataclass

import numpy as np

from tactorch.inverse.objective import Point
from tactorch.inverse.optimizers.spectrum import Spectrum
from tactorch.inverse.optimizers.weight_rules import RULES

_LEAP, _FAST, _SLOW = 0.1, 1.0 / 3.0, 0.6
# Mean squared residuals: below, the weight is lowered slowly; above, in leaps, where the last step
# fell nearly as far as was foretold.
_NEAR, _FAR, _FORETOLD = 10.0, 100.0, 0.75
# Fall of the objective over the fall foretold, below which the weight fell too far for that step.
POOR = 0.1
_EXHAUSTED = 1e-12
_UNSTOPPED = ""
_FITTED = "the data are fitted to their noise"
_UNFITTED = (
    "the prior is exhausted and the data are not fitted to their noise: the noise is larger than "
    "stated, or the model is wrong"
)
_CHOSEN = "the weight of the prior has settled"
_REASONS = (_UNSTOPPED, _FITTED, _UNFITTED, _CHOSEN)  # saved by index
# Mean squared residual, once converged, that counts as the noise.
_OVERFITTED, _MISFITTED = 0.9, 1.02
_ROUNDS, _RAISE = 8, 3.0
_FAR_OVER, _EARLY = 0.3, 3  # mean squared residual that needs no converging; how often it may not
_MOST_RAISED = 100.0
# Ratio of successive changes of the misfit up to which its limit is foretold, and how far beyond
# the limits that must lie.
_CREEPING, _BEYOND = 0.9, 1.05
_CHANGE, _LOOKS = 3.0, 30  # largest change of a chosen weight in one step; most choices
_SAME = 1.2
_RULE = 30.0


@dataclass
class RegularizationSchedule:
    """A weight that falls, or stays where it was given.

    Attributes:
        weight: Present weight.
        first: Weight at the start.
        fixed: Whether it was given.
        ended: Why it falls no further; empty while it falls, or where it was given.
        rule: What decides: "discrepancy", "l_curve" or "gcv".
        rounds: Weights tried since the first end, or choices made by another rule.
        below: Largest weight that overfitted once converged; zero if none did.
        above: Smallest weight that misfitted once converged; infinite if none did.
        last: Mean squared residual at the last look, if the weight was the same; else zero.
        before: The same at the look before.
        held: Whether it was kept after a step that was not foretold.
        leapt: Whether it has just fallen by a leap.
    """

    weight: float
    first: float
    fixed: bool
    ended: str = _UNSTOPPED
    rule: str = "discrepancy"
    rounds: int = 0
    below: float = 0.0
    above: float = np.inf
    last: float = 0.0
    before: float = 0.0
    held: bool = False
    leapt: bool = False

    @staticmethod
    def start(
        point: Point, state: dict[str, float], rule: str = "discrepancy"
    ) -> "RegularizationSchedule":
        """Take the given weight, a resumed one, or one at which the prior dominates at `point`."""
        weight = point.objective.weight
        if weight is not None:
            return RegularizationSchedule(weight, weight, True)
        if "weight" in state:
            ended = _REASONS[int(state["ended"])]
            return RegularizationSchedule(
                state["weight"],
                state["first_weight"],
                False,
                ended,
                rule,
                int(state.get("weight_rounds", 0)),
                state.get("weight_below", 0.0),
                state.get("weight_above", np.inf),
                state.get("weight_last", 0.0),
                state.get("weight_before", 0.0),
                bool(state.get("weight_held", 0.0)),
                bool(state.get("weight_leapt", 0.0)),
            )
        first = ruling_weight(point)
        return RegularizationSchedule(first, first, fixed=first == 0.0, rule=rule)

    def state(self) -> dict[str, float]:
        """Numbers from which to resume; none where the weight was given."""
        if self.fixed:
            return {}
        ended = float(_REASONS.index(self.ended))
        return {
            "weight": self.weight,
            "first_weight": self.first,
            "ended": ended,
            "weight_rounds": float(self.rounds),
            "weight_below": self.below,
            "weight_above": self.above,
            "weight_last": self.last,
            "weight_before": self.before,
            "weight_held": float(self.held),
            "weight_leapt": float(self.leapt),
        }

    def follow(self, point: Point, gain: float = np.nan) -> None:
        """Take the next weight by the rule, after a step to `point`.

        Args:
            point: Where the step has led.
            gain: Fall of the objective over the fall that was foretold; NaN where not known.
        """
        chi2 = point.evaluation.chi2
        if self.rule == "discrepancy":
            self.lower(chi2, gain)
            return
        if self.fixed or self.ended:
            return
        if chi2 > _NEAR and self.weight >= _EXHAUSTED * self.first:
            self.weight *= _FAST  # far from the data, the linearised problem says little
            return
        spectrum = Spectrum.of(point)
        wanted = self.weight if spectrum is None else RULES[self.rule](spectrum)
        change = float(np.clip(wanted / self.weight, 1.0 / _CHANGE, _CHANGE))
        self.weight *= change
        self.rounds += 1
        if max(change, 1.0 / change) <= _SAME or self.rounds >= _LOOKS:
            self.ended = _CHOSEN

    def retry(self, point: Point, converged: bool = True) -> bool:
        """Say whether the map calls for another weight, and take it.

        The weight rises until the converged map misfits, then is bisected; no more than a few
        rounds. A map need not converge where the misfit's course tells its end (Aitken, 1926), and
        the first few not where the data are far overfitted. Where the noise may be less than it is
        taken to be, a smaller misfit is no overfit; nor is it where it is no smaller than the noise
        alone, for the model's error beside it may be less than was allowed for.
        """
        problem, chi2 = point.objective.problem, point.evaluation.chi2
        misfits = converged and chi2 > _MISFITTED
        if not misfits and problem.noise.floored(problem.recording):
            return False
        if self.ended != _FITTED or self.rule != "discrepancy" or self.rounds >= _ROUNDS:
            return False
        least = _OVERFITTED * problem.sure_noise
        sure = converged or self._foretold(chi2, least)
        self.last, self.before = chi2, self.last
        if not sure and (chi2 >= _FAR_OVER or self.rounds >= _EARLY):
            return False
        if least <= chi2 <= _MISFITTED:
            return False
        if chi2 > _MISFITTED:
            self.above = min(self.above, self.weight)
        elif sure:
            self.below = max(self.below, self.weight)
        if np.isinf(self.above):
            self.weight *= float(np.clip(1.0 / max(chi2, 1.0 / _MOST_RAISED), _RAISE, None))
        else:
            self.weight = float(np.sqrt(max(self.below, self.above / _RAISE**2) * self.above))
        self.rounds += 1
        self.last = self.before = 0.0
        return True

    def _foretold(self, chi2: float, least: float) -> bool:
        """Whether the misfit is beyond a limit, and will stay there once converged."""
        if not self.before:
            return False
        first, second = self.last - self.before, chi2 - self.last
        if not 0.0 < second * first <= _CREEPING * first * first:
            return False
        end = chi2 + second * second / (first - second)
        over = max(chi2, end) < least / _BEYOND
        return over or min(chi2, end) > _MISFITTED * _BEYOND

    def retract(self) -> None:
        """Take back of a leap what it was beyond a fast fall."""
        self.weight *= _FAST / _LEAP
        self.leapt = False

    def lower(self, chi2: float, gain: float = np.nan) -> None:
        """Lower the weight, unless it was given, has ended or ends now; see `follow`.

        Near the noise it stays after a step that was not foretold: the map has not followed yet,
        and a weight that falls on would leave the prior no say by the time that it has.
        """
        if self.fixed:
            return
        self.held = self.leapt = False
        if chi2 <= 1.0:
            self.ended = _FITTED  # perhaps later than the prior was exhausted
        elif self.ended:
            return
        elif self.weight < _EXHAUSTED * self.first:
            self.ended = _UNFITTED
        elif chi2 <= _NEAR and gain < POOR:
            self.held = True
        elif chi2 > _FAR and gain >= _FORETOLD:
            self.weight *= _LEAP
            self.leapt = True
        else:
            self.weight *= _FAST if chi2 > _NEAR else _SLOW


def warm_start_state(state: dict[str, float], growth: float) -> dict[str, float]:
    """Return the state of a weight from which to go on with more data; none where it is of no use.

    A weight that had fitted the data is kept, for the map to be fitted anew at it, and is lowered
    or raised from there; one that another rule had chosen is chosen anew. Where the data told
    nothing it had risen without end: it begins no higher than a hundred times one that rules over
    a uniform map.

    Args:
        state: What `RegularizationSchedule.state` has told, perhaps among other numbers.
        growth: How many times as many data there are as when the weight was first taken.
    """
    if not state or state.get("ended") == float(_REASONS.index(_UNFITTED)):
        return {}
    ruling = growth * state["first_weight"]
    return {
        "weight": min(state["weight"], _MOST_RAISED * ruling),
        "first_weight": ruling,
        "ended": 0.0 if state["ended"] == float(_REASONS.index(_CHOSEN)) else state["ended"],
    }


def ruling_weight(point: Point) -> float:
    """Return a weight at which the prior dominates: thirty times the ratio of the traces."""
    prior = point.penalty_curvature.diagonal().sum()
    if prior <= 0:  # no prior; or a single element, which has no jumps
        return 0.0
    return _RULE * float(np.einsum("ij,ij->", point.jacobian, point.jacobian) / prior)
