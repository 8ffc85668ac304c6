"""Rules that choose the next press from the posterior so far (Section V-C, and beyond it).

A rule is an `Options` class with `choose`, listed in `RULES` by name. Packages add rules by an
entry point of the group `tactorch.rule`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError
from tactorch.inverse import Parameterization, ShapeReconstruction
from tactorch.inverse.posterior.gaussian_state import GaussianState
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order
from tactorch.recording import Recording
from tactorch.simulation.curved import Patch

_HERE = "tactorch.sampling.rules"
RULES = Registry(
    "rule",
    {
        "auto": f"{_HERE}:Automatic",
        "expected_error": f"{_HERE}:ExpectedError",
        "shape_error": "tactorch.sampling.shape_design:ExpectedShapeError",
        "lump_position": "tactorch.sampling.shape_design:LumpPosition",
        "expected_information": f"{_HERE}:ExpectedInformation",
        "largest_uncertainty": f"{_HERE}:LargestUncertainty",
        "uniform_grid": f"{_HERE}:UniformGrid",
        "random": f"{_HERE}:Random",
        "none": f"{_HERE}:NoSuggestion",
    },
)
#: Derivatives of a press's data by the parameters, in standard deviations of the noise.
Jacobian: TypeAlias = Float[np.ndarray, "data m"]

MAX_DENSE_ELEMENTS = 4_000  # elements up to which a dense posterior takes seconds
_AREA_RADII = 2.0  # radius of a patch's area over that of the sensor


@dataclass(frozen=True, eq=False)
class SamplingState:
    """What a rule knows after some presses.

    Attributes:
        mesh: Mesh of the inversion.
        candidates: Patches that can be pressed.
        pressed: Indices of the candidates pressed so far, in order.
        parameterization: Map from parameters to moduli (MPa).
        credibility: For each press, the squared largest derivative of any datum (in standard
            deviations of its noise) by the parameter of an element of mean volume.
        jacobians: Predicts the Jacobians of candidates, in standard deviations of the noise; None
            for a candidate under which the body collapses.
        posterior: Normal distribution of the parameters (log-moduli by default) given all presses;
            None for rules without `uses_posterior`.
        known: Jacobian of the presses so far.
        per_log: Derivative of each parameter by the logarithm of its element's modulus.
        shapes: Shapes that were fitted to the presses so far, or to the first of them; None if
            there are none.
    """

    mesh: TetMesh
    candidates: Sequence[Patch]
    pressed: tuple[int, ...]
    parameterization: Parameterization
    credibility: Float[np.ndarray, "presses m"]
    jacobians: Callable[[Sequence[int]], list[Jacobian | None]]
    posterior: GaussianState | None = None
    known: Jacobian | None = None
    per_log: Float[np.ndarray, " m"] | None = None
    shapes: ShapeReconstruction | None = None

    @property
    def remaining(self) -> list[int]:
        """Indices of the candidates that were not pressed."""
        return [i for i in range(len(self.candidates)) if i not in self.pressed]


class Rule(Options, ABC):
    """Criterion for the next press.

    Attributes:
        uses_posterior: Whether `choose` reads `SamplingState.posterior`, a dense covariance.
        uses_shapes: Whether it depends on the shapes that were fitted to the presses.
    """

    section = "rule"
    uses_posterior: ClassVar[bool] = False
    uses_shapes: ClassVar[bool] = False

    def resolve(self, recording: Recording) -> "Rule":
        """Return the rule to apply to this object and its presses so far."""
        return self

    def first(self, candidates: Sequence[Patch]) -> int:
        """Return the candidate to press before any data.

        `candidate_patches` lists the one farthest from the fixed nodes first.
        """
        return 0

    @abstractmethod
    def choose(self, state: SamplingState) -> int:
        """Return the candidate to press next, one that was not pressed."""


@dataclass(frozen=True)
class Automatic(Rule):
    """Expected error up to 4,000 elements if forces are known; otherwise largest uncertainty."""

    def resolve(self, recording: Recording) -> Rule:
        loaded = any(press.forces.any() for press in recording.presses)
        dense = recording.mesh.n_tets <= MAX_DENSE_ELEMENTS
        return ExpectedError() if dense and loaded else LargestUncertainty()

    def choose(self, state: SamplingState) -> int:
        return (LargestUncertainty() if state.posterior is None else ExpectedError()).choose(state)


@dataclass(frozen=True)
class NoSuggestion(Rule):
    """No suggestion of the next press."""

    def resolve(self, recording: Recording) -> Rule:
        raise ConfigError("suggestions are off (suggest.rule=none)")

    def choose(self, state: SamplingState) -> int:
        raise ConfigError("suggestions are off (suggest.rule=none)")


@dataclass(frozen=True)
class LargestUncertainty(Rule):
    """The paper's rule: the area of largest uncertainty under eq. (16).

    Sigma* and R are diagonal there, so the precisions of an element add up: that of the prior, and
    its credibility under each press. The paper finds the place "by projecting onto the area with
    the maximum uncertainty". Here each element belongs to the candidate nearest to its centroid,
    within two radii of the sensor; the next press is the candidate whose elements have the largest
    volume-weighted mean variance.
    """

    prior_deviation: float = option(1.0, "Standard deviation of each parameter before data", gt=0)

    def choose(self, state: SamplingState) -> int:
        variance = 1.0 / (self.prior_deviation**-2 + state.credibility.sum(axis=0))
        means = area_means(state.mesh, state.candidates, variance)
        return max(state.remaining, key=lambda i: means[i])


class ScoredRule(Rule):
    """Rule that scores each candidate by its predicted Jacobian and takes the best."""

    uses_posterior = True

    def choose(self, state: SamplingState) -> int:
        posterior, remaining = state.posterior, state.remaining
        assert posterior is not None
        predicted = zip(remaining, state.jacobians(remaining), strict=True)
        scores = {i: self.score(state, posterior, j) for i, j in predicted if j is not None}
        return max(scores, key=lambda i: scores[i]) if scores else remaining[0]

    @abstractmethod
    def score(self, state: SamplingState, posterior: GaussianState, jacobian: Jacobian) -> float:
        """Return the value of a press with this Jacobian."""


@dataclass(frozen=True)
class ExpectedInformation(ScoredRule):
    """Largest expected information of the data, log det(I + J Sigma J^T) / 2, in nats."""

    def score(self, state: SamplingState, posterior: GaussianState, jacobian: Jacobian) -> float:
        return posterior.information_gain(jacobian)


@dataclass(frozen=True)
class ExpectedError(ScoredRule):
    """Largest expected reduction of the map's volume-weighted mean squared error.

    Measured on the moduli, presses near stiff regions of uncertain extent score highest; measured
    on the parameters (log-moduli by default), all regions count alike.
    """

    of: Literal["youngs", "parameters"] = option("youngs", "Quantity whose error is reduced")

    def score(self, state: SamplingState, posterior: GaussianState, jacobian: Jacobian) -> float:
        reduction = posterior.expected_variance_reduction(jacobian)
        if self.of == "youngs":
            variance = posterior.covariance.diagonal()
            reduction = state.parameterization.expected_variance_reduction(
                posterior.mean, variance, variance - reduction
            )
        return float(reduction @ state.mesh.volumes / state.mesh.volumes.sum())


@dataclass(frozen=True)
class UniformGrid(Rule):
    """Even grid over the candidates for the whole budget, fixed before the first press.

    Farthest points are evened out by Lloyd's algorithm (k-medoids).
    """

    budget: int = option(help="Number of presses", ge=1)

    def places(self, candidates: Sequence[Patch]) -> list[int]:
        """Return the grid in farthest-point order."""
        if self.budget > len(candidates):
            raise ConfigError(
                f"budget={self.budget}: a grid takes 1 to {len(candidates)} places, as many as "
                "there are candidates."
            )
        centers = np.array([patch.center for patch in candidates])
        distances = np.linalg.norm(centers[:, None] - centers, axis=2)
        places = farthest_point_order(centers, self.budget, 0)
        for _ in range(len(distances)):
            nearest = distances[:, places].argmin(axis=1)
            groups = [np.flatnonzero(nearest == k) for k in range(self.budget)]
            medoids = [
                int(g[(distances[np.ix_(g, g)] ** 2).sum(axis=1).argmin()]) if len(g) else place
                for g, place in zip(groups, places, strict=True)
            ]
            if medoids == places:
                break
            places = medoids
        first = int(distances[0, places].argmin())
        return [places[i] for i in farthest_point_order(centers[places], self.budget, first)]

    def first(self, candidates: Sequence[Patch]) -> int:
        return self.places(candidates)[0]

    def choose(self, state: SamplingState) -> int:
        if len(state.pressed) >= self.budget:
            raise ConfigError(
                f"budget={self.budget}: all places of the uniform grid were pressed; set its "
                "budget to that of the sampling."
            )
        return self.places(state.candidates)[len(state.pressed)]


@dataclass(frozen=True)
class Random(Rule):
    """Random candidate."""

    seed: int = option(0, "Seed of the order", ge=0)

    def first(self, candidates: Sequence[Patch]) -> int:
        return self._draw(range(len(candidates)), 0)

    def choose(self, state: SamplingState) -> int:
        return self._draw(state.remaining, len(state.pressed))

    def _draw(self, remaining: Sequence[int], pressed: int) -> int:
        return int(np.random.default_rng([self.seed, pressed]).choice(remaining))


def area_means(
    mesh: TetMesh, candidates: Sequence[Patch], values: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " candidates"]:
    """Return the volume-weighted mean over each candidate's elements; 0 where it has none.

    An element belongs to the candidate nearest to its centroid, if within two radii of the sensor.
    """
    centers = np.array([patch.center for patch in candidates])
    distances = np.linalg.norm(mesh.centroids[:, None] - centers, axis=2)
    nearest = distances.argmin(axis=1)
    radii = _AREA_RADII * np.array([patch.radius_mm for patch in candidates])
    volumes = np.where(distances.min(axis=1) <= radii[nearest], mesh.volumes, 0.0)
    total = np.bincount(nearest, volumes, minlength=len(candidates))
    sums = np.bincount(nearest, volumes * values, minlength=len(candidates))
    return sums / np.maximum(total, 1e-300)
