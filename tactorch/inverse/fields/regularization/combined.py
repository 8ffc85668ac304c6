"""Priors made of other priors: a weighted sum, and a prior about a given map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from tactorch.config import REGISTRIES, option
from tactorch.errors import ConfigError
from tactorch.inverse.fields.regularization.base import Field, Prior, Regularizer
from tactorch.inverse.fields.regularization.sharp import TotalVariation
from tactorch.mesh import TetMesh


@dataclass(frozen=True, kw_only=True)
class Composite(Prior):
    """Weighted sum of priors; the weight of the composite multiplies the sum.

    Each part is a share, a table of settings, or a prior; the `weight` of a part is its share of
    the sum, 1 by default.
    """

    parts: dict[str, Any] = option(
        factory=lambda: {"total_variation": 1.0, "sparsity": 1.0},
        help="Share, or table of settings, of each prior by name",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.parts:
            raise ConfigError("regularization.parts is empty; give {NAME: SHARE, ...}.")
        parts = {name: _make_part(name, value) for name, value in self.parts.items()}
        object.__setattr__(self, "parts", parts)

    def on(self, mesh: TetMesh) -> "CompositePenalty":
        return CompositePenalty([(part.weight, part.on(mesh)) for part in self.parts.values()])


def _make_part(name: str, value: Any) -> Prior:
    if not isinstance(value, Prior):
        settings = value if isinstance(value, Mapping) else {"weight": value}
        value = REGISTRIES["regularization"].build({"name": name, "weight": 1.0, **settings})
    share = 1.0 if value.weight is None else value.weight
    if not share > 0:
        raise ConfigError(f"regularization.parts.{name}={share}: give a share above 0.")
    return replace(value, weight=share)


class CompositePenalty(Regularizer):
    """Sum of share * penalty, given by pairs of a share and a penalty."""

    def __init__(self, parts: Sequence[tuple[float, Regularizer]]) -> None:
        self._parts = tuple(parts)

    def value(self, field: Field) -> float:
        return sum(share * part.value(field) for share, part in self._parts)

    def gradient(self, field: Field) -> Field:
        return sum((s * p.gradient(field) for s, p in self._parts), np.zeros_like(field))

    def curvature(self, field: Field) -> sp.csr_matrix:
        """Return the sum of the curvatures, a majorant's if each of them is."""
        empty = sp.csr_matrix((len(field), len(field)))
        return sum((s * p.curvature(field) for s, p in self._parts), empty).tocsr()


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftedPrior(Prior):
    """A prior about a map: the inner prior of (log E - log mean) / deviation.

    Levels of the inner prior are then levels of that difference. The map is one that is likely
    beforehand, such as a surrogate's prediction. With total variation and a share of one half, any
    fraction of the map's jumps costs the same, and the data decide. The weight is by default that
    of the inner prior.
    """

    prior: Prior = option(factory=TotalVariation, help="Inner prior", section="regularization")
    mean_mpa: np.ndarray = option(help="Map that the prior is about", unit="MPa")
    deviation: np.ndarray | None = option(None, "Deviation of each log-modulus about the map")
    share: float = option(1.0, "Share of the prior that is about the map", gt=0, le=1)

    def __post_init__(self) -> None:
        for name in ("mean_mpa", "deviation"):
            if getattr(self, name) is not None:
                values = np.array(getattr(self, name), dtype=np.float64)
                if values.ndim != 1 or not (np.isfinite(values).all() and (values > 0).all()):
                    raise ConfigError(
                        f"regularization.{name}: give one finite number above 0 for each element."
                    )
                object.__setattr__(self, name, values)
        super().__post_init__()
        if self.weight is None:
            object.__setattr__(self, "weight", self.prior.weight)

    def __eq__(self, other: object) -> bool:
        """Compare all settings, maps by their values."""
        return isinstance(other, ShiftedPrior) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]

    def on(self, mesh: TetMesh) -> Regularizer:
        for name in ("mean_mpa", "deviation"):
            values = getattr(self, name)
            if values is not None and values.shape != (mesh.n_tets,):
                raise ConfigError(
                    f"regularization.{name} has shape {values.shape}; give ({mesh.n_tets},)."
                )
        inner = self.prior.on(mesh)
        scale = np.ones(mesh.n_tets) if self.deviation is None else 1.0 / self.deviation
        shifted = _ShiftedPenalty(inner, np.log(self.mean_mpa), scale)
        if self.share == 1:
            return shifted
        return CompositePenalty([(1.0 - self.share, inner), (self.share, shifted)])


@dataclass(frozen=True, eq=False)
class _ShiftedPenalty(Regularizer):
    """The inner penalty of scale * (f - mean), never total variation of the log-moduli."""

    inner: Regularizer
    mean: Field
    scale: Field

    def _difference(self, field: np.ndarray) -> np.ndarray:
        return self.scale * (field - self.mean)

    def value(self, field: Field) -> float:
        return self.inner.value(self._difference(field))

    def gradient(self, field: Field) -> Field:
        return self.scale * self.inner.gradient(self._difference(field))

    def curvature(self, field: Field) -> sp.csr_matrix:
        scale = sp.diags(self.scale)
        return (scale @ self.inner.curvature(self._difference(field)) @ scale).tocsr()
