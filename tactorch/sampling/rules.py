"""Where to press next: rules over what is known so far (Section V-C, and beyond it)."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.parameterization import Parameterization
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order
from tactorch.mesh.values import Real, positive
from tactorch.sampling.candidates import Patch
from tactorch.uncertainty.gaussian_state import GaussianState

_REACH = 2.0  # radii of the sensor: how far from its centre a patch's area goes


@dataclass(frozen=True, eq=False)
class SamplingState:
    """What is known after some presses.

    Attributes:
        mesh: The body.
        candidates: Places to press.
        pressed: Which of them were pressed, in turn.
        belief: Of the parameters (log-moduli by default), from all presses.
        parameterization: Makes moduli (MPa) of the parameters.
        credibility: Of each press: the square of the largest derivative of any datum (in standard
            deviations of its noise) by the parameter of an element of mean volume.
        jacobians: Foretells the derivatives of candidates' data, in standard deviations of the
            noise; None for a candidate under which the body would collapse.
    """

    mesh: TetMesh
    candidates: Sequence[Patch]
    pressed: tuple[int, ...]
    belief: GaussianState
    parameterization: Parameterization
    credibility: Float[np.ndarray, "presses m"]
    jacobians: Callable[[Sequence[int]], list[np.ndarray | None]]

    @property
    def left(self) -> list[int]:
        """Candidates that were not pressed."""
        return _left(len(self.candidates), self.pressed)


@runtime_checkable
class Rule(Protocol):
    """Chooses places to press."""

    def first(self, candidates: Sequence[Patch]) -> int:
        """Return the candidate to press before anything is known."""
        ...

    def choose(self, now: SamplingState) -> int:
        """Return the candidate to press next, one that was not pressed."""
        ...


class _FromTheTop:
    """Begins with the first candidate: `candidate_patches` puts it farthest from what is held."""

    def first(self, candidates: Sequence[Patch]) -> int:
        """See `Rule.first`."""
        return 0


@dataclass(frozen=True)
class LargestUncertainty(_FromTheTop):
    """The paper's rule: press the area of largest uncertainty under eq. (16).

    Sigma* and R are diagonal there, so the precisions of an element add up: that of the prior, and
    its credibility under each press. The paper says of the place no more than that it is found "by
    projecting onto the area with the maximum uncertainty". Here each element belongs to the
    candidate nearest to its centroid, within two radii of the sensor; the next press is the
    candidate whose elements have the largest mean variance, by volume.

    Attributes:
        prior_deviation: Of each parameter before any press.
    """

    prior_deviation: Real = 1.0

    def __post_init__(self) -> None:
        positive("prior_deviation", self.prior_deviation)

    def choose(self, now: SamplingState) -> int:
        """See `Rule.choose`."""
        variance = 1.0 / (self.prior_deviation**-2 + now.credibility.sum(axis=0))
        means = area_means(now.mesh, now.candidates, variance)
        return max(now.left, key=lambda i: means[i])


class _Foretelling(_FromTheTop, ABC):
    """Foretells each candidate's data, and takes the one that scores best."""

    def choose(self, now: SamplingState) -> int:
        """See `Rule.choose`."""
        found = zip(now.left, now.jacobians(now.left), strict=True)
        scores = {i: self.score(now, rows) for i, rows in found if rows is not None}
        return max(scores, key=lambda i: scores[i]) if scores else now.left[0]

    @abstractmethod
    def score(self, now: SamplingState, jacobian: Float[np.ndarray, "data m"]) -> float:
        """Return how much a press with this Jacobian is worth."""


@dataclass(frozen=True)
class ExpectedInformation(_Foretelling):
    """Press where the data are expected to tell most: log det(I + J Sigma J^T) / 2."""

    def score(self, now: SamplingState, jacobian: Float[np.ndarray, "data m"]) -> float:
        """Return the expected information, in nats."""
        return now.belief.information_gain(jacobian)


