"""An error of the measurement: what it changes of the data, and how large it may be."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.inverse.forward.problem import Columns, Evaluation, InverseProblem
from tactorch.recording import Press, Recording
from tactorch.recording.append import digest

# Norm of a change of the data that is left out, in standard deviations: it would widen the noise in
# its direction by 4 %.
LEAST_CHANGE = 0.3

#: Standard deviation of each error, in its own unit, by name; others are zero.
Levels: TypeAlias = Mapping[str, float]
Key: TypeAlias = tuple[str, ...]


class RimError(NamedTuple):
    """Predictions of a mesh that is finer at a rim, less those of the common mesh."""

    log_youngs: Float[np.ndarray, " nodes"]  # log MPa at the loaded nodes, of the model then
    changes: tuple[Float[np.ndarray, " _"], ...]  # of the data of some presses of the contact, mm


@dataclass(frozen=True, eq=False)
class KeptRims:
    """What a search computes once for each contact with a rim.

    It serves one object, with one material, element type and supports.

    Attributes:
        errors: Errors of the discretisation, by presses.
        responses: Changes of the data (mm) of each press of a contact by errors of the traction at
            each edge of the rim, by presses. They are those of the first model that had these
            presses: their amplitude is one of a few levels anyway.
    """

    errors: dict[Key, RimError] = field(default_factory=dict)
    responses: dict[Key, list[Float[np.ndarray, "_ edges"]]] = field(default_factory=dict)


def press_key(recording: Recording, presses: list[Press]) -> Key:
    """Return what identifies presses on a mesh."""
    return recording.mesh.content_hash(), *(digest(press) for press in presses)


@dataclass(frozen=True, eq=False)
class MeasuredPresses:
    """Presses whose errors are linearised."""

    problem: InverseProblem  # whose data have white noise
    contacts: Sequence[tuple[int, ...]] = ()  # numbers of the presses of each
    linearised: Evaluation | None = None  # predictions about which errors are linearised
    #: Corrections of the discretisation that the data contain.
    corrections_mm: Sequence[Float[np.ndarray, " _"]] | None = None
    #: Presses of each contact whose traction is uncertain where it ends, and the nodes there.
    rims: Sequence[tuple[tuple[int, ...], Int[np.ndarray, " _"]]] = ()
    at_edge: bool = False  # whether a sensor's contact ends at an edge of the body
    kept: KeptRims = field(default_factory=KeptRims)  # what searches on further presses reuse
    #: Derivatives of the data (mm, N or N mm) by the log-modulus of each element of a uniform body.
    log_rates: Float[np.ndarray, "data elements"] | None = None

    @property
    def evaluation(self) -> Evaluation:
        """The predictions about which errors are linearised."""
        assert self.linearised is not None
        return self.linearised

    def joined(self, parts: Iterable[Mapping[int, Float[np.ndarray, "_ _"]]]) -> Columns:
        """Return columns of the first data of some presses, several times, as those of all data."""
        columns = [np.zeros((sum(self.problem.data.counts), 0))]
        for part in filter(None, parts):
            width = next(iter(part.values())).shape[1]
            blocks = [np.zeros((rows, width)) for rows in self.problem.data.counts]
            for press, values in part.items():
                blocks[press][: len(values)] = values
            columns.append(np.vstack(blocks))
        return np.hstack(columns)


class ErrorSource(ABC):
    """An error of unknown size that data have in common.

    Attributes:
        name: Its name in `Levels`.
        levels: Deviations that a search for inclusions tries, beside the least one.
        elements: Elements of the predictions about which a search linearises it: "linear", once,
            about the first model; "quadratic", about each model at which predictions are corrected;
            or none.
        outlasts: Mean change of log-moduli below which a linearisation is kept.
        proposal: Description of a model with another deviation.
        note: What a deviation means for the result, and what to check.
        noted: Smallest deviation with a note.
        smallest: Norm of patterns that are left out, in standard deviations.
    """

    name: str
    levels: ClassVar[tuple[float, ...]] = ()
    elements = proposal = note = ""
    outlasts: ClassVar[float] = 0.0
    noted: ClassVar[float] = 1e-9
    smallest: ClassVar[float] = 0.0
    is_nonlinear: ClassVar[bool] = False  # whether it has `nonlinear_changes`
    is_general: ClassVar[bool] = False  # whether it explains any smooth change of the data

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return the least deviation, that of the simplest model; None where there is no error."""
        return 0.0

    @abstractmethod
    def patterns(self, presses: MeasuredPresses) -> Columns | sp.csr_matrix:
        """Return changes of the data by independent errors of unit deviation, (data, k).

        They are sparse where each changes one press only and there are many. The unit is the
        standard deviation of the white noise.
        """

    def nonlinear_changes(
        self, presses: MeasuredPresses, amplitudes: Float[np.ndarray, " k"]
    ) -> dict[int, Float[np.ndarray, " _"]]:
        """Return the changes of the data of presses, by number, that errors as large make, mm.

        Those of others are linear: the patterns times amplitudes.
        """
        return {}

    def sentence(self, level: float) -> str:
        """Return the note for a deviation, or nothing."""
        return self.note.format(level) if level >= self.noted else ""


class ContactMotion(ErrorSource):
    """Errors of the displacements of each contact, over the displacements observed there.

    The presses of a contact have them in common: they grow with the displacements, or where that is
    not proportional, with their square over the size of the contact too.
    """

    is_proportional: ClassVar[bool] = True

    @abstractmethod
    def fields(
        self, points: Float[np.ndarray, "data 3"], axes: Float[np.ndarray, "data 3"]
    ) -> Float[np.ndarray, "data k"]:
        """Return independent errors of displacements observed at points (mm) along axes.

        Their unit is the root mean square of the displacements.
        """

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        """Return changes of the data by independent errors, (data, k), see `ErrorSource`."""
        points = presses.problem.recording.mesh.points
        observations = presses.problem.data.observations
        patterns = []
        for contact in presses.contacts:
            index = observations[contact[0]].index
            if not len(index):
                continue
            places = points[index // 3]
            fields, parts = self.fields(places, np.eye(3)[index % 3]), {}
            extent = np.sqrt(places.var(axis=0).sum())
            for i in contact:
                nodal, values = observations[i].nodal, observations[i].values
                size = np.linalg.norm(values[nodal]) / np.sqrt(len(index))
                parts[i] = size * observations[i].scale[nodal, None] * fields
                if not self.is_proportional and len(contact) > 1:
                    parts[i] = np.hstack([parts[i], size / extent * parts[i]])
            patterns.append(parts)
        return presses.joined(patterns)


def principal(columns: Columns, smallest: float) -> Float[np.ndarray, "data q"]:
    """Return orthogonal columns of the same covariance, of norms above `smallest`."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > smallest
    return basis[:, kept] * sizes[kept]
