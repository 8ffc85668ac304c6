"""Settings that families of random phantoms share: inclusions and background of a body.

Lengths in mm, moduli in MPa.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, get_args

import numpy as np

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh import Shape
from tactorch.phantoms.draws import (
    INCLUSIONS,
    BackgroundName,
    InclusionName,
    Proposal,
    Range,
    Rng,
    check_ranges,
    draw_background,
    draw_contrast,
    draw_inside,
    log_uniform,
)
from tactorch.phantoms.phantom import Phantom


@dataclass(frozen=True)
class RandomPhantom:
    """Random phantom, its class for recognition and its random parameters as plain values."""

    phantom: Phantom
    label: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RandomBody(Options):
    """Settings of a body with random inclusions in a random background."""

    section = "family"
    count: tuple[int, int] = option((0, 3), "Range of the number of inclusions", ge=0)
    shapes: tuple[InclusionName, ...] = option(
        get_args(InclusionName), "Shapes of the inclusions; repeat a name to make it more likely",
        nonempty=True,
    )  # fmt: skip
    size: Range = option(
        (0.12, 0.25), "Range of the inclusions' half-widths, in the smallest width of the body",
        gt=0,
    )  # fmt: skip
    youngs_mpa: Range = option(
        (0.05, 0.3), "Range of the background's median modulus, log-uniform", unit="MPa", gt=0
    )
    contrast: Range = option(
        (0.2, 8.0), "Range of the ratio of an inclusion's modulus to the background's, log-uniform;"
        " ratios within a quarter of 1 are excluded", gt=0,
    )  # fmt: skip
    backgrounds: tuple[BackgroundName, ...] = option(
        ("uniform", "uniform", "gradient", "random"),
        "Backgrounds; repeat a name to make it more likely", nonempty=True,
    )  # fmt: skip
    gap: float = option(
        0.03, "Minimum distance between inclusions, in the smallest width of the body", ge=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "count", "size", "youngs_mpa", "contrast")

    def _filled(self, rng: Rng, body: Shape, parameters: dict[str, Any]) -> RandomPhantom:
        """Draw the inside of a body; inclusions without room are left out after the first."""
        low, high = body.bounds()
        youngs = log_uniform(rng, self.youngs_mpa)
        count = int(rng.integers(self.count[0], self.count[1] + 1))
        names = [str(rng.choice(self.shapes)) for _ in range(count)]
        drawn = self._inclusions(rng, body, names, youngs)
        background, middle = str(rng.choice(self.backgrounds)), (low + high) / 2
        values = draw_background(rng, background, youngs, float((high - low).max()), middle)
        parts = [facts for _, facts in drawn]
        facts = {"background": background, "youngs_mpa": youngs, "parts": parts}
        phantom = Phantom(body, [(shape, part["inclusion_mpa"]) for shape, part in drawn], values)
        return RandomPhantom(phantom, str(len(drawn)), parameters | facts)

    def _inclusions(
        self, rng: Rng, body: Shape, names: Sequence[str], youngs: float
    ) -> list[Proposal]:
        """Draw inclusions of given shapes, and their parameters as plain values."""
        low, high = body.bounds()
        width = float((high - low).min())

        def propose(name: str) -> Proposal:
            half = float(rng.uniform(*self.size)) * width
            margin = np.minimum(half, (high - low) / 2)
            center = rng.uniform(low + margin, high - margin)
            facts = {"shape": name, "half_mm": half, "center_mm": center.tolist()}
            return INCLUSIONS[name](rng, center, half), facts

        drawn: list[Proposal] = []
        for name in names:
            others = [shape for shape, _ in drawn]
            try:
                shape, facts = draw_inside(body, partial(propose, name), others, self.gap * width)
            except ConfigError:
                if not drawn:
                    raise
                break
            modulus = youngs * draw_contrast(rng, self.contrast)
            drawn.append((shape, {**facts, "inclusion_mpa": modulus}))
        return drawn
