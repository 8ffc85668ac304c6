"""Families of random phantoms; the same state of the generator gives the same phantom.

Lengths in mm, moduli in MPa; positions and sizes of inclusions in sides of the cube.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tactorch.config import Options, Registry, option
from tactorch.mesh import Cone, Shape, Torus
from tactorch.phantoms.cubes import cube_body, two_tiers
from tactorch.phantoms.draws import (
    Proposal,
    RandomBody,
    RandomPhantom,
    Range,
    Rng,
    check_ranges,
    draw_inside,
)
from tactorch.phantoms.phantom import Phantom


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

        shape, pose = draw_inside(body, propose)
        soft = float(rng.uniform(*self.youngs_mpa))
        hard = soft * float(rng.uniform(*self.contrast))
        parameters = {**pose, "youngs_mpa": soft, "inclusion_mpa": hard}
        return RandomPhantom(Phantom(body, [(shape, hard)], soft), name, parameters)


@dataclass(frozen=True, kw_only=True)
class InclusionsFamily(RandomBody):
    """Cubes with several inclusions of random shape, pose and stiffness in a random background."""

    count: tuple[int, int] = option((1, 3), "Range of the number of inclusions", ge=0)
    side_mm: float = option(10.0, "Side of the cube", unit="mm", gt=0)
    size: Range = option((0.12, 0.28), "Range of the inclusions' half-widths, in sides", gt=0)
    youngs_mpa: Range = option(
        (0.1, 0.4), "Range of the background's median modulus, log-uniform", unit="MPa", gt=0
    )
    gap: float = option(0.03, "Minimum distance between inclusions, in sides", ge=0)

    def _body(self, rng: Rng) -> Proposal:
        return cube_body(self.side_mm), {}


FAMILIES = Registry(
    "family",
    {
        "recognition": "tactorch.phantoms.families:RecognitionFamily",
        "inclusions": "tactorch.phantoms.families:InclusionsFamily",
        "bodies": "tactorch.phantoms.bodies:BodiesFamily",
        "file": "tactorch.phantoms.bodies:FileFamily",
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


def _tilted_axis(rng: Rng, max_deg: float) -> np.ndarray:
    """Direction at an angle of at most `max_deg` to z."""
    tilt, turn = np.deg2rad(rng.uniform(0.0, max_deg)), rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
