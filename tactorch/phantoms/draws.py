"""Random parts of phantoms: inclusions, backgrounds, moduli. Lengths in mm, moduli in MPa."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options
from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Rotated, Shape, Sphere, Torus
from tactorch.mesh.values import Real
from tactorch.phantoms.background import Background, Gradient, RandomField
from tactorch.phantoms.cubes import two_tiers
from tactorch.phantoms.overlap import clearance, protrusion

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
        c, half * rng.uniform(0.4, 0.9), half * rng.uniform(1.0, 2.0), draw_direction(rng)
    ),
    "ellipsoid": lambda rng, c, half: Rotated(
        Ellipsoid(c, half * rng.uniform(0.5, 1.0, 3)), rng.uniform(-90.0, 90.0, 3)
    ),
    "torus": lambda rng, c, half: Torus(c, 0.68 * half, 0.32 * half, draw_direction(rng)),
    "cone": lambda rng, c, half: Cone(c, 0.9 * half, 1.6 * half, draw_direction(rng)),
    "cake": lambda rng, c, half: two_tiers(c, 0.9 * half, 1.4 * half, draw_direction(rng)),
}


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


def draw_background(
    rng: Rng, name: str, youngs: float, side: float, center: Float[np.ndarray, "3"]
) -> Real | Background:
    """Draw a background of a name, median (MPa), size and centre (mm)."""
    if name == "uniform":
        return youngs
    if name == "gradient":
        half_span = draw_direction(rng) * side / 2
        start, end = (center - half_span).tolist(), (center + half_span).tolist()
        ratio = float(np.sqrt(rng.uniform(1.3, 2.5)))
        return Gradient(start, end, youngs / ratio, youngs * ratio)
    spread, length = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.2, 0.5)) * side
    return RandomField(youngs, spread, length, int(rng.integers(2**31)))


def draw_contrast(rng: Rng, limits: Range) -> float:
    """Draw a log-uniform ratio that differs from 1 by a quarter or more."""
    for _ in range(_MAX_DRAWS):
        ratio = log_uniform(rng, limits)
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


def draw_direction(rng: Rng) -> Float[np.ndarray, "3"]:
    """Draw a unit vector."""
    direction: np.ndarray = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def log_uniform(rng: Rng, limits: Range) -> float:
    """Draw a number whose logarithm is uniformly distributed."""
    low, high = (float(np.log(limit)) for limit in limits)
    return float(np.exp(rng.uniform(low, high)))
