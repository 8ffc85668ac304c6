"""Starts of an inversion: uniform, of few moduli, of regions, of random draws, or a given map.

A start is a function of the inverse problem and the bounds, as is a learned one.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import laplacian
from scipy.spatial import cKDTree

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse.data.nuisance import Nuisance, NuisancePrior
from tactorch.inverse.fields import ElementField
from tactorch.inverse.fields.parameterization import Bounds, Log
from tactorch.inverse.fields.regularization.base import Field, Quadratic, region_values
from tactorch.inverse.fit.monitor import Monitor, StopCondition, StopOptimization, StopReason
from tactorch.inverse.fit.objective import Objective
from tactorch.inverse.fit.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order

START_MPA = 0.2
_BOUND_RTOL = 1e-9  # relative excess over a bound that counts as rounding
_STEP_TOLERANCE = 1e-3  # change of the log-modulus, or of z
_STIFFENING = 4.0  # factor to try where the object collapses, or seems much stiffer than START_MPA
_NO_TOLERANCE = 1e-15  # of the objective: the size of the step alone ends the optimization
_OPTIMIZER = GaussNewton(max_iterations=30, tolerance=_NO_TOLERANCE, max_trials=8)
# Of the clusters of a coarse start: rounds of Lloyd's method, expected difference of log-modulus
# between neighbours, and change of a log-modulus that ends the optimization.
_LLOYD_ROUNDS, _JUMP, _COARSE_STEP_TOLERANCE = 10, 0.5, 0.02
Start: TypeAlias = float | np.ndarray | Callable[[InverseProblem, Bounds], np.ndarray]

#: Settings of the starts by name; each is a function of the problem and the bounds.
INITIALIZATIONS = Registry(
    "initialization",
    {
        "uniform": "tactorch.inverse.fit.starts:Uniform",
        "coarse": "tactorch.inverse.fit.starts:CoarseStart",
        "regions": "tactorch.inverse.fit.starts:RegionStart",
        "surrogate": "tactorch.learning.surrogate:SurrogateStart",
    },
)


@dataclass(frozen=True)
class Uniform(Options):
    """One modulus for all elements."""

    section: ClassVar[str] = "initialization"
    start_mpa: float | Literal["homogeneous"] = option(
        START_MPA, "Modulus of the start; homogeneous: the one that fits best", unit="MPa", gt=0
    )

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Field:
        """Return the map, MPa."""
        if isinstance(self.start_mpa, str):
            return homogeneous(problem, bounds)
        return np.full(problem.n_elements, self.start_mpa)


class UniformFit(NamedTuple):
    """The uniform modulus and the nuisance values that fit best together."""

    youngs_mpa: float
    nuisance: Nuisance


def uniform_fit(
    problem: InverseProblem,
    bounds: Bounds | None = None,
    nuisance: NuisancePrior | None = None,
    *,
    first_mpa: float | None = None,
) -> UniformFit:
    """Find the uniform modulus, and the nuisance parameters, that fit best.

    Damped Gauss-Newton on the log-modulus and z, from a stiffer start where a press has no
    equilibrium. The first start is `first_mpa`; by default 0.2 MPa, or the ratio of mean stress and
    strain under the presses where that is much larger.
    """
    bounds = bounds or Bounds()
    prior, groups = Quadratic(sp.csr_matrix((1, 1))), np.zeros(problem.n_elements, dtype=np.int64)
    field = ElementField(Log(bounds), prior, problem.n_elements, groups)
    objective = Objective(problem, field, nuisance or NuisancePrior(), 0.0, stable_only=True)
    first = _first_mpa(problem) if first_mpa is None else first_mpa
    x, upper = np.zeros(objective.size), np.log(bounds.upper)
    x[0] = np.clip(np.log(first), np.log(bounds.lower), upper)
    while True:
        monitor = Monitor(stop_condition=_stop_condition(_STEP_TOLERANCE), log=False)
        try:
            _OPTIMIZER.minimize(objective, x, monitor)
        except StopOptimization:
            pass
        except ConvergenceError as error:
            if monitor.point is None and x[0] >= upper:
                raise ConvergenceError(
                    f"With no uniform modulus up to {bounds.upper:g} MPa do all presses have an "
                    "equilibrium; check the units of the forces (N)."
                ) from error
        if (point := monitor.point) is not None:
            return UniformFit(float(point.youngs[0]), point.evaluation.nuisance)
        x[0] = min(x[0] + np.log(_STIFFENING), upper)


def _stop_condition(tolerance: float, fitted_chi2: float = 0.0) -> StopCondition:
    """Stop at a misfit, or after a step whose largest change is below a tolerance."""

    def stop_condition(history: list[dict[str, float]]) -> StopReason | None:
        if history[-1]["chi2"] <= fitted_chi2:
            return StopReason.FITTED
        small = len(history) > 1 and history[-1]["step"] < tolerance
        return StopReason.CONVERGED if small else None

    return stop_condition


def _first_mpa(problem: InverseProblem) -> float:
    """First modulus, MPa: a much too soft body would collapse, which takes long to detect."""
    mesh, estimates = problem.recording.mesh, []
    if any(p.probe is not None and p.force is not None for p in problem.recording.presses):
        return problem.contact_mpa
    for press in problem.recording.presses:
        total = press.forces.sum(axis=0)
        force = float(np.linalg.norm(total))
        contact = np.any(press.forces != 0, axis=1)
        area = float(mesh.surface.areas[contact[mesh.surface.triangles].all(axis=1)].sum())
        observed = press.observed.all(axis=1) & contact
        if force == 0.0 or area == 0.0 or not observed.any():
            continue
        inward = total / force
        depth = float((press.displacement[observed] @ inward).mean())
        if depth > 0.0:  # pressure over displacement of the contact relative to the body's length
            estimates.append(force / area * float(np.ptp(mesh.points @ inward)) / depth)
    guess = float(np.median(estimates)) if estimates else START_MPA
    return guess if guess > _STIFFENING * START_MPA else START_MPA


def clusters(mesh: TetMesh, count: int) -> Int[np.ndarray, " m"]:
    """Group elements into compact clusters, numbered from 0, by Lloyd's method on their centroids.

    The method is deterministic: the first centres are far from each other, and no cluster is empty.
    """
    if not 1 <= count <= mesh.n_tets:
        raise ConfigError(f"groups={count} must be from 1 to the {mesh.n_tets} elements.")
    centroids, volumes = mesh.centroids, mesh.volumes
    middle = np.linalg.norm(centroids - centroids.mean(axis=0), axis=1).argmin()
    centres = centroids[farthest_point_order(centroids, count, int(middle))]
    labels = cKDTree(centres).query(centroids)[1]
    for _ in range(_LLOYD_ROUNDS):
        mass = np.bincount(labels, volumes, minlength=count)
        moments = [np.bincount(labels, volumes * x, minlength=count) for x in centroids.T]
        filled = mass > 0
        centres[filled] = (np.array(moments)[:, filled] / mass[filled]).T
        labels = cKDTree(centres).query(centroids)[1]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True)
class CoarseStart(Options):
    """The map of few moduli that fits best, each shared by a cluster of elements.

    The sensitivity matrix has one column per cluster, at one solve per press, so Gauss-Newton is
    cheap and recovers large features only; as in multilevel inversion (Liu, 1993).
    """

    section: ClassVar[str] = "initialization"
    groups: int = option(64, "Number of clusters of elements", gt=0)
    steps: int = option(6, "Limit of Gauss-Newton steps", gt=0)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Field:
        """Return the map, MPa."""
        labels = clusters(problem.recording.mesh, self.groups)
        return fit_groups(problem, bounds, labels, steps=self.steps)


@dataclass(frozen=True)
class RegionStart(Options):
    """One modulus for each region of the mesh: given, or those that fit best."""

    section: ClassVar[str] = "initialization"
    region_mpa: dict[int, float] | None = option(
        None, "Modulus of each region by number; null: those that fit best", unit="MPa", gt=0
    )
    steps: int = option(10, "Limit of Gauss-Newton steps of the fit", gt=0)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Field:
        """Return the map, MPa.

        Raises:
            ConfigError: The mesh has no regions, or a region has no modulus.
            ConvergenceError: The presses have an equilibrium with no uniform modulus.
        """
        mesh = problem.recording.mesh
        if self.region_mpa:
            return region_values(self.region_mpa, mesh, "initialization.region_mpa")
        if mesh.regions is None:
            raise ConfigError(
                "initialization=regions: the mesh of the recording has no regions; make it with "
                "tactorch body, or choose another initialization."
            )
        labels = np.unique(mesh.regions, return_inverse=True)[1].astype(np.int64)
        return fit_groups(problem, bounds, labels, steps=self.steps)


def fit_groups(
    problem: InverseProblem, bounds: Bounds, labels: Int[np.ndarray, " m"], *, steps: int
) -> Field:
    """Return the map of one modulus for each group of elements that fits best, MPa.

    Groups that share faces are expected to have similar moduli; this decides where the presses
    do not. Labels are the group of each element, numbered from 0 without gaps; `steps` is the limit
    of Gauss-Newton steps.
    """
    mesh = problem.recording.mesh
    # The prior's matrix is the Laplacian of the graph of groups that share a face.
    ends = np.sort(labels[mesh.adjacency.pairs], axis=1)
    i, j = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0).T
    count = int(labels.max()) + 1
    graph = sp.csr_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    prior = Quadratic(laplacian(graph + graph.T).tocsr() / _JUMP**2)
    field = ElementField(Log(bounds), prior, mesh.n_tets, labels)
    objective = Objective(problem, field, weight=1.0)
    stop_condition = _stop_condition(_COARSE_STEP_TOLERANCE, fitted_chi2=1.0)
    monitor = Monitor(stop_condition=stop_condition, log=False)
    first = np.log(uniform_fit(problem, bounds).youngs_mpa)
    optimizer = GaussNewton(max_iterations=steps, tolerance=_NO_TOLERANCE)
    with suppress(StopOptimization):
        optimizer.minimize(objective, np.full(objective.size, first), monitor)
    assert monitor.point is not None
    return monitor.point.youngs


def best_uniform(
    problem: InverseProblem, bounds: Bounds | None = None, *, first_mpa: float | None = None
) -> float:
    """Return the modulus that fits best where all elements have the same, MPa.

    Raises:
        ConvergenceError: with no modulus within the bounds do all presses have an equilibrium.
    """
    return uniform_fit(problem, bounds, first_mpa=first_mpa).youngs_mpa


def homogeneous(problem: InverseProblem, bounds: Bounds) -> Field:
    """Return the best uniform map, MPa, fitted together with the nuisance parameters."""
    fit = uniform_fit(problem, bounds, problem.nuisance)
    return np.full(problem.n_elements, fit.youngs_mpa)


def monte_carlo(
    draw: Callable[[np.random.Generator], np.ndarray], *, draws: int = 16, seed: int = 0
) -> Callable[[InverseProblem, Bounds], np.ndarray]:
    """Return a start that draws maps and takes the one that fits best.

    Draws without an equilibrium are skipped.

    Args:
        draw: Draws a map, MPa, such as `sample` of a prior.
        draws: Number of maps.
        seed: Seed of the draws; each has a separate generator.
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
                f"None of {draws} random starts has an equilibrium under all presses; draw stiffer "
                "maps."
            )
        return drawn[best]

    return start


def start_map(start: Start, problem: InverseProblem, bounds: Bounds) -> Field:
    """Return the map of a start, MPa; refuse a wrong shape and moduli outside the bounds."""
    values = start(problem, bounds) if callable(start) else start
    return checked_start(values, problem.n_elements, bounds)


def checked_start(youngs_mpa: float | Float[np.ndarray, " _"], m: int, bounds: Bounds) -> Field:
    """Return the modulus of each of m elements; refuse a wrong shape and values out of bounds."""
    values = np.asarray(youngs_mpa, dtype=np.float64)
    if values.ndim and values.shape != (m,):
        raise ConfigError(f"start_mpa has shape {values.shape}; expected one modulus or ({m},).")
    low, high = bounds.lower * (1 - _BOUND_RTOL), bounds.upper * (1 + _BOUND_RTOL)
    if not np.all((values >= low) & (values <= high)):
        raise ConfigError(
            f"start_mpa spans {values.min():g} to {values.max():g} MPa, outside the bounds "
            f"[{bounds.lower:g}, {bounds.upper:g}] MPa; start inside, or widen them."
        )
    return np.full(m, np.clip(values, bounds.lower, bounds.upper))
