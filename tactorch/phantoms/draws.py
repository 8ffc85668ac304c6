"""Random parts of phantoms, and the settings that families of random phantoms share.

Lengths in mm, moduli in MPa.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Rotated, Shape, Sphere, Torus
from tactorch.mesh.values import Real
from tactorch.phantoms.background import Background, Gradient, RandomField
from tactorch.phantoms.cubes import two_tiers
from tactorch.phantoms.overlap import clearance, protrusion
from tactorch.phantoms.phantom import Phantom

Range = tuple[float, float]
Rng = np.random.Generator
Proposal = tuple[Shape, dict[str, Any]]  # a shape and its parameters
InclusionName = Literal["ball", "box", "cylinder", "ellipsoid", "torus", "cone", "cake"]
BackgroundName = Literal["uniform", "gradient", "random"]
_MAX_DRAWS = 200

#: Shapes of inclusions by name, from a generator, a centre and a half-width (mm).
INCLUSIONS: dict[str, Callable[[Rng, np.ndarray, float], Shape]] = {
    "ball": lambda rng, c, half: Sphere(c, half),
    "box": lambda rng, c, half: Rotated(
        Box(c, half * rng.uniform(1.0, 1.8, 3)), rng.uniform(-90.0, 90.0, 3)
    ),
    "cylinder": lambda rng, c, half: Cylinder(
        c, half * rng.uniform(0.4, 0.9), half * rng.uniform(1.0, 2.0), _draw_direction(rng)
    ),
    "ellipsoid": lambda rng, c, half: Rotated(
        Ellipsoid(c, half * rng.uniform(0.5, 1.0, 3)), rng.uniform(-90.0, 90.0, 3)
    ),
    "torus": lambda rng, c, half: Torus(c, 0.68 * half, 0.32 * half, _draw_direction(rng)),
    "cone": lambda rng, c, half: Cone(c, 0.9 * half, 1.6 * half, _draw_direction(rng)),
    "cake": lambda rng, c, half: two_tiers(c, 0.9 * half, 1.4 * half, _draw_direction(rng)),
}


@dataclass(frozen=True)
class RandomPhantom:
    """Random phantom, its class for recognition and its random parameters as plain values."""

    phantom: Phantom
    label: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RandomBody(Options, ABC):
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

    @abstractmethod
    def _body(self, rng: Rng) -> Proposal:
        """Draw the body, and its parameters as plain values."""

    def draw(self, rng: Rng) -> RandomPhantom:
        """Draw a phantom; inclusions without room are left out after the first.

        Raises:
            ConfigError: No inclusion fits; make `size` or `count` smaller.
            FileError: The body is of a file that cannot be read.
            MeshError: The surface of the file does not bound one body.
        """
        body, parameters = self._body(rng)
        low, high = body.bounds()
        youngs = _log_uniform(rng, self.youngs_mpa)
        count = int(rng.integers(self.count[0], self.count[1] + 1))
        names = [str(rng.choice(self.shapes)) for _ in range(count)]
        drawn = self._inclusions(rng, body, names, youngs)
        background, middle = str(rng.choice(self.backgrounds)), (low + high) / 2
        values = _draw_background(rng, background, youngs, float((high - low).max()), middle)
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
            modulus = youngs * _draw_contrast(rng, self.contrast)
            drawn.append((shape, {**facts, "inclusion_mpa": modulus}))
        return drawn


def draw_inside(
    body: Shape, propose: Callable[[], Proposal], others: Sequence[Shape] = (), gap: float = 0.0
) -> Proposal:
    """Draw until a shape is inside the body and clear of the others."""
    for _ in range(_MAX_DRAWS):
        shape, pose = propose()
        if protrusion(shape, body) <= 0.0 and all(clearance(shape, o) >= gap for o in others):
            return shape, pose
    raise ConfigError(
        f"No inclusion fits in {_MAX_DRAWS} draws; make size, shift or count smaller."
    )


def _draw_background(
    rng: Rng, name: str, youngs: float, side: float, center: Float[np.ndarray, "3"]
) -> Real | Background:
    """Draw a background of a name, median (MPa), size and centre (mm)."""
    if name == "uniform":
        return youngs
    if name == "gradient":
        half_span = _draw_direction(rng) * side / 2
        start, end = (center - half_span).tolist(), (center + half_span).tolist()
        ratio = float(np.sqrt(rng.uniform(1.3, 2.5)))
        return Gradient(start, end, youngs / ratio, youngs * ratio)
    spread, length = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.2, 0.5)) * side
    return RandomField(youngs, spread, length, int(rng.integers(2**31)))


def _draw_contrast(rng: Rng, limits: Range) -> float:
    """Draw a log-uniform ratio that differs from 1 by a quarter or more."""
    for _ in range(_MAX_DRAWS):
        ratio = _log_uniform(rng, limits)
        if abs(np.log(ratio)) >= np.log(1.25):
            return ratio
    raise ConfigError(f"contrast={list(limits)} contains nothing that differs from 1 by a quarter.")


def check_ranges(options: Options, *names: str) -> None:
    """Check that settings are pairs of a lower and an upper end, or None."""
    for name in names:
        pair = getattr(options, name)
        if pair is not None and pair[0] > pair[1]:
            setting = f"{options.section}.{name}={list(pair)}"
            raise ConfigError(f"{setting}: give the lower end first.")


def _draw_direction(rng: Rng) -> Float[np.ndarray, "3"]:
    """Draw a unit vector."""
    direction: np.ndarray = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _log_uniform(rng: Rng, limits: Range) -> float:
    """Draw a number whose logarithm is uniformly distributed."""
    low, high = (float(np.log(limit)) for limit in limits)
    return float(np.exp(rng.uniform(low, high)))
