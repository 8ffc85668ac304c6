"""Families of random phantoms; the same state of the generator gives the same phantom.

Lengths in mm, moduli in MPa; positions and sizes of inclusions in sides of the cube.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Rotated, Shape, Sphere, Torus
from tactorch.mesh.values import Real
from tactorch.phantoms.background import Background, Gradient, RandomField
from tactorch.phantoms.cubes import cube_body, two_tiers
from tactorch.phantoms.overlap import clearance, protrusion
from tactorch.phantoms.phantom import Phantom

Range = tuple[float, float]
Rng = np.random.Generator
Proposal = tuple[Shape, dict[str, Any]]  # a shape and its parameters
_MAX_DRAWS = 200
_Inclusion = Literal["ball", "box", "cylinder", "ellipsoid", "torus", "cone", "cake"]


@dataclass(frozen=True)
class RandomPhantom:
    """Random phantom, its class for recognition and its random parameters as plain values."""

    phantom: Phantom
    label: str
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class RecognitionFamily(Options):
    """Cubes with one of the three hard inclusions of the recognition study (Section V-B)."""

    section = "family"
    shapes: tuple[Literal["cake", "torus", "cone"], ...] = option(
        ("cake", "torus", "cone"), "Shapes of the inclusion, equally likely", nonempty=True
    )
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    size: Range = option((0.85, 1.15), "Range of the scale relative to Fig. 4(a) to (c)", gt=0)
    shift: float = option(0.06, "Maximum offset of the centre along x and y, in sides", ge=0)
    tilt_deg: float = option(15.0, "Maximum angle between the inclusion's axis and z", ge=0)
    depth: Range = option((0.4, 0.5), "Range of the depth of the centre, in sides", gt=0)
    youngs_mpa: Range = option((0.15, 0.25), "Range of the cube's modulus", unit="MPa", gt=0)
    contrast: Range = option((4.0, 6.0), "Range of the ratio of the inclusion's modulus", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "size", "depth", "youngs_mpa", "contrast")

    def draw(self, rng: Rng) -> RandomPhantom:
        """Draw a phantom."""
        name = str(rng.choice(self.shapes))
        side, body = self.side_mm, cube_body(self.side_mm)

        def propose() -> Proposal:
            scale = float(rng.uniform(*self.size)) * side
            x, y = 0.5 + rng.uniform(-self.shift, self.shift, 2)
            center = side * np.array([x, y, 1.0 - float(rng.uniform(*self.depth))])
            axis = _tilted_axis(rng, self.tilt_deg)
            pose = {"scale_mm": scale, "center_mm": center.tolist(), "axis": axis.tolist()}
            return _RECOGNITION_SHAPES[name](center, scale, axis), pose

        shape, pose = _draw_inside(body, propose)
        soft = float(rng.uniform(*self.youngs_mpa))
        hard = soft * float(rng.uniform(*self.contrast))
        parameters = {**pose, "youngs_mpa": soft, "inclusion_mpa": hard}
        return RandomPhantom(Phantom(body, [(shape, hard)], soft), name, parameters)


@dataclass(frozen=True)
class InclusionsFamily(Options):
    """Cubes with several inclusions of random shape, pose and stiffness in a random background."""

    section = "family"
    count: tuple[int, int] = option((1, 3), "Range of the number of inclusions", ge=0)
    shapes: tuple[_Inclusion, ...] = option(
        get_args(_Inclusion), "Shapes of the inclusions; repeat a name to make it more likely",
        nonempty=True,
    )  # fmt: skip
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    size: Range = option((0.12, 0.28), "Range of the inclusions' half-widths, in sides", gt=0)
    youngs_mpa: Range = option(
        (0.1, 0.4), "Range of the background's median modulus, log-uniform", unit="MPa", gt=0
    )
    contrast: Range = option(
        (0.2, 8.0), "Range of the ratio of an inclusion's modulus to the background's, log-uniform;"
        " ratios within a quarter of 1 are excluded", gt=0,
    )  # fmt: skip
    backgrounds: tuple[Literal["uniform", "gradient", "random"], ...] = option(
        ("uniform", "uniform", "gradient", "random"),
        "Backgrounds; repeat a name to make it more likely", nonempty=True,
    )  # fmt: skip
    gap: float = option(0.03, "Minimum distance between inclusions, in sides", ge=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "count", "size", "youngs_mpa", "contrast")

    def draw(self, rng: Rng) -> RandomPhantom:
        """Draw a phantom; inclusions without room are left out."""
        side, body = self.side_mm, cube_body(self.side_mm)
        youngs = _log_uniform(rng, self.youngs_mpa)
        count = int(rng.integers(self.count[0], self.count[1] + 1))
        names = [str(rng.choice(self.shapes)) for _ in range(count)]
        inclusions: list[tuple[Shape, Real]] = []
        parts: list[dict[str, Any]] = []
        for name in names:

            def propose(name: str = name) -> Proposal:
                half = float(rng.uniform(*self.size)) * side
                low = min(half, 0.5 * side)
                center = rng.uniform(low, side - low, 3)
                pose = {"shape": name, "half_mm": half, "center_mm": center.tolist()}
                return _SHAPES[name](rng, center, half), pose

            others = [shape for shape, _ in inclusions]
            try:
                shape, pose = _draw_inside(body, propose, others, self.gap * side)
            except ConfigError:
                if inclusions:
                    break
                raise
            modulus = youngs * _draw_contrast(rng, self.contrast)
            inclusions.append((shape, modulus))
            parts.append({**pose, "inclusion_mpa": modulus})
        background = str(rng.choice(self.backgrounds))
        phantom = Phantom(body, inclusions, _draw_background(rng, background, youngs, side))
        parameters = {"background": background, "youngs_mpa": youngs, "parts": parts}
        return RandomPhantom(phantom, str(len(inclusions)), parameters)


FAMILIES = Registry(
    "family",
    {
        "recognition": "tactorch.phantoms.families:RecognitionFamily",
        "inclusions": "tactorch.phantoms.families:InclusionsFamily",
    },
)


def draw_phantom(family: str, rng: Rng, **options: Any) -> RandomPhantom:
    """Draw a phantom of one of `FAMILIES`, with settings of the family.

    The same state of the generator gives the same phantom. A `ConfigError` is raised where the
    settings leave no room for inclusions.
    """
    return FAMILIES.build({"name": family, **options}).draw(rng)


_RECOGNITION_SHAPES: dict[str, Callable[[np.ndarray, float, np.ndarray], Shape]] = {
    "cake": lambda center, scale, axis: two_tiers(center, 0.3 * scale, 0.4 * scale, axis),
    "torus": lambda center, scale, axis: Torus(center, 0.25 * scale, 0.1 * scale, axis),
    "cone": lambda center, scale, axis: Cone(center, 0.3 * scale, 0.5 * scale, axis),
}
_SHAPES: dict[str, Callable[[Rng, np.ndarray, float], Shape]] = {
    "ball": lambda rng, c, half: Sphere(c, half),
    "box": lambda rng, c, half: Rotated(
        Box(c, half * rng.uniform(1.0, 1.8, 3)), rng.uniform(-90.0, 90.0, 3)
    ),
    "cylinder": lambda rng, c, half: Cylinder(
        c, half * rng.uniform(0.4, 0.9), half * rng.uniform(1.0, 2.0), _direction(rng)
    ),
    "ellipsoid": lambda rng, c, half: Rotated(
        Ellipsoid(c, half * rng.uniform(0.5, 1.0, 3)), rng.uniform(-90.0, 90.0, 3)
    ),
    "torus": lambda rng, c, half: Torus(c, 0.68 * half, 0.32 * half, _direction(rng)),
    "cone": lambda rng, c, half: Cone(c, 0.9 * half, 1.6 * half, _direction(rng)),
    "cake": lambda rng, c, half: two_tiers(c, 0.9 * half, 1.4 * half, _direction(rng)),
}


def _draw_inside(
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


def _draw_background(rng: Rng, name: str, youngs: float, side: float) -> Real | Background:
    if name == "uniform":
        return youngs
    if name == "gradient":
        half_span = _direction(rng) * side / 2
        start, end = (side / 2 - half_span).tolist(), (side / 2 + half_span).tolist()
        ratio = float(np.sqrt(rng.uniform(1.3, 2.5)))
        return Gradient(start, end, youngs / ratio, youngs * ratio)
    spread, length = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.2, 0.5)) * side
    return RandomField(youngs, spread, length, int(rng.integers(2**31)))


def _draw_contrast(rng: Rng, limits: Range) -> float:
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


def _direction(rng: Rng) -> np.ndarray:
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _tilted_axis(rng: Rng, max_deg: float) -> np.ndarray:
    """Direction at an angle of at most `max_deg` to z."""
    tilt, turn = np.deg2rad(rng.uniform(0.0, max_deg)), rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def _log_uniform(rng: Rng, limits: Range) -> float:
    low, high = (float(np.log(limit)) for limit in limits)
    return float(np.exp(rng.uniform(low, high)))
