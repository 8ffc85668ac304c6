"""A small run, and a browser without a network to open its report in."""

import base64
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

MakeRun = Callable[..., Path]


@pytest.fixture(scope="session")
def recording_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of two presses on a cube of 135 tetrahedra."""
    from tactorch.mesh import box_mesh
    from tactorch.phantoms import make_phantom
    from tactorch.simulation import PressPlan, simulate

    recording = simulate(
        make_phantom("cube_sphere", radius=0.3, depth=0.35),
        PressPlan(("z+", "x+"), (0.02,)),
        mesh=box_mesh(10.0, 3, tets_per_cell=5),
        snr_db=40,
        samples=4,
    )
    path = tmp_path_factory.mktemp("report") / "case.h5"
    recording.save(path)
    return path


@pytest.fixture(scope="session")
def make_run(recording_path: Path) -> MakeRun:
    """Return a function that inverts in six iterations and leaves a run's folder."""

    def make(folder: Path, settings: Any = None) -> Path:
        from tactorch.cli.outputs import write_outputs
        from tactorch.inverse import GaussNewton, Settings, invert_map
        from tactorch.recording import Recording

        recording = Recording.load(recording_path)
        chosen = settings or Settings(optimizer=GaussNewton(max_iterations=6))
        found = invert_map(recording, chosen, show_progress=False)
        write_outputs(folder, recording, found, source=str(recording_path), plots=False)
        return folder

    return make


@pytest.fixture(scope="session")
def run_folder(make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an inversion."""
    return make_run(tmp_path_factory.mktemp("runs") / "first")


@pytest.fixture(scope="session")
def report(run_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return its report."""
    from tactorch.report import load_run, write_report

    return write_report([load_run(run_folder)], tmp_path_factory.mktemp("out") / "report.html")


BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
# WebGL by the processor, and none of what a browser does by itself on the network.
ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-rasterization",
    "--disable-accelerated-2d-canvas",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


@pytest.fixture(scope="session")
def launch() -> Iterator[Callable[..., Any]]:
    """Return a function that starts a browser; skip where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser")
    if not BROWSER:
        pytest.skip("no browser: chromium, chromium-browser or google-chrome is not installed")
    with api.sync_playwright() as play:
        yield lambda *more: play.chromium.launch(executable_path=BROWSER, args=[*ARGUMENTS, *more])


@pytest.fixture(scope="session")
def browser(launch: Callable[..., Any]) -> Iterator[Any]:
    """Return a running browser."""
    started = launch()
    yield started
    started.close()


class Visit:
    """A page that is open, and what it did by itself."""

    def __init__(self, browser: Any, path: Path, **options: Any) -> None:
        self.context = browser.new_context(offline=True, **options)
        self.page = self.context.new_page()
        self.requests: list[str] = []
        self.troubles: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("console", self._hear)
        self.address = path.resolve().as_uri()
        self.page.goto(self.address)
        self.page.wait_for_selector("html[data-ready]")

    def _hear(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.troubles.append(message.text)

    def settle(self) -> None:
        """Wait until what was asked for is drawn."""
        self.page.evaluate(
            "() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))"
        )

    def pixels(self, selector: str) -> np.ndarray:
        """Return a canvas as rows x columns x RGBA."""
        self.settle()
        found = self.page.evaluate(
            """(selector) => {
                const canvas = document.querySelector(selector);
                const flat = document.createElement("canvas");
                [flat.width, flat.height] = [canvas.width, canvas.height];
                const g = flat.getContext("2d");
                g.drawImage(canvas, 0, 0);
                const { data } = g.getImageData(0, 0, flat.width, flat.height);
                let text = "";
                for (let i = 0; i < data.length; i += 8192)
                    text += String.fromCharCode(...data.subarray(i, i + 8192));
                return [flat.height, flat.width, btoa(text)];
            }""",
            selector,
        )
        height, width, data = found
        return np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4).astype(int)

    def slide(self, selector: str, value: float) -> None:
        """Move a slider as a hand does."""
        self.page.eval_on_selector(
            selector,
            "(e, v) => { e.value = v; e.dispatchEvent(new Event('input', { bubbles: true })); }",
            value,
        )
        self.settle()


@pytest.fixture
def open_in() -> type[Visit]:
    """Return what opens a file in a browser."""
    return Visit


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Visit]]:
    """Return a function that opens a file; closed afterwards."""
    visits: list[Visit] = []

    def open_page(path: Path, **options: Any) -> Visit:
        visits.append(Visit(browser, path, **options))
        return visits[-1]

    yield open_page
    for one in visits:
        one.context.close()
