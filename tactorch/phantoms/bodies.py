"""Families of random phantoms of other shapes than cubes: boxes, curved bodies and files.

Bodies stand on the plane z = 0, with the axis x = y = 0; a body of a file stays where it is.
Lengths in mm, moduli in MPa.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.files import require_file
from tactorch.mesh import BodyFile, Box, Cylinder, Hemisphere, Hyperboloid, Lathe, Shape
from tactorch.phantoms.draws import Proposal, RandomBody, Range, Rng, check_ranges

_Body = Literal["box", "cylinder", "hemisphere", "hyperboloid", "lathe"]
_PROFILE_POINTS = 33  # of a random lathe


@dataclass(frozen=True, kw_only=True)
class BodiesFamily(RandomBody):
    """Boxes and curved bodies of random size, with random inclusions."""

    bodies: tuple[_Body, ...] = option(
        get_args(_Body), "Bodies; repeat a name to make it more likely", nonempty=True
    )
    width_mm: Range = option((18.0, 28.0), "Range of the body's width", unit="mm", gt=0)
    height: Range = option(
        (0.5, 0.9), "Range of the ratio of the body's height to its width; a hemisphere has 0.5",
        gt=0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "width_mm", "height")

    def _body(self, rng: Rng) -> Proposal:
        name = str(rng.choice(self.bodies))
        width = float(rng.uniform(*self.width_mm))
        height = width * float(rng.uniform(*self.height))
        facts = {"body": name, "width_mm": width, "height_mm": height}
        return _BODIES[name](rng, width, height), facts


@dataclass(frozen=True, kw_only=True)
class FileFamily(RandomBody):
    """The body of a surface (.stl, .obj, .ply) or mesh file, with random inclusions."""

    file: Path | None = option(None, "Closed surface or mesh of the body; required")
    unit: Literal["mm", "cm", "m"] = option("mm", "Length unit of the file")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is None:
            raise ConfigError("family.file is required: the surface or mesh of the body.")

    def content_hash(self) -> str:
        """Return the SHA-256 of the file."""
        return sha256(require_file(str(self.file), "body").read_bytes()).hexdigest()

    def _body(self, rng: Rng) -> Proposal:
        return BodyFile(str(self.file), self.unit), {"body": Path(str(self.file)).name}


def _box(rng: Rng, width: float, height: float) -> Shape:
    depth = width * float(rng.uniform(0.7, 1.0))
    return Box((0.0, 0.0, height / 2), (width, depth, height))


def _hyperboloid(rng: Rng, width: float, height: float) -> Shape:
    waist = width / 2 * float(rng.uniform(0.7, 0.9))
    return Hyperboloid((0.0, 0.0, height / 2), waist, width / 2, height)


def _lathe(rng: Rng, width: float, height: float) -> Shape:
    """Body with a flat foot, a belly and a round top, of a wavy profile."""
    foot, belly = float(rng.uniform(0.6, 0.9)), float(rng.uniform(0.3, 0.5))
    wave, turns = float(rng.uniform(0.0, 0.06)), float(rng.uniform(1.0, 2.5))
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    # More points at the top, where the profile turns to the axis.
    up = np.sin(np.linspace(0.0, np.pi / 2, _PROFILE_POINTS))
    lower = foot + (1.0 - foot) * np.sin(np.pi / 2 * np.minimum(up / belly, 1.0))
    upper = np.sqrt(1.0 - np.clip((up - belly) / (1.0 - belly), 0.0, 1.0) ** 2)
    radius = np.where(up < belly, lower, upper)
    radius *= 1.0 + wave * np.sin(2.0 * np.pi * turns * up + phase)
    radius[-1] = 0.0
    profile = np.column_stack([width / 2 * radius / radius.max(), height * up])
    return Lathe((0.0, 0.0, 0.0), np.concatenate([[(0.0, 0.0)], profile]))


_BODIES: dict[str, Callable[[Rng, float, float], Shape]] = {
    "box": _box,
    "cylinder": lambda rng, wide, high: Cylinder((0.0, 0.0, high / 2), wide / 2, high),
    "hemisphere": lambda rng, wide, high: Hemisphere((0.0, 0.0, 0.0), wide / 2),
    "hyperboloid": _hyperboloid,
    "lathe": _lathe,
}
