"""What watches an optimizer: history, progress, checkpoints, and reasons to stop."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError
from tactorch.files import read_arrays, write_arrays
from tactorch.inverse.objective import Point

_log = logging.getLogger(__name__)
_PERIOD = 1.0  # seconds between checkpoints at most: what a kill may cost


class StopOptimization(Exception):  # noqa: N818  (a signal, not an error)
    """The time limit was reached; the monitor holds the best map so far."""


@dataclass
class Monitor:
    """Keeps the best map and its history; optimizers report every accepted iterate.

    Attributes:
        max_seconds: Time limit.
        checkpoint: File to save the state to, or None.
        on_record: Called with each record of the history (a progress bar, say).
        on_iteration: Called with each record and its map, MPa.
        enough: Asked after each record, with all of them, whether to end there.
        history: Per iteration: iteration, evaluations, seconds, misfit (mm^2, eq. 7), chi2 (mean
            squared residual in standard deviations), objective, weight of the prior, step
            (largest change of a parameter), damping.
        state: The optimizer's own numbers, for resuming.
        identity: What a checkpoint must agree in to be resumed: name and value.
        task: All that decides the result; a run of the same task that had ended has nothing to do.
        ended: Why such a run ended; empty where there is something to do.
    """

    max_seconds: float | None = None
    checkpoint: Path | None = None
    on_record: Callable[[dict[str, Any]], None] | None = None
    on_iteration: Callable[[dict[str, Any], np.ndarray], None] | None = None
    stop_condition: Callable[[list[dict[str, Any]]], bool] | None = None
    history: list[dict[str, Any]] = field(default_factory=list)
    state: dict[str, float] = field(default_factory=dict)
    identity: dict[str, str] = field(default_factory=dict)
    task: str = ""
    ended: str = ""
    best: Float[np.ndarray, " m"] | None = None
    point: Point | None = None
    _began: float = field(default_factory=time.perf_counter)
    _spent: float = 0.0
    _saved: float = 0.0

    @property
    def seconds(self) -> float:
        """Time spent, earlier runs of a resumed inversion included."""
        return self._spent + time.perf_counter() - self._began

    @property
    def iteration(self) -> int:
        """Iterations so far."""
        return self.history[-1]["iteration"] if self.history else 0

    @property
    def evaluations(self) -> int:
        """Evaluations of all presses up to the last record."""
        return self.history[-1]["evaluations"] if self.history else 0

    def accept(self, point: Point, **record: float) -> None:
        """Take `point` as the best so far.

        Raises:
            StopOptimization: the time limit is reached, or this was enough.
        """
        self.keep(point, **record)
        self.check_time()
        if self.stop_condition is not None and self.stop_condition(self.history):
            raise StopOptimization

    def keep(self, point: Point, **record: float) -> None:
        """Take `point` as the best so far, in time or not."""
        self.best, self.point = point.x, point
        entry = {
            "iteration": len(self.history),
            "evaluations": point.objective.problem.evaluations,
            "seconds": self.seconds,
            "misfit": point.evaluation.misfit_mm2,
            "chi2": point.evaluation.chi2,
            **record,
        }
        self.history.append(entry)
        _log.info("%s", describe(entry))
        if self.on_record is not None:
            self.on_record(entry)
        if self.on_iteration is not None:
            self.on_iteration(dict(entry), point.youngs.copy())
        if time.perf_counter() - self._saved > _PERIOD:
            self.save()

    def check_time(self) -> None:
        """Raise `StopOptimization` if the time limit is reached."""
        if self.max_seconds is not None and self.seconds > self.max_seconds:
            raise StopOptimization

    def save(self) -> None:
        """Write the checkpoint; a killed process leaves the previous one whole."""
        self._saved = time.perf_counter()
        if self.checkpoint is None or self.best is None:
            return
        names = sorted({key for entry in self.history for key in entry})
        table = [[entry.get(name, np.nan) for name in names] for entry in self.history]
        content = {
            "x": self.best,
            "seconds": self.seconds,
            "history": np.array(table, dtype=np.float64),
            "history_names": np.array(names),
            "state": np.array(list(self.state.values()), dtype=np.float64),
            "state_names": np.array(list(self.state), dtype=str),
            "identity": np.array(list(self.identity.values()), dtype=str),
            "identity_names": np.array(list(self.identity), dtype=str),
            "task": self.task,
            "ended": self.ended,
        }
        write_arrays(self.checkpoint, content)

    def restore(self, path: Path, size: int) -> None:
        """Continue from a checkpoint.

        Raises:
            FileError: it is missing, unreadable, or of another problem.
        """
        remedy = "start anew without resume."
        source, saved = Path(path), read_arrays(path, "checkpoint", remedy)
        try:
            table, names = saved["history"], saved["history_names"]
            self.history = [_entry(names, row) for row in table]
            self.state = _dict(saved, "state")
            identity = _dict(saved, "identity")
            self.best, self._spent = saved["x"], float(saved["seconds"])
            if str(saved.get("task")) == self.task:
                self.ended = str(saved["ended"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FileError(f"checkpoint '{source}' cannot be read ({error}); {remedy}") from error
        if self.best.shape != (size,):
            raise FileError(
                f"checkpoint '{source}' is for {self.best.size} moduli but the recording has "
                f"{size}: it belongs to another mesh. Start anew without resume."
            )
        for name, value in self.identity.items():
            if identity.get(name) != value:
                raise FileError(
                    f"checkpoint '{source}' belongs to another {name}: {identity.get(name)}, not "
                    f"{value}. Resume with the {name} that it was made with, or start anew without "
                    "resume."
                )


def _dict(saved: dict[str, np.ndarray], name: str) -> dict[str, Any]:
    return dict(zip(saved[f"{name}_names"].tolist(), saved[name].tolist(), strict=True))


def _entry(names: np.ndarray, row: np.ndarray) -> dict[str, Any]:
    whole = ("iteration", "evaluations")
    values = zip(names.tolist(), row.tolist(), strict=True)
    return {k: int(v) if k in whole else v for k, v in values if not np.isnan(v)}


def describe(entry: dict[str, Any]) -> str:
    """One line of text about an iteration."""
    parts = [
        f"iteration {entry['iteration']:>4}",
        f"{entry['seconds']:7.1f} s",
        f"misfit {entry['misfit']:.4e} mm2",
        f"chi2 {entry['chi2']:.3e}",
    ]
    parts += [f"{key} {entry[key]:.2g}" for key in ("weight", "step") if key in entry]
    return "  ".join(parts)
