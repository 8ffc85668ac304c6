"""A small object, presses on it, and a view that remembers."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactorch.inverse import Settings
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Press, Recording
from tactorch.sampling import (
    LoopOptions,
    LoopResult,
    Observer,
    RecordingSource,
    SamplingLoop,
    Suggester,
    SuggestOptions,
    Update,
)
from tactorch.sampling.loop import HISTORY
from tactorch.simulation import PressPlan, simulate


class Memory(Observer):
    """An observer that keeps what it is shown."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.maps: list[Update] = []
        self.suggestions: list[Update] = []
        self.findings: list[Update] = []
        self.history: list[Mapping[str, Any]] = []
        self.waits = 0

    def waiting(self, presses: int, idle_seconds: float) -> None:
        self.waits += 1

    def resumed(self, history: Sequence[Mapping[str, Any]]) -> None:
        self.history = list(history)

    def show_message(self, text: str) -> None:
        self.notes.append(text)

    def updated(self, update: Update) -> None:
        self.maps.append(update)

    def suggested(self, update: Update) -> None:
        self.suggestions.append(update)

    def found(self, update: Update) -> None:
        self.findings.append(update)


@pytest.fixture(scope="session")
def whole() -> Recording:
    """Four presses on a cube of 135 tetrahedra with a large stiff ball, with noise."""
    return simulate(
        make_phantom("cube_sphere", radius=0.45),
        PressPlan(("z+", "x+"), (0.01, 0.02)),
        mesh=box_mesh(10.0, 3, tets_per_cell=5),
        fine_mesh=box_mesh(10.0, 4, tets_per_cell=5),
        snr_db=40,
        samples=4,
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where presses are appended."""
    return tmp_path / "session.h5"


class Live:
    """A recording at `path`, of which tests write presses of `whole`, and runs that follow it."""

    def __init__(self, path: Path, whole: Recording) -> None:
        self.path, self.whole, self.run = path, whole, path.with_name("run")
        self.view, self.new_view = Memory(), Memory

    def save(self, *presses: int | Press) -> None:
        """Write presses, by number where they are those of `whole`."""
        chosen = tuple(self.whole.presses[p] if isinstance(p, int) else p for p in presses)
        replace(self.whole, presses=chosen, check_units=False).save(self.path)

    def follow(
        self,
        view: Memory | None = None,
        *,
        folder: Path | None = None,
        suggest: SuggestOptions | None = None,
        rule: str = "none",
        shapes: bool = False,
        settings: Settings | None = None,
        **options: Any,
    ) -> LoopResult:
        """Follow until nothing comes any more, one press at a time."""
        method = "auto" if shapes else "map"
        settings, view = replace(settings or Settings(), method=method), view or self.view
        usual = {"idle_seconds": 0.05, "poll_seconds": 0.01, "max_batch": 1, "max_iterations": 3}
        usual |= {"update_seconds": None}
        suggest = suggest or SuggestOptions(rule=rule, candidates=6)
        return SamplingLoop(
            RecordingSource(self.path, report=view.show_message),
            settings,
            folder or self.run,
            view,
            options=LoopOptions(**{**usual, **options}),
            suggester=Suggester(settings, suggest),
        ).run()

    def lines(self) -> list[dict[str, Any]]:
        """Return the history that the run has written."""
        return [json.loads(line) for line in (self.run / HISTORY).read_text().splitlines()]


@pytest.fixture
def live(path: Path, whole: Recording) -> Live:
    return Live(path, whole)
