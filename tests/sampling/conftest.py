"""A small object, presses on it, and a view that remembers."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from tactorch.inverse import Settings
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
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
from tactorch.simulation import PressPlan, simulate


class Memory(Observer):
    """An observer that keeps what it is shown."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.maps: list[Update] = []
        self.suggestions: list[Update] = []
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


@pytest.fixture
def view() -> Memory:
    return Memory()


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


def _follow(
    path: Path,
    folder: Path,
    view: Memory,
    *,
    rule: str = "none",
    patience: float = 5.0,
    **options: Any,
) -> LoopResult:
    """Follow until nothing comes any more, one press at a time."""
    settings = Settings()
    usual = {"idle_seconds": 0.05, "poll_seconds": 0.01, "max_batch": 1, "max_iterations": 3}
    usual["update_seconds"] = None
    source = RecordingSource(path, patience_seconds=patience, report=view.show_message)
    return SamplingLoop(
        source,
        settings,
        folder,
        view,
        options=LoopOptions(**{**usual, **options}),
        suggester=Suggester(settings, SuggestOptions(rule=rule, candidates=6)),
    ).run()


@pytest.fixture
def follow() -> Callable[..., LoopResult]:
    return _follow


@pytest.fixture
def new_view() -> type[Memory]:
    return Memory
