"""Which presses to make: where, how hard, and what holds the object meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import FACE_NAMES
from tactorch.mesh.values import Real, Vector, positive, vector

HOLDS = ("springs", "fixed", "roller")


@dataclass(frozen=True)
class Series:
    """Presses on one place with rising pressure: a face, and a patch's centre or None for all."""

    face: str
    center_mm: tuple[float, float, float] | None = None

    @property
    def axis(self) -> int:
        """The axis along the face's normal: 0, 1 or 2."""
        return "xyz".index(self.face[0])

    @property
    def opposite(self) -> str:
        """The face on the other side, which is held."""
        return self.face[0] + ("-" if self.face[1] == "+" else "+")

    @property
    def push(self) -> Float[np.ndarray, "3"]:
        """Unit vector into the object."""
        return np.eye(3)[self.axis] * (-1.0 if self.face[1] == "+" else 1.0)

    @property
    def name(self) -> str:
        """What messages and reports call it."""
        if self.center_mm is None:
            return self.face
        return f"{self.face} at ({', '.join(f'{x:.4g}' for x in self.center_mm)}) mm"


@dataclass(frozen=True)
class PressPlan:
    """Presses on flat sides, each with all pressures in turn, the opposite side held.

    Attributes:
        faces: Pressed sides, of `tactorch.mesh.FACE_NAMES`.
        pressures_mpa: Rising pressures, MPa; the paper's 5 to 20 kPa by default. Pressure is dead:
            per area of the object at rest, along the normal at rest.
        patch_radius_mm: Radius of a circular patch that is pressed; None for the whole side.
        patch_centers_mm: Points that are projected onto each side to give the centres of its
            patches; None for one patch in the middle of the side.
        hold: "springs": each node of the opposite side on zero-length springs along all axes, as
            in the paper; "fixed": held exactly; "roller": held exactly along the normal only, and
            in two corners against sliding and turning, so that it may spread freely.
        spring_n_per_mm: Stiffness of each spring (the paper's k_c = 1000 N/m).

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    faces: Sequence[str] = ("z+",)
    pressures_mpa: Sequence[Real] = (0.005, 0.010, 0.015, 0.020)
    patch_radius_mm: Real | None = None
    patch_centers_mm: Sequence[Vector] | None = None
    hold: str = "springs"
    spring_n_per_mm: Real = 1.0

    def __post_init__(self) -> None:
        faces = (self.faces,) if isinstance(self.faces, str) else tuple(self.faces)
        object.__setattr__(self, "faces", _checked_faces(faces))
        object.__setattr__(self, "pressures_mpa", _checked_pressures(self.pressures_mpa))
        if self.hold not in HOLDS:
            raise ConfigError(f"hold={self.hold!r}: choose one of {', '.join(HOLDS)}.")
        stiffness = positive("spring_n_per_mm", self.spring_n_per_mm)
        object.__setattr__(self, "spring_n_per_mm", stiffness)
        self._check_patches()

    @classmethod
    def ramp(cls, p_max_mpa: Real, steps: int, **others: Any) -> "PressPlan":
        """Plan `steps` equal steps of pressure, p_max i / steps, as in Section IV-B.

        Args:
            p_max_mpa: The highest pressure, MPa.
            steps: Their number, the paper's t.
            others: Fields of the plan other than `pressures_mpa`.

        Raises:
            ConfigError: A value cannot be used.
        """
        highest = positive("p_max_mpa", p_max_mpa)
        if steps < 1:
            raise ConfigError(f"steps={steps} must be at least 1.")
        pressures = [highest * i / steps for i in range(1, steps + 1)]
        return cls(pressures_mpa=pressures, **others)

    @property
    def series(self) -> tuple[Series, ...]:
        """Each pressed place, face by face."""
        if self.patch_centers_mm is None:
            return tuple(Series(face) for face in self.faces)
        centers = [vector("patch_centers_mm", center) for center in self.patch_centers_mm]
        return tuple(Series(face, center) for face in self.faces for center in centers)

    @property
    def n_presses(self) -> int:
        """Number of presses: places times pressures."""
        return len(self.series) * len(self.pressures_mpa)

    def to_config(self) -> dict[str, Any]:
        """Return the fields as plain values; `PressPlan(**config)` makes an equal plan."""
        centers = self.patch_centers_mm
        return {
            "faces": list(self.faces),
            "pressures_mpa": list(self.pressures_mpa),
            "patch_radius_mm": self.patch_radius_mm,
            "patch_centers_mm": None if centers is None else [list(c) for c in centers],
            "hold": self.hold,
            "spring_n_per_mm": self.spring_n_per_mm,
        }

    def _check_patches(self) -> None:
        if self.patch_radius_mm is not None:
            radius = positive("patch_radius_mm", self.patch_radius_mm)
            object.__setattr__(self, "patch_radius_mm", radius)
        if self.patch_centers_mm is None:
            return
        if self.patch_radius_mm is None:
            raise ConfigError("patch_centers_mm is given without patch_radius_mm; give both.")
        centers = tuple(
            vector(f"patch_centers_mm[{i}]", c) for i, c in enumerate(self.patch_centers_mm)
        )
        if not centers:
            raise ConfigError("patch_centers_mm is empty; give a point, or None for the middle.")
        object.__setattr__(self, "patch_centers_mm", centers)


def _checked_faces(faces: tuple[str, ...]) -> tuple[str, ...]:
    if not faces:
        raise ConfigError(f"faces is empty; name sides of {', '.join(FACE_NAMES)}.")
    for face in faces:
        if face not in FACE_NAMES:
            raise ConfigError(f"faces: unknown side '{face}'; choose from {', '.join(FACE_NAMES)}.")
    if len(set(faces)) < len(faces):
        raise ConfigError(f"faces={list(faces)} repeats a side; name each once.")
    return faces


def _checked_pressures(pressures: Sequence[Real]) -> tuple[float, ...]:
    values = tuple(positive(f"pressures_mpa[{i}]", p) for i, p in enumerate(pressures))
    if not values:
        raise ConfigError("pressures_mpa is empty; give at least one pressure in MPa.")
    if any(later <= former for former, later in pairwise(values)):
        raise ConfigError(f"pressures_mpa={list(values)} must rise from one step to the next.")
    return values
