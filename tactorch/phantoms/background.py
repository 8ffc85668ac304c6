"""Young's modulus of a body that is not the same everywhere. Lengths in mm, moduli in MPa."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.shapes import store
from tactorch.mesh.values import Real, Vector, positive, unit_vector, vector
from tactorch.phantoms.config import as_mapping, refuse_unknown

_WAVES = 128


@runtime_checkable
class Background(Protocol):
    """A field of moduli."""

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""
        ...


@dataclass(frozen=True)
class Gradient:
    """Evenly rising from `low_mpa` at `start_mm` to `high_mpa` at `end_mm`, constant beyond."""

    start_mm: Vector
    end_mm: Vector
    low_mpa: Real = 0.1
    high_mpa: Real = 0.5

    def __post_init__(self) -> None:
        store(self, start_mm=vector("start_mm", self.start_mm))
        store(self, end_mm=vector("end_mm", self.end_mm))
        store(self, low_mpa=positive("low_mpa", self.low_mpa))
        store(self, high_mpa=positive("high_mpa", self.high_mpa))
        unit_vector("end_mm - start_mm", np.subtract(self.end_mm, self.start_mm))

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""
        way = np.subtract(self.end_mm, self.start_mm)
        share = np.clip((points - np.array(self.start_mm)) @ way / (way @ way), 0.0, 1.0)
        return self.low_mpa + share * (self.high_mpa - self.low_mpa)


@dataclass(frozen=True)
class Layers:
    """Layers across `axis`, each of one modulus: one more than the rising `levels_mm` between."""

    levels_mm: Sequence[Real]
    youngs_mpa: Sequence[Real]
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        levels = tuple(float(level) for level in self.levels_mm)
        moduli = tuple(positive(f"youngs_mpa[{i}]", e) for i, e in enumerate(self.youngs_mpa))
        if (
            any(above <= below for below, above in pairwise(levels))
            or not np.isfinite(levels).all()
        ):
            raise ConfigError(f"levels_mm={list(levels)} must rise.")
        if len(moduli) != len(levels) + 1:
            raise ConfigError(
                f"youngs_mpa has {len(moduli)} moduli for {len(levels)} levels between layers;"
                f" give {len(levels) + 1}."
            )
        store(self, levels_mm=levels, youngs_mpa=moduli, axis=unit_vector("axis", self.axis))

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""
        heights = points @ np.array(self.axis)
        return np.array(self.youngs_mpa)[np.searchsorted(np.array(self.levels_mm), heights)]


@dataclass(frozen=True)
class RandomField:
    """A smooth random field: its logarithm is Gaussian with a Gaussian correlation.

    Drawn as 128 random plane waves (Rahimi and Recht, 2007), so it has a value everywhere,
    whatever the mesh.

    Attributes:
        median_mpa: Median, MPa.
        spread: Standard deviation of the natural logarithm.
        correlation_mm: Distance at which the correlation has fallen to exp(-1/2).
        seed: Of the draw.
    """

    median_mpa: Real = 0.2
    spread: Real = 0.3
    correlation_mm: Real = 4.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("median_mpa", "spread", "correlation_mm"):
            store(self, **{name: positive(name, getattr(self, name))})
        if self.seed < 0:
            raise ConfigError(f"seed={self.seed} must not be negative.")

    def at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa."""
        rng = np.random.default_rng(self.seed)
        waves = rng.standard_normal((_WAVES, 3)) / self.correlation_mm
        phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        field = np.sqrt(2.0 / _WAVES) * np.cos(points @ waves.T + phases).sum(axis=1)
        return self.median_mpa * np.exp(self.spread * field)


BACKGROUNDS: dict[str, type[Any]] = {
    "gradient": Gradient,
    "layers": Layers,
    "random": RandomField,
}


def background_to_config(background: Background) -> dict[str, Any]:
    """Return it as `{"field": name, ...}`.

    Raises:
        ConfigError: It is none of `BACKGROUNDS`.
    """
    for name, kind in BACKGROUNDS.items():
        if isinstance(background, kind):
            values = {field.name: getattr(background, field.name) for field in fields(kind)}
            plain = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
            return {"field": name, **plain}
    raise ConfigError(
        f"{type(background).__name__} has no configuration; fields that have one:"
        f" {', '.join(BACKGROUNDS)}."
    )


def background_from_config(config: Any, where: str) -> Background:
    """Make a background from what `background_to_config` returns.

    Raises:
        ConfigError: The name or a field is unknown or missing, or a value cannot be used.
    """
    values = as_mapping(config, where)
    name = values.pop("field", None)
    if name not in BACKGROUNDS:
        raise ConfigError(f"{where}: field is {name!r}; choose one of {', '.join(BACKGROUNDS)}.")
    kind = BACKGROUNDS[name]
    refuse_unknown(values, {field.name for field in fields(kind)}, where)
    try:
        return kind(**values)
    except TypeError as error:
        raise ConfigError(f"{where}: {name} lacks a field ({error}).") from error
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error
