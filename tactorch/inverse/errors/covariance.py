"""The covariance of the data: white noise, and errors that the data have in common."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors.base import ErrorSource, Levels, MeasuredPresses
from tactorch.inverse.forward.problem import Evaluation


class ErrorModel:
    """Errors of the data at any deviations.

    Attributes:
        presses: The presses.
        errors: Those of the given errors that can occur in these presses.
        least: Their deviations in the simplest model.
    """

    def __init__(self, presses: MeasuredPresses, errors: Iterable[ErrorSource]) -> None:
        least = {error: error.least(presses) for error in errors}
        self.presses = presses
        self.errors = tuple(error for error, level in least.items() if level is not None)
        self.least: Levels = {error.name: level for error, level in least.items() if level}
        self._data: dict[frozenset[tuple[str, float]], DataModel] = {}
        self._patterns = {e.name: e.patterns(presses) for e in self.errors if not e.elements}
        self._about: dict[str, Float[np.ndarray, " m"]] = {}  # log-moduli of linearisations

    def linearise(self, evaluation: Evaluation, *elements: str) -> None:
        """Compute the changes of the data by errors that need predictions of these elements."""
        presses = replace(self.presses, linearised=evaluation)
        youngs = evaluation.youngs.reshape(len(evaluation.youngs), -1)
        log, volumes = np.log(youngs).mean(axis=1), presses.problem.recording.mesh.volumes
        for error in self.errors:
            if error.elements not in elements:
                continue
            last = self._about.get(error.name)
            if last is None or np.average(np.abs(log - last), weights=volumes) >= error.outlasts:
                self._patterns[error.name] = error.patterns(presses)
                self._about[error.name] = log
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

    def remainders(self, levels: Levels, evaluation: Evaluation) -> list[Float[np.ndarray, " _"]]:
        """Return what the most likely errors change of the data beyond their patterns, mm."""
        presses, data = replace(self.presses, linearised=evaluation), self.data(levels)
        white = evaluation.with_data(replace(presses.problem.data, correlated=None)).residuals
        weights, ends = data.transposed(data.whiten(white)), data.begins[1:]
        total = [np.zeros(count) for count in data.counts]
        for error in self.errors:
            if error.is_nonlinear and (level := levels.get(error.name)):
                amplitudes = -(level**2) * (self._patterns[error.name].T @ weights)
                linear = np.split(self._patterns[error.name] @ amplitudes / data.scale, ends)
                for i, change in error.nonlinear_changes(presses, amplitudes).items():
                    total[i] += change - linear[i]
        return total

    def differs(self, levels: Levels, other: Levels) -> bool:
        """Return whether deviations of errors with remainders differ."""
        names = [error.name for error in self.errors if error.is_nonlinear]
        return any(levels.get(name) != other.get(name) for name in names)

    def corrected(self, corrections_mm: Sequence[Float[np.ndarray, " _"]]) -> "ErrorModel":
        """Return the errors of data with other corrections of the discretisation, mm."""
        presses = self.presses
        assert presses.corrections_mm is not None
        pairs = zip(presses.corrections_mm, corrections_mm, strict=True)
        data = presses.problem.data.shifted([old - new for old, new in pairs])
        problem = presses.problem.with_data(data)
        presses = replace(presses, problem=problem, corrections_mm=corrections_mm)
        other = ErrorModel(presses, self.errors)
        other._patterns = self._patterns | other._patterns
        other._about = dict(self._about)
        return other

    def at_least(self, levels: Levels) -> Levels:
        """Return deviations of the errors that occur, no smaller than the least ones."""
        names = [error.name for error in self.errors]
        highest = {k: max(levels.get(k, 0.0), self.least.get(k, 0.0)) for k in names}
        return {name: level for name, level in highest.items() if level}

    def specific(self, levels: Levels) -> Levels:
        """Return deviations but for those of general errors, which explain any smooth change."""
        general = [error.name for error in self.errors if error.is_general]
        return {name: level for name, level in levels.items() if name not in general}

    def doubts(self, levels: Levels) -> list[Levels]:
        """Return deviations of which that of one general error is larger."""
        return [
            {**levels, error.name: level}
            for error in self.errors
            for level in error.levels
            if error.is_general and level > levels.get(error.name, 0.0)
        ]

    def others(self, levels: Levels) -> Iterator[tuple[str, Levels]]:
        """Yield deviations that differ in one respect, at least the least, with descriptions."""
        for error in self.errors:
            least, present = self.least.get(error.name, 0.0), levels.get(error.name, 0.0)
            for level in (least, *error.levels):
                if level >= least and level != present:
                    rest = {name: x for name, x in levels.items() if name != error.name}
                    changed = {**rest, error.name: level} if level else rest
                    yield error.proposal.format(level), changed