@dataclass(frozen=True)
class ExpectedError(_Foretelling):
    """Press where the mean squared error of the map, by volume, is expected to fall most.

    Of the moduli, a press is worth most where something stiff was found that is not yet sharp; of
    the parameters (log-moduli by default), everything counts alike.

    Attributes:
        of: "youngs" or "parameters".
    """

    of: str = "youngs"

    def __post_init__(self) -> None:
        if self.of not in ("youngs", "parameters"):
            raise ConfigError(f"of={self.of} is unknown; choose youngs or parameters.")

    def score(self, now: SamplingState, jacobian: Float[np.ndarray, "data m"]) -> float:
        """Return the fall of the mean variance by volume."""
        fall = now.belief.expected_variance_reduction(jacobian)
        if self.of == "youngs":
            before = now.belief.covariance.diagonal()
            fall = now.parameterization.expected_variance_reduction(
                now.belief.mean, before, before - fall
            )
        return float(fall @ now.mesh.volumes / now.mesh.volumes.sum())


@dataclass(frozen=True)
class UniformGrid:
    """A grid over the candidates for the whole budget, laid out before the first press.

    It begins with farthest points and evens them out (Lloyd's k-medoids): each place moves to the
    middle of the candidates that are nearest to it.

    Attributes:
        budget: How many places.
    """

    budget: int

    def places(self, candidates: Sequence[Patch]) -> list[int]:
        """Return the grid in farthest-point order.

        Raises:
            ConfigError: there are fewer candidates than places.
        """
        if not 1 <= self.budget <= len(candidates):
            raise ConfigError(
                f"budget={self.budget}: a grid takes 1 to {len(candidates)} places, as many as "
                "there are candidates."
            )
        centers = np.array([patch.center for patch in candidates])
        gaps = np.linalg.norm(centers[:, None] - centers, axis=2)
        places = farthest_point_order(centers, self.budget, 0)
        for _ in range(len(gaps)):
            owner = gaps[:, places].argmin(axis=1)
            groups = [np.flatnonzero(owner == k) for k in range(self.budget)]
            moved = [
                int(g[(gaps[np.ix_(g, g)] ** 2).sum(axis=1).argmin()]) if len(g) else place
                for g, place in zip(groups, places, strict=True)
            ]
            if moved == places:
                break
            places = moved
        first = int(gaps[0, places].argmin())
        return [places[i] for i in farthest_point_order(centers[places], self.budget, first)]

    def first(self, candidates: Sequence[Patch]) -> int:
        """See `Rule.first`."""
        return self.places(candidates)[0]

    def choose(self, now: SamplingState) -> int:
        """See `Rule.choose`.

        Raises:
            ConfigError: all places of the grid were pressed.
        """
        if len(now.pressed) >= self.budget:
            raise ConfigError(
                f"budget={self.budget}: all places of the uniform grid were pressed; give it as "
                "large a budget as the sampling has."
            )
        return self.places(now.candidates)[len(now.pressed)]


@dataclass(frozen=True)
class Random:
    """Any candidate, as the seed says.

    Attributes:
        seed: Of the order.
    """

    seed: int = 0

    def first(self, candidates: Sequence[Patch]) -> int:
        """See `Rule.first`."""
        return self._draw(len(candidates), ())

    def choose(self, now: SamplingState) -> int:
        """See `Rule.choose`."""
        return self._draw(len(now.candidates), now.pressed)

    def _draw(self, count: int, pressed: tuple[int, ...]) -> int:
        rng = np.random.default_rng([self.seed, len(pressed)])
        return int(rng.choice(_left(count, pressed)))


def area_means(
    mesh: TetMesh, candidates: Sequence[Patch], values: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " candidates"]:
    """Return the mean of each candidate's elements by volume; 0 where it has none.

    An element belongs to the candidate nearest to its centroid, if within two radii of the sensor.
    """
    centers = np.array([patch.center for patch in candidates])
    gaps = np.linalg.norm(mesh.centroids[:, None] - centers, axis=2)
    owner = gaps.argmin(axis=1)
    reach = _REACH * np.array([patch.radius_mm for patch in candidates])
    share = np.where(gaps.min(axis=1) <= reach[owner], mesh.volumes, 0.0)
    total = np.bincount(owner, share, minlength=len(candidates))
    return np.bincount(owner, share * values, minlength=len(candidates)) / np.maximum(total, 1e-300)


def _left(count: int, pressed: tuple[int, ...]) -> list[int]:
    return [i for i in range(count) if i not in set(pressed)]
