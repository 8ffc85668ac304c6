"""Random objects. A family draws phantoms of one kind; the same generator draws the same object.

Lengths in mm, moduli in MPa; positions and sizes of inclusions in sides of the cube.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cone, Cylinder, Ellipsoid, Rotated, Shape, Sphere, Torus
from tactorch.mesh.values import Real, positive
from tactorch.phantoms.background import Background, Gradient, RandomField
from tactorch.phantoms.cubes import cake
from tactorch.phantoms.extent import clearance, protrusion
from tactorch.phantoms.phantom import Phantom

Pair = Sequence[Real]
_TRIES = 200


@dataclass(frozen=True)
class Drawn:
    """A random object.

    Attributes:
        phantom: The object.
        label: What a recognizer should call it.
        facts: What was drawn, as plain values.
    """

    phantom: Phantom
    label: str
    facts: dict[str, Any] = field(default_factory=dict)


def recognition(
    rng: np.random.Generator,
    *,
    shapes: Sequence[str] = ("cake", "torus", "cone"),
    side_mm: Real = 10.0,
    size: Pair = (0.85, 1.15),
    shift: Real = 0.06,
    tilt_deg: Real = 15.0,
    depth: Pair = (0.4, 0.5),
    youngs_mpa: Pair = (0.15, 0.25),
    contrast: Pair = (4.0, 6.0),
) -> Drawn:
    """A cube with one of the three hard inclusions of the recognition study (Section V-B).

    Args:
        rng: Generator.
        shapes: Of "cake", "torus" and "cone"; each as likely.
        side_mm: Of the cube.
        size: Range of the scale, against the inclusions of Fig. 4(a) to (c).
        shift: Largest offset of the centre along x and y.
        tilt_deg: Largest angle between the inclusion's axis and z.
        depth: Range of the depth of the centre.
        youngs_mpa: Range of the cube's modulus.
        contrast: Range of the inclusion's modulus over the cube's.
    """
    _check_names("shape", shapes, _RECOGNISED)
    name = str(rng.choice(shapes))
    body = _cube(side_mm)

    def draw() -> tuple[Shape, dict[str, Any]]:
        scale = _between(rng, "size", size) * float(side_mm)
        x, y = 0.5 + rng.uniform(-float(shift), float(shift), 2)
        center = float(side_mm) * np.array([x, y, 1.0 - _between(rng, "depth", depth)])
        axis = _tilted(rng, float(tilt_deg))
        facts = {"scale_mm": scale, "center_mm": center.tolist(), "axis": axis.tolist()}
        return _RECOGNISED[name](center, scale, axis), facts

    shape, facts = _within(body, draw)
    soft = _between(rng, "youngs_mpa", youngs_mpa)
    hard = soft * _between(rng, "contrast", contrast)
    facts |= {"youngs_mpa": soft, "inclusion_mpa": hard}
    return Drawn(Phantom(body, [(shape, hard)], soft), name, facts)


def inclusions(
    rng: np.random.Generator,
    *,
    count: Sequence[int] = (1, 3),
    shapes: Sequence[str] = ("ball", "box", "cylinder", "ellipsoid", "torus", "cone", "cake"),
    side_mm: Real = 10.0,
    size: Pair = (0.12, 0.28),
    youngs_mpa: Pair = (0.1, 0.4),
    contrast: Pair = (0.2, 8.0),
    backgrounds: Sequence[str] = ("uniform", "uniform", "gradient", "random"),
    gap: Real = 0.03,
) -> Drawn:
    """A cube with several inclusions of any shape, pose and stiffness on a varying background.

    Args:
        rng: Generator.
        count: Fewest and most inclusions.
        shapes: What they may be; name one twice to make it twice as likely.
        side_mm: Of the cube.
        size: Range of their half-widths.
        youngs_mpa: Range of the background's (median) modulus, evenly drawn in its logarithm.
        contrast: Range of an inclusion's modulus over the background's, likewise; what lies
            within a quarter of 1 is drawn again, for it could hardly be told.
        backgrounds: Of "uniform", "gradient" and "random".
        gap: Least distance between inclusions.
    """
    body = _cube(side_mm)
    if len(count) != 2 or not 0 <= count[0] <= count[1]:
        raise ConfigError(f"count={list(count)}: give the fewest and the most inclusions.")
    _check_names("shape", shapes, _ANY)
    _check_names("background", backgrounds, _BACKGROUNDS)
    soft = _even_in_log(rng, "youngs_mpa", youngs_mpa)
    wanted = int(rng.integers(count[0], count[1] + 1))
    names = [str(rng.choice(shapes)) for _ in range(wanted)]
    parts: list[tuple[Shape, Real]] = []
    facts: list[dict[str, Any]] = []
    for name in names:

        def draw(name: str = name) -> tuple[Shape, dict[str, Any]]:
            half = _between(rng, "size", size) * float(side_mm)
            low = min(half, 0.5 * float(side_mm))
            center = rng.uniform(low, float(side_mm) - low, 3)
            facts = {"shape": name, "half_mm": half, "center_mm": center.tolist()}
            return _ANY[name](rng, center, half), facts

        others = [shape for shape, _ in parts]
        try:
            shape, what = _within(body, draw, others, float(gap) * float(side_mm))
        except ConfigError:
            if parts:
                break  # no room for another
            raise
        ratio = _contrast(rng, contrast)
        parts.append((shape, soft * ratio))
        facts.append({**what, "inclusion_mpa": soft * ratio})
    kind = str(rng.choice(backgrounds))
    field_ = _background(rng, kind, soft, float(side_mm))
    phantom = Phantom(body, parts, field_)
    return Drawn(phantom, str(len(parts)), {"background": kind, "youngs_mpa": soft, "parts": facts})


FAMILIES: dict[str, Callable[..., Drawn]] = {"recognition": recognition, "inclusions": inclusions}


def draw_phantom(family: str, rng: np.random.Generator, **options: Any) -> Drawn:
    """Draw an object of a family.

    Args:
        family: A key of `FAMILIES`.
        rng: Generator; the same state draws the same object.
        options: Arguments of that function.

    Raises:
        ConfigError: The family or an option is unknown, or an option leaves no room for objects.
    """
    if family not in FAMILIES:
        raise ConfigError(f"family '{family}' is unknown; choose one of {', '.join(FAMILIES)}.")
    try:
        return FAMILIES[family](rng, **options)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"family '{family}' does not take these options: {error}.") from error


def _cake(center: np.ndarray, scale: float, axis: np.ndarray) -> Shape:
    return cake(center, 0.3 * scale, 0.4 * scale, axis)


def _torus(center: np.ndarray, scale: float, axis: np.ndarray) -> Shape:
    return Torus(center, 0.25 * scale, 0.1 * scale, axis)


def _cone(center: np.ndarray, scale: float, axis: np.ndarray) -> Shape:
    return Cone(center, 0.3 * scale, 0.5 * scale, axis)


_BACKGROUNDS = ("uniform", "gradient", "random")
_RECOGNISED = {"cake": _cake, "torus": _torus, "cone": _cone}

_Rng = np.random.Generator
_ANY: dict[str, Callable[[_Rng, np.ndarray, float], Shape]] = {
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
    "cake": lambda rng, c, half: cake(c, 0.9 * half, 1.4 * half, _direction(rng)),
}


def _within(
    body: Shape,
    draw: Callable[[], tuple[Shape, dict[str, Any]]],
    others: Sequence[Shape] = (),
    gap: float = 0.0,
) -> tuple[Shape, dict[str, Any]]:
    """Draw until a shape lies in the body and clear of the others."""
    for _ in range(_TRIES):
        shape, facts = draw()
        if protrusion(shape, body) > 0.0:
            continue
        if all(clearance(shape, other) >= gap for other in others):
            return shape, facts
    raise ConfigError(
        f"No inclusion found room in {_TRIES} draws; make size, shift or count smaller."
    )


def _background(rng: np.random.Generator, kind: str, soft: float, side: float) -> Real | Background:
    if kind == "uniform":
        return soft
    if kind == "gradient":
        way = _direction(rng) * side / 2
        middle = np.full(3, side / 2)
        ratio = float(rng.uniform(1.3, 2.5))
        return Gradient(middle - way, middle + way, soft / np.sqrt(ratio), soft * np.sqrt(ratio))
    spread, length = float(rng.uniform(0.1, 0.35)), float(rng.uniform(0.2, 0.5)) * side
    return RandomField(soft, spread, length, int(rng.integers(2**31)))


def _check_names(what: str, names: Sequence[str], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise ConfigError(f"{what} {name!r} is unknown; choose from {', '.join(known)}.")
    if not names:
        raise ConfigError(f"no {what} is given; choose from {', '.join(known)}.")


def _cube(side_mm: Real) -> Box:
    side = positive("side_mm", side_mm)
    return Box((side / 2,) * 3, (side,) * 3)


def _direction(rng: np.random.Generator) -> np.ndarray:
    """A direction, each as likely."""
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def _tilted(rng: np.random.Generator, max_deg: float) -> np.ndarray:
    """A direction at most that far from z."""
    tilt, turn = np.deg2rad(rng.uniform(0.0, max_deg)), rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def _between(rng: np.random.Generator, name: str, pair: Pair) -> float:
    """A number of a range, each as likely."""
    low, high = (positive(f"{name}[{i}]", value) for i, value in enumerate(pair))
    if high < low:
        raise ConfigError(f"{name}={list(pair)} must be the lower and the upper end of a range.")
    return float(rng.uniform(low, high))


def _even_in_log(rng: np.random.Generator, name: str, pair: Pair) -> float:
    low, high = (float(np.log(positive(f"{name}[{i}]", x))) for i, x in enumerate(pair))
    return float(np.exp(rng.uniform(low, high)))


def _contrast(rng: np.random.Generator, pair: Pair) -> float:
    for _ in range(_TRIES):
        ratio = _even_in_log(rng, "contrast", pair)
        if abs(np.log(ratio)) >= np.log(1.25):
            return ratio
    raise ConfigError(f"contrast={list(pair)} holds nothing that differs from 1 by a quarter.")
