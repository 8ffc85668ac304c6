"""The weight of the prior, chosen without the truth: lowered until the data are fitted.

Discrepancy principle (Morozov, 1966): the weight falls until the mean squared residual reaches one,
the noise. A map that converges to less than the noise at that weight is overfitted: the weight
rises again, and is bisected. Two other rules choose it at every iterate from the linearised
problem: generalised cross-validation (Golub, Heath and Wahba, 1979) takes the weight that predicts
left-out data best, the L-curve (Hansen, 1998) the corner of misfit against prior. Neither needs the
size of the noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.fit.optimizers.spectrum import RULES, Spectrum

# Factors of the weight per step: a leap, far from the data, and near the noise.
_LEAP, _FAST, _SLOW = 0.1, 1.0 / 3.0, 0.6
# Mean squared residuals: below _NEAR the weight falls slowly; above _FAR it leaps after a step of a
# gain (fall of the objective over the predicted fall) of _LEAP_GAIN or more.
_NEAR, _FAR, _LEAP_GAIN = 10.0, 100.0, 0.75
#: Gain below which the weight has fallen too far for the last step.
MIN_GAIN = 0.1
_EXHAUSTED = 1e-12  # weight relative to the first below which the prior is exhausted
_ENDS = (None, StopReason.FITTED, StopReason.NOT_FITTED, StopReason.WEIGHT_CHOSEN)
# Mean squared residual, once converged, that counts as the noise.
_MIN_CHI2, _MAX_CHI2 = 0.9, 1.02
_MAX_ROUNDS, _RAISE = 8, 3.0
# Mean squared residual that needs no convergence to count as overfitted, and in how many rounds.
_FAR_OVERFITTED, _EARLY_ROUNDS = 0.3, 3
_MAX_RAISE = 100.0
# Ratio of successive changes of the misfit up to which its limit is extrapolated, and the factor by
# which that limit must be outside the accepted range.
_MAX_RATIO, _MARGIN = 0.9, 1.05
# Largest change of a chosen weight per step; largest number of choices; change that ends them.
_MAX_CHANGE, _MAX_CHOICES, _CHANGE_TOLERANCE = 3.0, 30, 1.2
_DOMINANCE = 30.0  # of the prior's trace over that of J^T J at the first weight
_STRONG = 10.0  # factor of the first weight for maps of strong contrast
# Attribute of the schedule for each number of its state.
_STATE = {"weight": "weight", "first_weight": "first"} | {
    f"weight_{name}": name
    for name in ("rounds", "below", "above", "last", "before", "held", "leapt")
}


@dataclass
class RegularizationSchedule:
    """A weight that is lowered from step to step, or fixed."""

    weight: float
    first: float  # weight at the start
    fixed: bool  # the weight was given
    ended: StopReason | None = None  # why the weight falls no further; None where it was given
    rule: str = "discrepancy"  # or "l_curve", "gcv"
    rounds: int = 0  # weights tried since the first end, or choices by another rule
    below: float = 0.0  # largest weight that overfitted once converged
    above: float = np.inf  # smallest weight that misfitted once converged
    last: float = 0.0  # mean squared residual of the last iterate, if at this weight; else zero
    before: float = 0.0  # that of the iterate before
    held: bool = False  # the weight was kept because the last step had too small a gain
    leapt: bool = False  # the weight has just fallen by a leap

    @staticmethod
    def start(
        point: Point, state: dict[str, float], rule: str = "discrepancy", trace: float | None = None
    ) -> "RegularizationSchedule":
        """Start from the given weight, a stored one, or one at which the prior dominates.

        `trace` is that of J^T J, where the sensitivity matrix J is not formed.
        """
        weight = point.objective.weight
        if weight is not None:
            return RegularizationSchedule(weight, weight, True)
        if "weight" not in state:
            prior, first = float(point.penalty_curvature.diagonal().sum()), 0.0
            if prior > 0:  # there is a prior, and more than a single element, which has no jumps
                if trace is None:
                    trace = float(np.einsum("ij,ij->", point.jacobian, point.jacobian))
                first = _DOMINANCE * (trace / prior)
                first *= _STRONG if point.objective.strong_contrast else 1.0
            return RegularizationSchedule(first, first, fixed=first == 0.0, rule=rule)
        schedule = RegularizationSchedule(0.0, 0.0, False, _ENDS[int(state["ended"])], rule)
        for key, name in _STATE.items():
            default = getattr(schedule, name)
            setattr(schedule, name, type(default)(state.get(key, default)))
        return schedule

    def state(self) -> dict[str, float]:
        """Return the numbers to resume from; none where the weight was given."""
        if self.fixed:
            return {}
        numbers = {key: float(getattr(self, name)) for key, name in _STATE.items()}
        return {**numbers, "ended": float(_ENDS.index(self.ended))}

    @property
    def final(self) -> bool:
        """Whether the weight falls no further."""
        return self.fixed or self.ended is not None

    def update(self, point: Point, gain: float = np.nan) -> None:
        """Take the next weight by the rule, after a step to this point.

        The gain is the fall of the objective over the predicted one; NaN forbids leaps.
        """
        chi2 = point.evaluation.chi2
        if self.rule == "discrepancy":
            self.lower(chi2, gain)
            return
        if self.final:
            return
        if chi2 > _NEAR and self.weight >= _EXHAUSTED * self.first:
            self.weight *= _FAST  # far from the data, the linearised problem is uninformative
            return
        spectrum = Spectrum.at(point)
        wanted = self.weight if spectrum is None else RULES[self.rule](spectrum)
        change = float(np.clip(wanted / self.weight, 1.0 / _MAX_CHANGE, _MAX_CHANGE))
        self.weight *= change
        self.rounds += 1
        if max(change, 1.0 / change) <= _CHANGE_TOLERANCE or self.rounds >= _MAX_CHOICES:
            self.ended = StopReason.WEIGHT_CHOSEN

    def lower(self, chi2: float, gain: float = np.nan) -> None:
        """Lower the weight by the discrepancy rule; see `update`.

        Near the noise the weight is kept after a step of small gain: the map has not followed yet,
        and the prior would be without effect by the time it has.
        """
        if self.fixed:
            return
        self.held = self.leapt = False
        if chi2 <= 1.0:
            self.ended = StopReason.FITTED  # possibly after the prior was exhausted
        elif self.ended is not None:
            return
        elif self.weight < _EXHAUSTED * self.first:
            self.ended = StopReason.NOT_FITTED
        elif chi2 <= _NEAR and gain < MIN_GAIN:
            self.held = True
        elif chi2 > _FAR and gain >= _LEAP_GAIN:
            self.weight *= _LEAP
            self.leapt = True
        else:
            self.weight *= _FAST if chi2 > _NEAR else _SLOW

    def retract(self) -> None:
        """Reduce a leap to a fast fall."""
        self.weight *= _FAST / _LEAP
        self.leapt = False

    def retry(self, point: Point, converged: bool = True) -> bool:
        """Change the weight where the map is overfitted or misfitted; return whether it changed.

        The weight rises until the converged map misfits, then is bisected, for a few rounds. A map
        need not converge where its misfit can be extrapolated (Aitken, 1926), nor in the first
        rounds where the data are far overfitted. Where the noise may be smaller than assumed, a
        smaller misfit is no overfit; nor is it where it is no smaller than the noise alone, since
        the error of the model may be smaller than its allowance.
        """
        problem, chi2 = point.objective.problem, point.evaluation.chi2
        fitted = self.ended is StopReason.FITTED and self.rule == "discrepancy"
        if not fitted or self.rounds >= _MAX_ROUNDS:
            return False
        if not (converged and chi2 > _MAX_CHI2) and problem.noise_is_limit:
            return False
        minimum = _MIN_CHI2 * problem.data.noise_fraction
        certain = converged or self._ends_outside(chi2, minimum)
        self.last, self.before = chi2, self.last
        if not certain and (chi2 >= _FAR_OVERFITTED or self.rounds >= _EARLY_ROUNDS):
            return False
        if minimum <= chi2 <= _MAX_CHI2:
            return False
        if chi2 > _MAX_CHI2:
            self.above = min(self.above, self.weight)
        elif certain:
            self.below = max(self.below, self.weight)
        if np.isinf(self.above):
            self.weight *= float(np.clip(1.0 / max(chi2, 1.0 / _MAX_RAISE), _RAISE, None))
        else:
            self.weight = float(np.sqrt(max(self.below, self.above / _RAISE**2) * self.above))
        self.rounds += 1
        self.last = self.before = 0.0
        return True

    def _ends_outside(self, chi2: float, minimum: float) -> bool:
        """Whether the misfit is outside the accepted range, and its limit too."""
        if not self.before:
            return False
        first, second = self.last - self.before, chi2 - self.last
        if not 0.0 < second * first <= _MAX_RATIO * first * first:
            return False
        limit = chi2 + second * second / (first - second)
        overfitted = max(chi2, limit) < minimum / _MARGIN
        return overfitted or min(chi2, limit) > _MAX_CHI2 * _MARGIN


def warm_start_state(state: Mapping[str, float], growth: float) -> dict[str, float]:
    """Return the state of a schedule to continue from with more data; empty where it is of no use.

    A weight that fitted the data is kept, and lowered or raised from there; one chosen by another
    rule is chosen again. Uninformative data raise the weight without end: it starts no higher than
    a hundred times one that dominates at a uniform map. The amount of data is `growth` times that
    at which the weight was first taken.
    """
    if not state or state.get("ended") == float(_ENDS.index(StopReason.NOT_FITTED)):
        return {}
    dominating = growth * state["first_weight"]
    chosen = state["ended"] == float(_ENDS.index(StopReason.WEIGHT_CHOSEN))
    return {
        "weight": min(state["weight"], _MAX_RAISE * dominating),
        "first_weight": dominating,
        "ended": 0.0 if chosen else state["ended"],
    }
