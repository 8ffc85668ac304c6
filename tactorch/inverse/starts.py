"""Starts of an inversion: one modulus, the best uniform one, random draws, or a given map.

A start is a function of the inverse problem and the bounds, as is a learned one.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse.parameterization import Bounds
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.uniform import uniform_fit
from tactorch.linalg import map_cases

_log = logging.getLogger(__name__)
START_MPA = 0.2
_BOUND_RTOL = 1e-9  # relative excess over a bound that counts as rounding
Start: TypeAlias = float | np.ndarray | Callable[[InverseProblem, Bounds], np.ndarray]


#: Settings of the starts by name; each is a function of the problem and the bounds.
INITIALIZATIONS = Registry(
    "initialization",
    {
        "uniform": "tactorch.inverse.starts:Uniform",
        "coarse": "tactorch.inverse.coarse:CoarseStart",
        "surrogate": "tactorch.learning.surrogate:SurrogateStart",
    },
    "starts of an inversion",
)


@dataclass(frozen=True)
class Uniform(Options):
    """One modulus for all elements.

    Attributes:
        start_mpa: The modulus, MPa, or "homogeneous" for the one that fits best.
    """

    section: ClassVar[str] = "initialization"
    start_mpa: float | Literal["homogeneous"] = option(
        START_MPA, "Modulus of the start; homogeneous: the one that fits best", unit="MPa", gt=0
    )

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the map, MPa."""
        if isinstance(self.start_mpa, str):
            return homogeneous(problem, bounds)
        return np.full(problem.n_elements, self.start_mpa)


def best_uniform(
    problem: InverseProblem, bounds: Bounds | None = None, *, first_mpa: float | None = None
) -> float:
    """Return the modulus that fits best where all elements have the same, MPa.

    Raises:
        ConvergenceError: no modulus within the bounds carries the presses.
    """
    return uniform_fit(problem, bounds, first_mpa=first_mpa).youngs_mpa


def homogeneous(problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
    """Return the best uniform map, MPa, fitted together with the nuisance parameters."""
    fit = uniform_fit(problem, bounds, problem.nuisance)
    return np.full(problem.n_elements, fit.youngs_mpa)


def monte_carlo(
    draw: Callable[[np.random.Generator], Float[np.ndarray, " m"]],
    *,
    draws: int = 16,
    seed: int = 0,
) -> Callable[[InverseProblem, Bounds], np.ndarray]:
    """Return a start that draws maps and takes the one that fits best.

    Draws without an equilibrium are skipped. Draws are solved side by side where there are
    fewer presses than cores, else the presses of each.

    Args:
        draw: Draws a map, MPa, such as `sample` of a prior.
        draws: Number of maps.
        seed: Seed of the draws; each has a separate generator.

    Raises:
        ConfigError: `draws` is not positive.
    """
    if draws < 1:
        raise ConfigError(f"draws={draws} must be at least 1.")

    def start(problem: InverseProblem, bounds: Bounds) -> np.ndarray:
        drawn = [
            np.clip(draw(np.random.default_rng([seed, i])), bounds.lower, bounds.upper)
            for i in range(draws)
        ]

        def work(i: int) -> float:
            try:
                return problem.evaluate(drawn[i]).chi2
            except ConvergenceError:
                return np.inf

        chi2 = map_cases(work, draws)
        best = int(np.argmin(chi2))
        if np.isinf(chi2[best]):
            raise ConvergenceError(
                f"None of {draws} random starts carries the presses; draw stiffer maps."
            )
        return drawn[best]

    return start


def fits_better_than_uniform(
    guess: Float[np.ndarray, " m"], problem: InverseProblem, bounds: Bounds, name: str
) -> bool:
    """Return whether a guessed map (MPa) fits the presses better than the best uniform one.

    Both are judged at the nuisance values that the recording states, from which inversions start.

    Args:
        guess: The map, within the bounds.
        problem: What it has to fit.
        bounds: Limits of the moduli.
        name: What to call the guess in the message that it is refused, or taken.

    Raises:
        ConvergenceError: No uniform modulus carries the presses.
    """
    try:
        chi2 = problem.evaluate(guess).chi2
    except ConvergenceError as error:
        _log.warning("The %s map is refused: the presses collapse it (%s).", name, error)
        return False
    fit = uniform_fit(problem, bounds, first_mpa=float(np.median(guess)))
    known = problem.evaluate(np.full(problem.n_elements, fit.youngs_mpa)).chi2
    if not chi2 < known:
        _log.warning(
            "The %s map is refused: its misfit (chi2 %.4g) is no less than that of the best "
            "uniform map (%.4g).", name, chi2, known,
        )  # fmt: skip
        return False
    _log.info("The %s map is taken: chi2 %.4g, best uniform map %.4g", name, chi2, known)
    return True


def start_map(start: Start, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
    """Return the map of a start, MPa.

    Raises:
        ConfigError: its shape is wrong, or it leaves the bounds.
    """
    m = problem.n_elements
    start = start(problem, bounds) if callable(start) else start
    values = np.asarray(start, dtype=np.float64)
    if values.ndim and values.shape != (m,):
        raise ConfigError(f"start_mpa has shape {values.shape}; expected one modulus or ({m},).")
    low, high = bounds.lower * (1 - _BOUND_RTOL), bounds.upper * (1 + _BOUND_RTOL)
    if not np.all((values >= low) & (values <= high)):
        raise ConfigError(
            f"start_mpa spans {values.min():g} to {values.max():g} MPa, outside the bounds "
            f"[{bounds.lower:g}, {bounds.upper:g}] MPa; start inside, or widen them."
        )
    values = np.clip(values, bounds.lower, bounds.upper)
    return np.full(m, float(values)) if values.ndim == 0 else values
