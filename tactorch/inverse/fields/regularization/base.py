"""Priors: settings of a penalty on log-moduli, and the penalty itself on a mesh.

Penalties act on the logarithm of Young's modulus in every parameterisation, because moduli of
tissues differ by factors.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh

Field = Float[np.ndarray, " m"]
#: A log-modulus for all elements, for each of them, or one that follows the present map.
Level = float | Field | None


class Regularizer(ABC):
    """Penalty on a field of log-moduli, one value per element.

    Attributes:
        variation_edge: Jump below which total variation of the log-moduli is quadratic, where the
            penalty is that, else None; posteriors depend on it.
    """

    variation_edge: float | None = None

    @abstractmethod
    def value(self, field: Field) -> float:
        """Return the penalty (dimensionless)."""

    @abstractmethod
    def gradient(self, field: Field) -> Field:
        """Return the gradient of the penalty."""

    @abstractmethod
    def curvature(self, field: Field) -> sp.csr_matrix:
        """Return a positive semi-definite approximation of the penalty's Hessian, (m, m).

        Where possible it belongs to a majorant: the quadratic with this Hessian and the penalty's
        value and gradient at `field` is nowhere below the penalty.
        """


@dataclass(frozen=True, kw_only=True)
class Prior(Options, ABC):
    """Settings of a prior. A subclass adds its own settings and `on`."""

    section: ClassVar[str] = "regularization"
    weight: float | None = option(
        None, "Weight of the prior; null: chosen so that the data are fitted to their noise", ge=0
    )

    @abstractmethod
    def on(self, mesh: TetMesh) -> Regularizer:
        """Return the penalty on a mesh."""


class Quadratic(Regularizer):
    """Half of (f - level)^T P (f - level), with f the field of log-moduli.

    Args:
        matrix: P, symmetric and positive semi-definite, (m, m).
        level: Log-modulus of the minimum, one or (m,); None takes the field's average by `volumes`,
            which must minimise the penalty, so that the gradient is exact although the level
            depends on the field.
        volumes: Weights of that average, (m,).
    """

    def __init__(
        self, matrix: sp.spmatrix, level: Level = 0.0, volumes: Field | None = None
    ) -> None:
        self._matrix, self._level, self._volumes = matrix.tocsr(), level, volumes

    def _difference(self, field: np.ndarray) -> np.ndarray:
        level = np.average(field, weights=self._volumes) if self._level is None else self._level
        return field - level

    def value(self, field: Field) -> float:
        difference = self._difference(field)
        return 0.5 * float(difference @ (self._matrix @ difference))

    def gradient(self, field: Field) -> Field:
        return self._matrix @ self._difference(field)

    def curvature(self, field: Field) -> sp.csr_matrix:
        """Return the matrix: the Hessian at a fixed level, a majorant at an estimated one."""
        return self._matrix


@dataclass(frozen=True, kw_only=True)
class NoPrior(Prior):
    """No prior: the start remains where the data are uninformative."""

    weight: float | None = option(0.0, "Not used", ge=0)

    def on(self, mesh: TetMesh) -> Quadratic:
        return Quadratic(sp.csr_matrix((mesh.n_tets, mesh.n_tets)))


@dataclass(frozen=True, kw_only=True)
class LevelPrior(Prior):
    """A prior about a reference modulus, which may follow the present map."""

    level_mpa: float | None = option(
        None, "Reference modulus; null: that of the present map", unit="MPa", gt=0
    )
    region_mpa: dict[int, float] | None = option(
        None, "Reference modulus of regions by number; others take level_mpa", unit="MPa", gt=0
    )

    def level(self, mesh: TetMesh) -> Level:
        """Return the reference as a log-modulus: one, (m,), or None for that of the present map.

        Raises:
            ConfigError: The mesh has no regions, not one of these, or regions without a modulus.
        """
        if not self.region_mpa:
            return None if self.level_mpa is None else float(np.log(self.level_mpa))
        name = "regularization.region_mpa"
        return np.log(region_values(self.region_mpa, mesh, name, self.level_mpa))


def region_values(
    by_region: Mapping[int, float], mesh: TetMesh, name: str, others: float | None = None
) -> Field:
    """Return the value of the region of each element, by the setting of a name.

    Each region must have a value where there is none for others.

    Raises:
        ConfigError: The mesh has no regions, not one of these, or regions without a value.
    """
    if mesh.regions is None:
        raise ConfigError(
            f"{name} is given, but the mesh has no regions; make it with tactorch body, or read one"
            " with cell data 'region'."
        )
    numbers, index = np.unique(mesh.regions, return_inverse=True)
    known = ", ".join(map(str, numbers))
    unknown = [number for number in by_region if number not in numbers]
    if unknown:
        raise ConfigError(f"{name} names region {unknown[0]}; those of the mesh are {known}.")
    missing = [number for number in numbers if number not in by_region]
    if missing and others is None:
        raise ConfigError(f"{name} has no value for region {missing[0]}; give one for {known}.")
    return np.array([by_region.get(int(number), others) for number in numbers])[index]


def jumps(mesh: TetMesh) -> sp.csr_matrix:
    """Return the matrix that maps a field to its jumps across interior faces, (faces, m)."""
    first, second = mesh.adjacency.pairs.T
    unit = sp.identity(mesh.n_tets, format="csr")
    return unit[first] - unit[second]


def relative(sizes: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return sizes over their mean, such as volumes of elements and areas of interior faces."""
    return sizes / sizes.mean() if len(sizes) else sizes


_HERE = "tactorch.inverse.fields.regularization"
#: Settings of the priors by name.
PRIORS = Registry(
    "regularization",
    {
        "none": f"{_HERE}.base:NoPrior",
        "smoothness": f"{_HERE}.gaussian:Smoothness",
        "total_variation": f"{_HERE}.sharp:TotalVariation",
        "log_jumps": f"{_HERE}.sharp:LogJumps",
        "tikhonov": f"{_HERE}.gaussian:Tikhonov",
        "sparsity": f"{_HERE}.sharp:Sparsity",
        "binary_well": f"{_HERE}.sharp:BinaryWell",
        "matern": f"{_HERE}.gaussian:Matern",
        "composite": f"{_HERE}.combined:Composite",
    },
)
