"""Random plans of presses. Lengths in mm, pressures in MPa."""

from dataclasses import dataclass
from itertools import product
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.simulation import PressPlan

Range = tuple[float, float]


@dataclass(frozen=True)
class PressDraw(Options):
    """Distribution of plans of presses.

    A pressure of `load` follows the object's stiffness, as a person presses soft objects more
    gently; its logarithm is uniformly distributed.
    """

    section: ClassVar[str] = "dataset.presses"
    faces: tuple[tuple[str, ...], ...] = option(
        (("z+", "x+", "y+"),), "Sets of pressed faces, one of which is drawn"
    )
    p_max_mpa: Range = option((0.02, 0.02), "Range of the highest pressure", unit="MPa", gt=0)
    load: Range | None = option(
        None, "Range of the highest pressure over the median modulus, in place of p_max_mpa", gt=0
    )
    steps: tuple[int, ...] = option((4,), "Numbers of load steps, one of which is drawn", ge=1)
    patch_radius_mm: Range | None = option(
        None, "Range of the radius of pressed patches; null: whole faces", unit="mm", gt=0
    )
    patches: tuple[int, int] = option((1, 1), "Fewest and most patches on each face", ge=1)
    patch_share: float = option(
        1.0, "Share of the plans that press patches; the others press whole faces", ge=0, le=1
    )
    support: Literal["springs", "fixed", "roller"] = option(
        "springs", "Support of the opposite face"
    )
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.faces or not self.steps:
            raise ConfigError("dataset.presses: faces and steps need at least one choice each.")
        for name in ("p_max_mpa", "load", "patch_radius_mm", "patches"):
            pair = getattr(self, name)
            if pair is not None and pair[0] > pair[1]:
                raise ConfigError(f"dataset.presses.{name}={list(pair)}: give the lower end first.")
        for sides, steps in product(self.faces, self.steps):  # refuse plans that cannot be made
            PressPlan(
                p_max_mpa=self.p_max_mpa[0],
                steps=steps,
                faces=sides,
                support=self.support,
                spring_n_per_mm=self.spring_n_per_mm,
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
            radius = float(rng.uniform(*self.patch_radius_mm))
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
            return youngs_mpa * float(np.exp(rng.uniform(*np.log(self.load))))
        return float(rng.uniform(*self.p_max_mpa))
