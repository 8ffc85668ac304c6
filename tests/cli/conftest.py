"""Running the command in this process, and small input for it."""

import functools
import logging
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

TABLE: list[tuple[str, str]] = []


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--bad-input-table",
        action="store_true",
        help="print what tests/cli/test_bad_input.py gave and what was answered, as Markdown",
    )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not terminalreporter.config.getoption("--bad-input-table", default=False):
        return
    terminalreporter.write_line("| input | message |")
    terminalreporter.write_line("|---|---|")
    for given, answered in TABLE:
        cells = (text.replace("|", "\\|") for text in (given, answered))
        terminalreporter.write_line(f"| {' | '.join(cells)} |")


@pytest.fixture
def table() -> list[tuple[str, str]]:
    """Rows of wrong input and the message it gets."""
    return TABLE


@dataclass
class Outcome:
    """How a command ended."""

    status: int
    out: str
    err: str


Command = Callable[..., Outcome]


def run_here(arguments: tuple[str | Path, ...]) -> int:
    """Run the command in this process, leave no trace in it, and return the exit status."""
    from tactorch.cli import main

    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        main([str(word) for word in arguments])
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        for handler in set(root.handlers) - set(handlers):
            handler.close()
        root.handlers[:], root.level = handlers, level
        HydraConfig.instance().cfg = None
        assert not GlobalHydra.instance().is_initialized()
    return 0


@pytest.fixture(scope="session", autouse=True)
def read_once() -> Iterator[None]:
    """Read once in this process what each command reads again, and compose settings once.

    Before a run, Hydra composes all settings to learn whether they set `hydra.mode`; none do. For
    each run it copies its store, which has the settings of all commands here; what it loads from
    the store it copies again.
    """
    from tactorch.cli import schema

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Hydra, "get_mode", lambda *args, **options: None)
        patch.setattr(ConfigStore, "__deepcopy__", lambda self, memo: self, raising=False)
        patch.setattr(schema, "_code_key", functools.cache(schema._code_key))
        yield


@pytest.fixture
def tactorch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Return the command, run in this process in an empty folder."""
    folder = tmp_path / "cwd"
    folder.mkdir(exist_ok=True)
    monkeypatch.chdir(folder)

    def run(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        status = run_here(arguments)
        return Outcome(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def tactorch_module() -> Callable[..., int]:
    """Return the command for fixtures of a module; it returns the exit status."""
    return lambda *arguments: run_here(arguments)


@pytest.fixture(scope="session")
def recording_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of two presses on a cube of 40 tetrahedra."""
    from tactorch.mesh import box_mesh
    from tactorch.phantoms import make_phantom
    from tactorch.recording import MaterialSpec
    from tactorch.simulation import PressPlan, simulate

    recording = simulate(
        make_phantom("cube_sphere", radius=0.3),
        PressPlan(("z+", "x+"), (0.01,)),
        mesh=box_mesh(10.0, 2, tets_per_cell=5),
        material=MaterialSpec("neo_hookean", 0.49, {"lame_factor": 0.5}),
        samples=4,
    )
    path = tmp_path_factory.mktemp("recording") / "case.h5"
    recording.save(path)
    return path


@pytest.fixture(scope="session")
def published_folder(recording_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the same case in the published text format."""
    from tactorch.mesh import TetMesh, write_mesh
    from tactorch.recording import Recording

    recording = Recording.load(recording_file)
    mesh = recording.mesh
    folder = tmp_path_factory.mktemp("published") / "cube"
    (folder / "presses").mkdir(parents=True)
    write_mesh(folder / "mesh.msh", TetMesh(mesh.points * 1e-3, mesh.tets))
    assert recording.truth is not None
    np.savetxt(folder / "youngs_true.txt", recording.truth * 1e6)
    for number, press in enumerate(recording.presses, start=1):
        moved = np.where(press.observed, press.displacement, 0.0)
        presses = folder / "presses"
        np.savetxt(presses / f"force{number}.txt", press.forces.ravel())
        np.savetxt(presses / f"pnt{number}.txt", (mesh.points + moved).ravel() * 1e-3, fmt="%.17g")
        _write_diagonal(presses / f"A-{number}.txt", press.springs.ravel() * 1e3)
        _write_diagonal(presses / f"B-{number}.txt", press.observed.ravel().astype(float))
    return folder


def _write_diagonal(path: Path, values: np.ndarray) -> None:
    rows = np.flatnonzero(values)
    np.savetxt(path, np.column_stack((rows, rows, values[rows])), fmt=("%d", "%d", "%.17g"))


@pytest.fixture
def published(published_folder: Path, tmp_path: Path) -> Path:
    """Return a copy of the published case to spoil."""
    return Path(shutil.copytree(published_folder, tmp_path / "case"))


@pytest.fixture
def recording(recording_file: Path, tmp_path: Path) -> Path:
    """Return a copy of the recording to spoil."""
    return Path(shutil.copy2(recording_file, tmp_path / "case.h5"))


@pytest.fixture(scope="session")
def finished_run(recording_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an inversion of one iteration."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    quick = ("plots=false", "method=map", "optimizer.max_iterations=1")
    assert run_here(("invert", f"recording={recording_file}", f"run_dir={folder}", *quick)) == 0
    return folder
