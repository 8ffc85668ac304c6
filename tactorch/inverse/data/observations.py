"""The data of an inversion: observations, their noise, and errors that they have in common."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.inverse.data.misfit import NORMAL_MEDIAN, Misfit, Squares
from tactorch.recording import ForceReading, Press, Recording


@dataclass(frozen=True)
class NoiseModel(Options):
    """Standard deviations of the observed displacements.

    The first that applies: `mm`, where given; the value stated by the press; the estimate from the
    recording's unloaded frames; `relative`, which is also a floor, since no model is exact.
    """

    section: ClassVar[str] = "noise"
    relative: float = option(
        1e-4, "Noise as a fraction of the signal where it is not stated; a floor elsewhere",
        gt=0, lt=1,
    )  # fmt: skip
    mm: float | None = option(
        None, "Noise, which overrides what the recording states", unit="mm", gt=0
    )

    def deviations(self, recording: Recording) -> list[float]:
        """Return the standard deviation of each press's displacements, mm; 1 without any."""
        floor = self.relative * signal_rms(recording.presses)
        return [max(known, floor) or 1.0 for known in self._known(recording, floor)]

    def assumed(self, recording: Recording) -> bool:
        """Return whether the noise of some press is assumed, because it is not stated."""
        known = self.mm is not None or recording.unloaded is not None
        presses = [press for press in recording.presses if press.data.any()]
        return not known and any(press.noise_mm is None for press in presses)

    def floored(self, recording: Recording) -> bool:
        """Return whether the noise of some press may be smaller than its deviation."""
        floor = self.relative * signal_rms(recording.presses)
        pairs = zip(self._known(recording, floor), recording.presses, strict=True)
        return any(known <= floor for known, press in pairs if press.data.any())

    def _known(self, recording: Recording, floor: float) -> list[float]:
        """Deviation of each press before the floor, mm."""
        if self.mm is not None:
            return [self.mm] * len(recording.presses)
        default = floor
        if recording.unloaded is not None:  # robust to a slow drift and to marker outliers
            changes = np.abs(np.diff(recording.unloaded, axis=0))
            default = float(np.nanmedian(changes)) / (NORMAL_MEDIAN * np.sqrt(2.0))
        return [default if p.noise_mm is None else p.noise_mm for p in recording.presses]


def signal_rms(presses: tuple[Press, ...]) -> float:
    """Return the root mean square of all observed displacements, mm; refuse zero."""
    values = np.concatenate([press.displacement[press.data] for press in presses])
    if not len(values):  # other readings have deviations of their instruments
        return 0.0
    rms = float(np.sqrt(np.mean(values**2)))
    if rms == 0.0:
        raise ConfigError("all observed displacements are zero: the presses moved nothing.")
    return rms


_ORTHOGONAL = 1e-9  # largest product of patterns that are orthogonal, over their squares


