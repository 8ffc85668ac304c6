"""Monitor of an optimizer: history, progress line, checkpoints, and reasons to stop."""

import json
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError, FileError
from tactorch.files import read_arrays, write_arrays
from tactorch.inverse.data.plain import to_plain
from tactorch.inverse.fit.objective import Point

_log = logging.getLogger(__name__)
_CHECKPOINT_PERIOD = 1.0  # s: loss if the process is killed


class StopReason(StrEnum):
    """Reason for the end of an optimization; the value is the text for messages and files."""

    FITTED = "the data are fitted to their noise"
    NOT_FITTED = (
        "the prior is exhausted and the data are not fitted to their noise: the noise is larger "
        "than stated, or the model is wrong"
    )
    WEIGHT_CHOSEN = "the weight of the prior has converged"
    CONVERGED = "the objective no longer falls"
    NO_DESCENT = "no step lowers the objective any more"
    LOCAL_MINIMUM = "a local minimum"
    STALLED = "the parameters no longer move"
    LINE_SEARCH_FAILED = "the line search failed"
    NO_DERIVATIVES = "no derivatives at the best map"
    ITERATION_LIMIT = "iteration limit reached"
    EVALUATION_LIMIT = "evaluation limit reached"
    TIME_LIMIT = "time limit reached"
    STOPPED = "stopped on request"
    INTERRUPTED = "interrupted"

    @property
    def is_limit(self) -> bool:
        """Whether a limit or a request ended the optimization, so that it can continue."""
        return self.name in (
            "ITERATION_LIMIT", "EVALUATION_LIMIT", "TIME_LIMIT", "STOPPED", "INTERRUPTED",
        )  # fmt: skip


StopCondition: TypeAlias = Callable[[list[dict[str, Any]]], StopReason | None]


class StopOptimization(Exception):  # noqa: N818  (a signal, not an error)
    """An optimization is to stop for a reason; the monitor holds the best map so far."""

    def __init__(self, reason: StopReason = StopReason.TIME_LIMIT) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass
