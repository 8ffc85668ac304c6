"""Random plans of presses. Lengths in mm, pressures in MPa."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.simulation import PressPlan


@dataclass(frozen=True)
class PressDraw:
    """What plans of presses are drawn from.

    Attributes:
        faces: Sets of pressed sides, one of which is drawn.
        p_max_mpa: Range of the highest pressure, MPa.
        load: Range of the highest pressure over the object's median modulus, evenly drawn in its
            logarithm, as one presses soft objects more gently; it takes the place of `p_max_mpa`.
            None does not.
        steps: Numbers of equal steps up to it, one of which is drawn.
        patch_radius_mm: Range of the radius of the pressed patches; None presses whole sides.
        patches: Fewest and most patches on each side, at random places.
        patch_share: Share of the plans that press patches, where they have a radius; the others
            press whole sides.
        support: What holds the opposite side, see `PressPlan`.
        spring_n_per_mm: Stiffness of each spring.

    Raises:
        ConfigError: A value cannot be used.
    """

    faces: Sequence[Sequence[str]] = (("z+", "x+", "y+"),)
    p_max_mpa: Sequence[Real] = (0.02, 0.02)
    load: Sequence[Real] | None = None
    steps: Sequence[int] = (4,)
    patch_radius_mm: Sequence[Real] | None = None
    patches: Sequence[int] = (1, 1)
    patch_share: Real = 1.0
    support: Literal["springs", "fixed", "roller"] = "springs"
    spring_n_per_mm: float = 1.0

    def __post_init__(self) -> None:
        if not self.faces or not self.steps:
            raise ConfigError("faces and steps must each offer at least one choice.")
        _range("p_max_mpa", self.p_max_mpa)
        if self.load is not None:
            _range("load", self.load)
        if self.patch_radius_mm is not None:
            _range("patch_radius_mm", self.patch_radius_mm)
        if len(self.patches) != 2 or not 1 <= self.patches[0] <= self.patches[1]:
            raise ConfigError(
                f"patches={list(self.patches)}: give the fewest and the most, from 1."
            )
        if not 0.0 <= self.patch_share <= 1.0:
            raise ConfigError(f"patch_share={self.patch_share}: give a share, from 0 to 1.")
        support: dict[str, Any] = {"support": self.support, "spring_n_per_mm": self.spring_n_per_mm}
        for sides, steps in product(self.faces, self.steps):  # refuse what no draw could use
            PressPlan(
                p_max_mpa=float(self.p_max_mpa[0]), steps=steps, faces=tuple(sides), **support
            )

    def draw(
        self, rng: np.random.Generator, bounds: Float[np.ndarray, "2 3"], youngs_mpa: float
    ) -> PressPlan:
        """Draw a plan for an object of a bounding box, mm, and a median modulus, MPa."""
        sides = tuple(self.faces[int(rng.integers(len(self.faces)))])
        highest = self._highest(rng, youngs_mpa)
        steps = int(self.steps[int(rng.integers(len(self.steps)))])
        radius, centers = None, None
        if self.patch_radius_mm is not None and rng.random() < self.patch_share:
            radius = float(rng.uniform(*_range("patch_radius_mm", self.patch_radius_mm)))
            count = int(rng.integers(self.patches[0], self.patches[1] + 1))
            margin = np.minimum(radius, (bounds[1] - bounds[0]) / 2)
            centers = rng.uniform(bounds[0] + margin, bounds[1] - margin, (count, 3)).tolist()
        return PressPlan(
            p_max_mpa=highest,
            steps=steps,
            faces=sides,
            patch_radius_mm=radius,
            patch_centers_mm=centers,
            support=self.support,
            spring_n_per_mm=self.spring_n_per_mm,
        )

    def _highest(self, rng: np.random.Generator, youngs_mpa: float) -> float:
        if self.load is not None:
            return youngs_mpa * float(np.exp(rng.uniform(*np.log(_range("load", self.load)))))
        return float(rng.uniform(*_range("p_max_mpa", self.p_max_mpa)))


def _range(name: str, pair: Sequence[Real]) -> tuple[float, float]:
    if len(pair) != 2:
        raise ConfigError(f"{name}={list(pair)}: give the lower and the upper end of a range.")
    low, high = (positive(f"{name}[{i}]", value) for i, value in enumerate(pair))
    if high < low:
        raise ConfigError(f"{name}={list(pair)}: the upper end lies below the lower.")
    return low, high