class CorrelatedNoise:
    """Errors common to several data: patterns of unknown size on top of white noise.

    It whitens residuals whose covariance is the unit matrix plus B B^T, and that of further errors.
    B has few columns, each the pattern of an error of unit standard deviation, in standard
    deviations of the white noise. With B^T B = V S^2 V^T and T = 1 + S^2 the symmetric root of the
    inverse is 1 - B V (T + T^(1/2))^(-1) V^T B^T. B may be sparse.

    Args:
        patterns: B.
        further: Further errors. The residuals that they whiten are whitened by the root for their
            whitened B, so that patterns of one press each, which are many, remain sparse.
    """

    def __init__(
        self,
        patterns: Float[np.ndarray, "data k"] | sp.spmatrix,
        further: "CorrelatedNoise | None" = None,
    ) -> None:
        self.patterns, self._further = patterns, further

    @cached_property
    def _whitened(self) -> Float[np.ndarray, "data k"] | sp.spmatrix:
        if self._further is None:
            return self.patterns
        return self._further.whiten(_dense(self.patterns))

    @cached_property
    def _modes(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"] | sp.spmatrix]:
        """Eigenvalues T, and V."""
        products = self._whitened.T @ self._whitened
        if sp.issparse(products) and products.nnz:
            squares = products.diagonal()
            if abs(products - sp.diags(squares)).max() <= _ORTHOGONAL * squares.max():
                return 1.0 + squares, sp.identity(len(squares), format="csr")
        squares, vectors = np.linalg.eigh(_dense(products))
        return 1.0 + np.maximum(squares, 0.0), vectors

    @cached_property
    def _loss(self) -> Float[np.ndarray, "k k"] | sp.spmatrix:
        variances, vectors = self._modes
        weights = 1.0 / (variances + np.sqrt(variances))
        return sp.diags(weights) if sp.issparse(vectors) else (vectors * weights) @ vectors.T

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of the residuals."""
        further = 0.0 if self._further is None else self._further.log_determinant
        return further + float(np.log(self._modes[0]).sum())

    def widened(self, factors: Float[np.ndarray, " data"]) -> "CorrelatedNoise":
        """Return the same errors relative to white noise that is `factors` times as large."""
        further = None if self._further is None else self._further.widened(factors)
        return CorrelatedNoise(sp.diags(1.0 / factors) @ self.patterns, further)

    def whiten(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return whitened residuals or their derivatives."""
        return self._own(values if self._further is None else self._further.whiten(values))

    def transposed(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return the transpose of the whitening times values."""
        values = self._own(values)
        return values if self._further is None else self._further.transposed(values)

    def _own(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return the root for the own patterns times values; it is symmetric."""
        patterns = self._whitened
        if values.ndim == 1 and isinstance(patterns, np.ndarray):
            # Not by BLAS: see `tactorch.linalg.dense`.
            inner = np.einsum("kl,l->k", self._loss, np.einsum("dl,d->l", patterns, values))
            return values - np.einsum("dk,k->d", patterns, inner)
        return values - patterns @ (self._loss @ (patterns.T @ values))


def _dense(matrix: np.ndarray | sp.spmatrix) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


@dataclass(frozen=True, eq=False)
class Observation:
    """Data of one press: displacements of nodes, then its other readings.

    Attributes:
        index: Observed degrees of freedom, 3 node + axis.
        values: Displacements (mm) of these, then those along directions at points of the surface,
            then components of force (N) and moment (N mm).
        scale: Weight over standard deviation, 1 over the unit of each.
        force: Components of force and moment, or None.
    """

    index: Int[np.ndarray, " p"]
    values: Float[np.ndarray, " data"]
    scale: Float[np.ndarray, " data"]
    force: ForceReading | None = None

    @staticmethod
    def of(press: Press, deviation: float) -> "Observation":
        """Return the data of a press whose nodal displacements have this deviation, mm."""
        weights = np.ones_like(press.forces) if press.weights is None else press.weights
        # Data of zero weight are excluded: they would lower the mean squared residual.
        index = np.flatnonzero(press.data & (weights > 0))
        values, scales = [press.displacement.ravel()[index]], [weights.ravel()[index] / deviation]
        if press.surface is not None:
            values.append(press.surface.displacement_mm)
            scales.append(1.0 / press.surface.deviations_mm)
        if press.force is not None:
            values.append(press.force.values)
            scales.append(1.0 / press.force.deviations)
        return Observation(index, np.concatenate(values), np.concatenate(scales), press.force)

    @property
    def units(self) -> tuple[slice, slice]:
        """Data that are displacements (mm), and forces and moments (N, N mm)."""
        count = len(self.values) - (0 if self.force is None else len(self.force.values))
        return slice(count), slice(count, len(self.values))

    @property
    def nodal(self) -> slice:
        """Data that are displacements of nodes."""
        return slice(len(self.index))


@dataclass(frozen=True, eq=False)
class DataModel:
    """Observations of all presses with the statistics of their errors; immutable."""

    observations: tuple[Observation, ...]
    misfit: Misfit = field(default_factory=Squares)
    correlated: CorrelatedNoise | None = None  # errors that the data have in common
    # Deviation of the remaining error of a corrected model, one per press, mm.
    model_deviation: tuple[float, ...] | None = None
    noise_fraction: float = 1.0  # of the data's variance; the rest is error of the model

    @cached_property
    def counts(self) -> list[int]:
        """Number of data of each press."""
        return [len(observation.values) for observation in self.observations]

    @cached_property
    def begins(self) -> Int[np.ndarray, " presses"]:
        """Index of the first datum of each press."""
        return np.cumsum([0, *self.counts[:-1]])

    @cached_property
    def values(self) -> Float[np.ndarray, " data"]:
        """All data, in their units."""
        return np.concatenate([observation.values for observation in self.observations])

    @cached_property
    def scale(self) -> Float[np.ndarray, " data"]:
        """Weight over standard deviation of all data, 1 over the unit of each."""
        return np.concatenate([observation.scale for observation in self.observations])

    def whiten(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return data in standard deviations of each, or derivatives, in independent ones."""
        return values if self.correlated is None else self.correlated.whiten(values)

    def transposed(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return the transpose of `whiten` times values."""
        return values if self.correlated is None else self.correlated.transposed(values)

    def widened(self, factors: Float[np.ndarray, " presses"]) -> "DataModel":
        """Return the data with the standard deviations of presses multiplied by factors."""
        observations = tuple(
            replace(observation, scale=observation.scale / factor)
            for observation, factor in zip(self.observations, factors, strict=True)
        )
        correlated = self.correlated
        if correlated is not None:  # the error of the model remains as large
            correlated = correlated.widened(np.repeat(factors, self.counts))
        return replace(self, observations=observations, correlated=correlated)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance, relative to that of white noise."""
        return 0.0 if self.correlated is None else self.correlated.log_determinant

    def with_errors(self, patterns: Float[np.ndarray, "data k"] | sp.spmatrix) -> "DataModel":
        """Return the data with further errors that they have in common.

        Each column is the pattern of an error of unit standard deviation, in standard deviations
        of the white noise.
        """
        return replace(self, correlated=CorrelatedNoise(patterns, self.correlated))

    def shifted(self, offsets: Sequence[Float[np.ndarray, " p"]]) -> "DataModel":
        """Return the data of each press with offsets added, mm or N."""
        pairs = zip(self.observations, offsets, strict=True)
        observations = tuple(replace(o, values=o.values + x) for o, x in pairs)
        return replace(self, observations=observations)


def group_by_contact(presses: Sequence[Press]) -> list[tuple[int, ...]]:
    """Return the numbers of the presses of each contact.

    Presses of one contact have the same supports, the same observed degrees of freedom, and forces
    and prescribed displacements that differ by a factor only.
    """
    contacts: dict[tuple[bytes, ...], list[int]] = {}
    for i, press in enumerate(presses):
        loads = [_direction(press.forces), _direction(press.prescribed)]
        values = (*loads, press.fixed, press.springs, Observation.of(press, 1.0).index)
        key = (*(array.tobytes() for array in values), press.geometry_bytes())
        contacts.setdefault(key, []).append(i)
    return [tuple(numbers) for numbers in contacts.values()]


def _direction(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    size = float(np.linalg.norm(values))
    return np.round(values / (size or 1.0), 6) + 0.0  # no negative zeros
