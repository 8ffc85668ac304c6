"""An inversion whose similarity to the truth is noted on the way, and that can be resumed."""

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

_NEARLY = 0.98


@dataclass(frozen=True)
class TracePoint:
    """Where an inversion stood.

    Attributes:
        evaluations: Solves of all presses so far, the paper's iterations of TNC.
        seconds: Since its start, without the time that scoring took.
        ssim: Of its map with the truth.
    """

    evaluations: int
    seconds: float
    ssim: float


@dataclass(frozen=True, eq=False)
class TracedRun:
    """An inversion and its way."""

    found: Reconstruction
    way: list[TracePoint]

    @property
    def seconds(self) -> float:
        """Of all of it."""
        return self.way[-1].seconds

    @property
    def limited(self) -> bool:
        """Whether it was a limit of time or number that ended it."""
        return self.found.stop_reason in (
            StopReason.EVALUATION_LIMIT,
            StopReason.TIME_LIMIT,
            StopReason.ITERATION_LIMIT,
        )

    def ssim_after(self, evaluations: int) -> float | None:
        """Similarity after so many solves; None where it has not made that many, nor ended.

        An iterate takes several solves, so a limit is reached when the next would go beyond.
        """
        past = [m for m in self.way if m.evaluations <= evaluations]
        short = self.way[-1].evaluations < _NEARLY * evaluations
        return None if not past or (short and self.limited) else past[-1].ssim

    def first_at(self, level: float) -> TracePoint | None:
        """When its map was first as similar; None where it never was."""
        return next((m for m in self.way if m.ssim >= level), None)


def warm_up(recording: Recording) -> None:
    """Compile and load what the first solve needs, before any clock starts."""
    problem = InverseProblem(replace(recording, truth=None))
    evaluation = problem.evaluate(np.full(recording.mesh.n_tets, START_MPA))
    evaluation.gradient()
    evaluation.jacobian()


def run_with_trace(recording: Recording, settings: Settings, scratch: Path) -> TracedRun:
    """Invert from the paper's start, scoring each iteration's map against the truth.

    The inversion sees a copy of the recording without the truth. A call that was killed goes on
    from what it left in `scratch`.
    """
    truth = recording.truth
    assert truth is not None
    scratch.mkdir(parents=True, exist_ok=True)
    checkpoint, notes = scratch / "checkpoint.h5", scratch / "way.jsonl"
    resumed = checkpoint.is_file() and notes.is_file()
    lines = _read(notes) if resumed else []
    notes.unlink(missing_ok=True)
    spent = lines[-1]["spent"] if lines else 0.0

    def note(record: dict[str, Any], youngs: np.ndarray) -> None:
        nonlocal spent
        began = time.perf_counter()
        lines.append(
            {
                "evaluations": record["evaluations"],
                "seconds": record["seconds"] - spent,
                "ssim": ssim(recording.mesh, youngs, truth),
            }
        )
        spent += time.perf_counter() - began
        lines[-1]["spent"] = spent
        with open(notes, "a") as file:
            file.write(json.dumps(lines[-1]) + "\n")

    notes.write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = invert(
        replace(recording, truth=None),
        settings,
        start_mpa=START_MPA,
        checkpoint=checkpoint,
        resume=checkpoint if resumed else None,
        show_progress=False,
        on_iteration=note,
    )
    way = [TracePoint(line["evaluations"], line["seconds"], line["ssim"]) for line in lines]
    return TracedRun(found, way)


def _read(notes: Path) -> list[dict[str, Any]]:
    """Lines of an earlier call; one that a kill cut short is dropped."""
    found = []
    for line in notes.read_text().splitlines():
        try:
            found.append(json.loads(line))
        except ValueError:
            break
    return found
