"""Prior of the nuisance parameters that are estimated together with the moduli."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.inverse.nuisance.values import Nuisance

_SIZES = {"poisson": 1, "force_scale": 1, "rest_scale": 3, "translation_mm": 3, "rotation_rad": 3}
_RATIOS = ("force_scale", "rest_scale")
_POISSON = (-0.9, 0.4995)  # beyond the upper one tetrahedra of any kind lock
_FAR = 8.0  # standard deviations that an estimate may lie from what was assumed


@dataclass(frozen=True)
class NuisancePrior(Options):
    """Nuisance parameters to be estimated; each field is a prior standard deviation, or None.

    The prior is normal about the recording's values: for Poisson's ratio, translation and rotation
    in their units, for the scales in their logarithms (0.1 is about 10 %). The optimizer's variable
    is z, the difference from there in standard deviations.

    Without springs of known stiffness, weight or prescribed motion the scales of forces and moduli
    are one unknown: the data are then uninformative about `force_scale`, and its deviation remains
    that of the prior.

    Attributes:
        poisson: Deviation of Poisson's ratio, such as 0.02.
        force_scale: Deviation of the logarithm of true over reported force, such as 0.2.
        rest_scale: Deviation of the logarithm of true over assumed size of each axis, such as 0.1.
        translation_mm: Deviation of each component of the sensor's offset, mm.
        rotation_rad: Deviation of each component of the sensor's rotation vector, rad.
    """

    section: ClassVar[str] = "nuisance"
    poisson: float | None = option(None, "Deviation of Poisson's ratio; null: known", gt=0)
    force_scale: float | None = option(
        None, "Relative deviation of true from reported force; null: known", gt=0
    )
    rest_scale: float | None = option(
        None, "Relative deviation of true from assumed size, each axis; null: known", gt=0
    )
    translation_mm: float | None = option(
        None, "Deviation of the sensor's offset, each axis; null: known", unit="mm", gt=0
    )
    rotation_rad: float | None = option(
        None, "Deviation of the sensor's rotation, each axis; null: known", unit="rad", gt=0
    )

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are estimated."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)

    @property
    def size(self) -> int:
        """Number of values that are estimated."""
        return sum(_SIZES[name] for name in self.names)

    def parts(self, values: Float[np.ndarray, " k"]) -> dict[str, np.ndarray]:
        """Split values, in the order of z, by parameter."""
        ends = np.cumsum([_SIZES[name] for name in self.names])[:-1]
        return dict(zip(self.names, np.split(values, ends), strict=True)) if self.names else {}

    def nuisance(self, z: Float[np.ndarray, " k"], assumed: Nuisance) -> Nuisance:
        """Return the values at z."""
        changes: dict[str, Any] = {}
        for name, part in self.parts(z).items():
            shift, origin = getattr(self, name) * part, getattr(assumed, name)
            value = origin * np.exp(shift) if name in _RATIOS else origin + shift
            changes[name] = float(value[0]) if _SIZES[name] == 1 else value
        return replace(assumed, **changes)

    def z(
        self, values: Mapping[str, Float[np.ndarray, " _"]], assumed: Nuisance
    ) -> Float[np.ndarray, " k"]:
        """Return z of values, by name; the inverse of `nuisance`."""
        parts = [np.zeros(0)]
        for name in self.names:
            value = np.atleast_1d(values[name])
            origin = np.atleast_1d(getattr(assumed, name))
            shift = np.log(value / origin) if name in _RATIOS else value - origin
            parts.append(shift / getattr(self, name))
        return np.concatenate(parts)

    def slopes(self) -> Float[np.ndarray, " k"]:
        """Return d(value, or log of a scale) / dz: the prior deviations, one a component."""
        return np.concatenate(
            [np.zeros(0), *(np.full(_SIZES[name], getattr(self, name)) for name in self.names)]
        )

    def limits(self, assumed: Nuisance) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of z."""
        low, high = np.full(self.size, -_FAR), np.full(self.size, _FAR)
        if self.poisson is not None:  # the first component
            ends = (np.array(_POISSON) - assumed.poisson) / self.poisson
            low[0], high[0] = max(low[0], ends[0]), min(high[0], ends[1])
        return low, high