class Monitor:
    """Holds the best map and its history; optimizers report every accepted iterate.

    As a context manager it turns limits, interruptions, and a best map without derivatives into the
    `reason` for the end:

        with monitor:
            monitor.reason = optimizer.minimize(objective, start, monitor)

    Attributes:
        max_seconds: Time limit.
        checkpoint: File to save the state to, or None.
        on_record: Called with each record of the history (for a progress bar).
        on_iteration: Called with each record and its map, MPa.
        stop_condition: Called after each record with all records; returns a reason to stop there,
            or None.
        log: Whether iterations are logged.
        history: Per iteration: iteration, evaluations, seconds, misfit (mm^2, eq. 7), chi2 (mean
            squared residual in standard deviations), objective, weight of the prior, step
            (largest change of a parameter), damping.
        state: Numbers of the optimizer to resume from.
        identity: Names and values that a checkpoint must share to be resumed.
        task: Digest of everything that decides the result; a finished run of the same task is not
            continued.
        ended: Reason for the end of a finished run; None where it can continue.
        reason: Reason for the end of this run.
        best: Best parameters so far.
        point: Point of the objective there; None where they come from a checkpoint.
    """

    max_seconds: float | None = None
    checkpoint: Path | None = None
    on_record: Callable[[dict[str, Any]], None] | None = None
    on_iteration: Callable[[dict[str, Any], np.ndarray], None] | None = None
    stop_condition: StopCondition | None = None
    log: bool = True
    history: list[dict[str, Any]] = field(default_factory=list)
    state: dict[str, float] = field(default_factory=dict)
    identity: dict[str, str] = field(default_factory=dict)
    task: str = ""
    ended: str | None = None
    reason: StopReason | None = None
    best: Float[np.ndarray, " m"] | None = None
    point: Point | None = None
    _began: float = field(default_factory=time.perf_counter)
    _earlier_seconds: float = 0.0
    _saved: float = 0.0

    def __enter__(self) -> "Monitor":
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> bool:
        if isinstance(error, StopOptimization):
            self.reason = error.reason
        elif isinstance(error, KeyboardInterrupt) and self.best is not None:
            self.reason = StopReason.INTERRUPTED
        elif isinstance(error, ConvergenceError) and self.point is not None:
            # An unstable equilibrium has no derivatives.
            _log.warning("No derivatives at the best map: %s", error)
            self.reason = StopReason.NO_DERIVATIVES
        else:
            return False
        return True

    @property
    def seconds(self) -> float:
        """Elapsed time, s, including earlier runs of a resumed inversion."""
        return self._earlier_seconds + time.perf_counter() - self._began

    @property
    def iteration(self) -> int:
        """Iterations so far."""
        return self.history[-1]["iteration"] if self.history else 0

    @property
    def evaluations(self) -> int:
        """Evaluations of all presses up to the last record."""
        return self.history[-1]["evaluations"] if self.history else 0

    def accept(self, point: Point, **record: float) -> None:
        """Take `point` as the best so far; raise `StopOptimization` at a limit or condition."""
        self.keep(point, **record)
        self.check_time()
        if self.stop_condition is not None and (reason := self.stop_condition(self.history)):
            raise StopOptimization(reason)

    def keep(self, point: Point, **record: float) -> None:
        """Take `point` as the best so far, regardless of the time limit."""
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
        if self.log:
            _log.info("%s", describe(entry))
        if self.on_record is not None:
            self.on_record(entry)
        if self.on_iteration is not None:
            self.on_iteration(dict(entry), point.youngs.copy())
        if time.perf_counter() - self._saved > _CHECKPOINT_PERIOD:
            self.save()

    def check_time(self) -> None:
        """Raise `StopOptimization` if the time limit is reached."""
        if self.max_seconds is not None and self.seconds > self.max_seconds:
            raise StopOptimization(StopReason.TIME_LIMIT)

    def save(self) -> None:
        """Write the checkpoint atomically."""
        self._saved = time.perf_counter()
        if self.checkpoint is None or self.best is None:
            return
        names = ("seconds", "history", "state", "identity", "task", "ended")
        run = {name: to_plain(getattr(self, name)) for name in names}
        write_arrays(self.checkpoint, {"x": self.best, "run": json.dumps(run)})

    def restore(self, path: Path, size: int) -> None:
        """Continue from a checkpoint of the same problem, with this number of parameters."""
        remedy = "start again without resume."
        saved = read_arrays(path, "checkpoint", remedy)
        try:
            run = json.loads(str(saved["run"]))
            self.history, self.state, identity = run["history"], run["state"], run["identity"]
            self.best, self._earlier_seconds = saved["x"], float(run["seconds"])
            if run["task"] == self.task:
                self.ended = run["ended"]
        except (ValueError, KeyError, TypeError) as error:
            raise FileError(f"checkpoint '{path}' cannot be read ({error}); {remedy}") from error
        if self.best.shape != (size,):
            raise FileError(
                f"checkpoint '{path}' is for {self.best.size} moduli but the recording has "
                f"{size}: it belongs to another mesh. Start again without resume."
            )
        for name, value in self.identity.items():
            if identity.get(name) != value:
                raise FileError(
                    f"checkpoint '{path}' belongs to another {name}: {identity.get(name)}, not "
                    f"{value}. Resume with the same {name}, or start again without resume."
                )


def describe(entry: dict[str, Any]) -> str:
    """Return a line of text about an iteration."""
    text = "iteration {iteration:>4}  {seconds:7.1f} s  misfit {misfit:.4e} mm2  chi2 {chi2:.3e}"
    parts = [f"  {key} {entry[key]:.2g}" for key in ("weight", "step") if key in entry]
    return text.format(**entry) + "".join(parts)
