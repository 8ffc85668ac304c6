"""The soft layer of a tactile sensor. Lengths in mm, moduli in MPa."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError, RecordingError
from tactorch.mesh.values import Real, positive
from tactorch.recording import MaterialSpec
from tactorch.sensor.description.numbers import lengths, plausible

_SOFTEST, _STIFFEST = 1e-3, 20.0  # MPa, of what gels are made of
_THICK_MM, _WIDE_MM = (0.05, 100.0), (0.5, 500.0)  # that gels may be


@dataclass(frozen=True)
class GelLayer:
    """A layer that is bonded to a rigid window; its outline is a rectangle or a circle.

    Attributes:
        thickness_mm: In the middle.
        youngs_mpa: Young's modulus.
        poisson: Poisson's ratio.
        size_mm: Width and height of a rectangular outline.
        radius_mm: Of a circular outline; give this or the size.
        curvature_radius_mm: Of an outer face that is part of a sphere, bulging outward; None for
            a flat one.
        material: The constitutive law.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    thickness_mm: Real
    youngs_mpa: Real
    poisson: Real = 0.48
    size_mm: Sequence[Real] | None = None
    radius_mm: Real | None = None
    curvature_radius_mm: Real | None = None
    material: str = "neo_hookean"

    def __post_init__(self) -> None:
        plausible("thickness_mm", float(self.thickness_mm), *_THICK_MM)
        youngs = positive("youngs_mpa", self.youngs_mpa)
        if not _SOFTEST <= youngs <= _STIFFEST:
            raise ConfigError(
                f"youngs_mpa={youngs:g}: gels have {_SOFTEST:g} to {_STIFFEST:g} MPa; give MPa, not"
                f" Pa or kPa."
            )
        try:
            MaterialSpec(self.material, float(self.poisson))
        except RecordingError as error:
            raise ConfigError(f"{error}") from error
        if (self.size_mm is None) == (self.radius_mm is None):
            raise ConfigError("give size_mm (of a rectangle) or radius_mm (of a circle).")
        if self.size_mm is not None:
            object.__setattr__(self, "size_mm", lengths("size_mm", self.size_mm, 2))
            for i, side in enumerate(self.size_mm):
                plausible(f"size_mm[{i}]", float(side), *_WIDE_MM)
        if self.radius_mm is not None:
            plausible("radius_mm", float(self.radius_mm), *_WIDE_MM)
        self._check_curvature()

    def _check_curvature(self) -> None:
        if self.curvature_radius_mm is None:
            return
        curvature = positive("curvature_radius_mm", self.curvature_radius_mm)
        if curvature <= self.reach_mm:
            raise ConfigError(
                f"curvature_radius_mm={curvature:g} is no more than the outline's reach"
                f" {self.reach_mm:.4g} mm: such a face would overhang."
            )
        drop = curvature - np.sqrt(curvature**2 - self.reach_mm**2)
        if drop >= float(self.thickness_mm):
            raise ConfigError(
                f"curvature_radius_mm={curvature:g}: the face falls by {drop:.4g} mm to its rim,"
                f" but thickness_mm is {self.thickness_mm:g}."
            )

    @property
    def half_mm(self) -> tuple[float, float]:
        """Half width and half height of the outline's box."""
        if self.size_mm is None:
            assert self.radius_mm is not None
            return float(self.radius_mm), float(self.radius_mm)
        return float(self.size_mm[0]) / 2, float(self.size_mm[1]) / 2

    @property
    def reach_mm(self) -> float:
        """Distance of the outline's farthest point from the middle."""
        return self.half_mm[0] if self.size_mm is None else float(np.hypot(*self.half_mm))

    @property
    def spec(self) -> MaterialSpec:
        """The constitutive law but for Young's modulus."""
        return MaterialSpec(self.material, float(self.poisson))

    def covers(self, places_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Tell which places x, y lie within the outline."""
        if self.size_mm is None:
            return np.asarray(np.linalg.norm(places_mm, axis=-1) <= self.reach_mm)
        return np.asarray((np.abs(places_mm) <= np.array(self.half_mm)).all(axis=-1))

    def height_mm(self, places_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return z of the outer face at rest: 0 in the middle, below where it curves away."""
        if self.curvature_radius_mm is None:
            return np.zeros(places_mm.shape[:-1])
        curvature = float(self.curvature_radius_mm)
        distance = np.minimum(np.linalg.norm(places_mm, axis=-1), curvature)
        return np.sqrt(curvature**2 - distance**2) - curvature
