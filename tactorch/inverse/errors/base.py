"""Errors of the measurement: what each changes of the data, and the covariance that follows."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeAlias

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors.kept import KeptRims
from tactorch.inverse.forward.problem import Columns, Evaluation, InverseProblem

# Norm of a change of the data that is left out, in standard deviations: it would widen the noise in
# its direction by 4 %.
LEAST_CHANGE = 0.3

#: Standard deviation of each error, in its own unit, by name; others are zero.
Levels: TypeAlias = Mapping[str, float]


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
        proposal: Description of a model with another deviation.
        note: What a deviation means for the result, and what to check.
        noted: Smallest deviation with a note.
        smallest: Norm of patterns that are left out, in standard deviations.
        on_request: Whether only a search that is given its name takes it into account.
    """

    name: str
    levels: ClassVar[tuple[float, ...]] = ()
    elements = proposal = note = ""
    noted: ClassVar[float] = 1e-9
    smallest, on_request = 0.0, False

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return the least deviation, that of the simplest model; None where there is no error."""
        return 0.0

    @abstractmethod
    def patterns(self, presses: MeasuredPresses) -> Columns | sp.csr_matrix:
        """Return changes of the data by independent errors of unit deviation, (data, k).

        They are sparse where each changes one press only and there are many. The unit is the
        standard deviation of the white noise.
        """

    def sentence(self, level: float) -> str:
        """Return the note for a deviation, or nothing."""
        return self.note.format(level) if level >= self.noted else ""


def principal(columns: Columns, smallest: float) -> Float[np.ndarray, "data q"]:
    """Return orthogonal columns of the same covariance, of norms above `smallest`."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > smallest
    return basis[:, kept] * sizes[kept]


class ErrorModel:
    """Errors of the data at any deviations.

    Args:
        presses: The presses.
        errors: Errors that may occur.
        requested: Names of those that are taken into account on request.

    Attributes:
        errors: Errors that occur.
        least: Their deviations in the simplest model.
    """

    def __init__(
        self,
        presses: MeasuredPresses,
        errors: Iterable[ErrorSource],
        requested: Collection[str] = (),
    ) -> None:
        counted = [error for error in errors if not error.on_request or error.name in requested]
        least = {error: error.least(presses) for error in counted}
        self.presses = presses
        self.errors = tuple(error for error, level in least.items() if level is not None)
        self.least: Levels = {error.name: level for error, level in least.items() if level}
        self._data: dict[frozenset[tuple[str, float]], DataModel] = {}
        self._patterns = {e.name: e.patterns(presses) for e in self.errors if not e.elements}

    def linearise(self, evaluation: Evaluation, *elements: str) -> None:
        """Compute the changes of the data by errors that need predictions of these elements."""
        presses = replace(self.presses, linearised=evaluation)
        for error in self.errors:
            if error.elements in elements:
                self._patterns[error.name] = error.patterns(presses)
        self._data.clear()

    def lacks(self, levels: Levels) -> bool:
        """Return whether an error of these was not linearised."""
        return any(level and name not in self._patterns for name, level in levels.items())

    def data(self, levels: Levels) -> DataModel:
        """Return the data with errors of these deviations, whose covariance is computed once."""
        key = frozenset(levels.items())
        if key not in self._data:
            data = self.presses.problem.data
            used = [error.name for error in self.errors if levels.get(error.name)]
            # Sparse patterns remain so where they are the first.
            for name in sorted(used, key=lambda name: not sp.issparse(self._patterns[name])):
                data = data.with_errors(levels[name] * self._patterns[name])
            self._data[key] = data
        return self._data[key]

    def corrected(self, corrections_mm: Sequence[Float[np.ndarray, " _"]]) -> "ErrorModel":
        """Return the errors of data with other corrections of the discretisation, mm."""
        presses = self.presses
        assert presses.corrections_mm is not None
        pairs = zip(presses.corrections_mm, corrections_mm, strict=True)
        data = presses.problem.data.shifted([old - new for old, new in pairs])
        problem = presses.problem.with_data(data)
        presses = replace(presses, problem=problem, corrections_mm=corrections_mm)
        other = ErrorModel(presses, self.errors, [error.name for error in self.errors])
        other._patterns = self._patterns | other._patterns
        return other

    def at_least(self, levels: Levels) -> Levels:
        """Return deviations of the errors that occur, no smaller than the least ones."""
        names = [error.name for error in self.errors]
        highest = {k: max(levels.get(k, 0.0), self.least.get(k, 0.0)) for k in names}
        return {name: level for name, level in highest.items() if level}

    def others(self, levels: Levels) -> Iterator[tuple[str, Levels]]:
        """Yield deviations that differ in one respect, at least the least, with descriptions."""
        for error in self.errors:
            least, present = self.least.get(error.name, 0.0), levels.get(error.name, 0.0)
            for level in (least, *error.levels):
                if level >= least and level != present:
                    rest = {name: x for name, x in levels.items() if name != error.name}
                    changed = {**rest, error.name: level} if level else rest
                    yield error.proposal.format(level), changed
