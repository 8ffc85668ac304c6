"""Inversion that records the similarity to the truth at each iteration and can be resumed."""

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import InverseProblem, Reconstruction, Settings, StopReason, invert
from tactorch.metrics import ssim
from tactorch.recording import Recording
from tactorch.reproduce.objects import START_MPA

_MIN_EVALUATIONS = 0.98  # fraction of a number of evaluations that counts as reached


@dataclass(frozen=True)
class TracePoint:
    """State of an inversion after an iteration.

    Attributes:
        evaluations: Number of solves of all presses, called iterations of TNC in the paper.
        seconds: Time since the start without scoring, s.
        ssim: Structural similarity of the map to the truth.
    """

    evaluations: int
    seconds: float
    ssim: float


@dataclass(frozen=True, eq=False)
class TracedRun:
    """Inversion with the trace of its iterations.

    Attributes:
        result: Result of the inversion.
        trace: States of all iterations.
    """

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
        """Return the similarity after a number of evaluations.

        An iteration takes several evaluations, so that a limit is reached before its exact number.

        Returns:
            The similarity; None if a limit stopped the inversion before.
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

    The recording is inverted without its truth. A killed call continues from its checkpoint.

    Args:
        recording: Recording with a truth.
        settings: Settings of the inversion.
        scratch: Folder of the checkpoint and the trace.

    Returns:
        The result with its trace.
    """
    truth = recording.truth
    assert truth is not None
    scratch.mkdir(parents=True, exist_ok=True)
    checkpoint, file = scratch / "checkpoint.h5", scratch / "trace.jsonl"
    resumed = checkpoint.is_file() and file.is_file()
    lines = _read_lines(file) if resumed else []
    file.unlink(missing_ok=True)
    scoring = lines[-1]["scoring"] if lines else 0.0

    def add_point(record: dict[str, Any], youngs: np.ndarray) -> None:
        nonlocal scoring
        start = time.perf_counter()
        lines.append(
            {
                "evaluations": record["evaluations"],
                "seconds": record["seconds"] - scoring,
                "ssim": ssim(recording.mesh, youngs, truth),
            }
        )
        scoring += time.perf_counter() - start
        lines[-1]["scoring"] = scoring
        with open(file, "a") as stream:
            stream.write(json.dumps(lines[-1]) + "\n")

    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    result = invert(
        replace(recording, truth=None),
        settings,
        start_mpa=START_MPA,
        checkpoint=checkpoint,
        resume=checkpoint if resumed else None,
        show_progress=False,
        on_iteration=add_point,
    )
    trace = [TracePoint(line["evaluations"], line["seconds"], line["ssim"]) for line in lines]
    return TracedRun(result, trace)


def _read_lines(file: Path) -> list[dict[str, Any]]:
    """Return the lines of an earlier call up to the first truncated one."""
    lines = []
    for line in file.read_text().splitlines():
        try:
            lines.append(json.loads(line))
        except ValueError:
            break
    return lines
