"""Inversion that records the similarity to the truth at each iteration and can be resumed."""

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactorch.inverse import InverseProblem, Reconstruction, Settings, StopReason, invert
from tactorch.metrics import ssim
from tactorch.recording import Recording
from tactorch.reproduce.paper import START_MPA

_MIN_EVALUATIONS = 0.98  # fraction of a number of evaluations that counts as reached


class TracePoint(NamedTuple):
    """State of an inversion after an iteration.

    Attributes:
        evaluations: Number of solves of all presses, called iterations of TNC in the paper.
        seconds: Time since the start without scoring, s.
        ssim: Structural similarity of the map to the truth.
        scoring: Time of scoring since the start, s.
    """

    evaluations: int
    seconds: float
    ssim: float
    scoring: float = 0.0


@dataclass(frozen=True, eq=False)
class TracedRun:
    """Result of an inversion with the states of all its iterations."""

    result: Reconstruction
    trace: list[TracePoint]

    @property
    def seconds(self) -> float:
        """Total time, s."""
        return self.trace[-1].seconds

    @property
    def limited(self) -> bool:
        """Whether a limit of time or of evaluations stopped the inversion."""
        limits = StopReason.EVALUATION_LIMIT, StopReason.ITERATION_LIMIT, StopReason.TIME_LIMIT
        return self.result.stop_reason in limits

    def ssim_after(self, evaluations: int) -> float | None:
        """Return the similarity after a number of evaluations; None if a limit stopped it before.

        An iteration takes several evaluations, so that a limit is reached before its exact number.
        """
        points = [point for point in self.trace if point.evaluations <= evaluations]
        short = self.trace[-1].evaluations < _MIN_EVALUATIONS * evaluations
        return None if not points or (short and self.limited) else points[-1].ssim

    def first_at(self, level: float) -> TracePoint | None:
        """Return the first state with at least this similarity, or None."""
        return next((point for point in self.trace if point.ssim >= level), None)


def warm_up(recording: Recording) -> None:
    """Compile and load the code of the first solve, before time is measured."""
    problem = InverseProblem(replace(recording, truth=None))
    evaluation = problem.evaluate(np.full(recording.mesh.n_tets, START_MPA))
    evaluation.gradient()
    evaluation.jacobian()


def run_with_trace(recording: Recording, settings: Settings, scratch: Path) -> TracedRun:
    """Invert from the start of the paper and score the map of each iteration.

    The recording is inverted without its truth. A killed call continues from its checkpoint and
    its trace, which are in the folder `scratch`.
    """
    truth = recording.truth
    assert truth is not None
    scratch.mkdir(parents=True, exist_ok=True)
    checkpoint, file = scratch / "checkpoint.h5", scratch / "trace.jsonl"
    resumed = checkpoint.is_file() and file.is_file()
    trace = _read_trace(file) if resumed else []
    file.write_text("".join(map(_line, trace)))

    def add_point(record: dict[str, Any], youngs: np.ndarray) -> None:
        start = time.perf_counter()
        scoring = trace[-1].scoring if trace else 0.0
        similarity = ssim(recording.mesh, youngs, truth)
        seconds = record["seconds"] - scoring
        scoring += time.perf_counter() - start
        trace.append(TracePoint(record["evaluations"], seconds, similarity, scoring))
        with open(file, "a") as stream:
            stream.write(_line(trace[-1]))

    result = invert(
        replace(recording, truth=None),
        settings,
        start_mpa=START_MPA,
        checkpoint=checkpoint,
        resume=checkpoint if resumed else None,
        show_progress=False,
        on_iteration=add_point,
    )
    return TracedRun(result, trace)


def _line(point: TracePoint) -> str:
    return json.dumps(point._asdict()) + "\n"


def _read_trace(file: Path) -> list[TracePoint]:
    """Return the states of an earlier call up to the first truncated line."""
    trace = []
    for line in file.read_text().splitlines():
        try:
            trace.append(TracePoint(**json.loads(line)))
        except ValueError:
            break
    return trace
