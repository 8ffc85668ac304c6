"""Folders and programs that tactorch reads, writes and runs."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from tactorch.cli.doctor.finding import Finding, looked_at
from tactorch.errors import ConfigError

FILES, TOOLS = "files", "tools"
#: Browsers that tests of HTML pages can drive.
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def look_at_places() -> Iterator[Finding]:
    """Look at folders, then at what makes meshes, videos and pages."""
    yield looked_at(
        FILES, "settings (conf)", _conf, "the command line",
        "pip install --force-reinstall tactorch", core=True,
    )  # fmt: skip
    yield looked_at(
        FILES, "cache of meshes", _cache, "caching meshes: they are made again each time",
        "set TACTORCH_CACHE to a folder that can be written",
    )  # fmt: skip
    yield looked_at(
        FILES, "cache of numba", _numba_cache, "quick starts: kernels are compiled each time",
        "set NUMBA_CACHE_DIR to a folder that can be written",
    )  # fmt: skip
    yield _shared_data()
    yield looked_at(
        TOOLS, "mesher", _mesh, "meshes of surfaces: phantoms, object=mesh",
        "pip install --force-reinstall pytetwild",
    )  # fmt: skip
    yield looked_at(
        TOOLS, "videos", _video, "tactorch sensor: videos",
        "pip install --force-reinstall opencv-python-headless",
    )  # fmt: skip
    yield _browser()


def _conf() -> str:
    from tactorch.cli.main import COMMANDS
    from tactorch.cli.schema import conf_folder, load_schema

    for command in COMMANDS:
        load_schema(command)
    return f"{conf_folder()}"


def _cache() -> str:
    from tactorch.files import cache_folder

    return _writable(cache_folder())


def _numba_cache() -> str:
    from tactorch.linalg.kernels import symmetric_product

    return _writable(Path(symmetric_product.stats.cache_path))


def _writable(folder: Path) -> str:
    """Return a folder in which a file can be made; it is made itself, if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".doctor-"):
        pass
    return f"{folder} ({shutil.disk_usage(folder).free / 1e9:.0f} GB free)"


def _shared_data() -> Finding:
    """Return the finding on published data, `$TACTORCH_SHARED` or `shared` next to the project."""
    chosen = os.environ.get("TACTORCH_SHARED")
    place = Path(chosen) if chosen else Path(__file__).resolve().parents[4] / "shared"
    feature = "what is computed from published data (make external)"
    if (place / "data").is_dir():
        return Finding(FILES, "shared data", True, str(place), feature)
    message = f"none: '{place / 'data'}' is not a folder"
    remedy = "set TACTORCH_SHARED to the folder that holds data/"
    # A folder is required only if the variable names it.
    return Finding(FILES, "shared data", False if chosen else None, message, feature, remedy)


def _mesh() -> str:
    from tactorch.mesh import box_mesh, tetrahedralize

    cube = box_mesh(10.0, 1)
    mesh = tetrahedralize(cube.points, cube.surface.triangles, 10.0, epsilon=0.03, cache=False)
    return f"fTetWild fills a cube with {mesh.n_tets} tetrahedra"


def _video() -> str:
    """Write a video and read it back."""
    import numpy as np

    from tactorch.sensor.frames import open_source
    from tactorch.viz.video import video_suffix, writing_video

    suffix = video_suffix()
    if suffix is None:
        raise ConfigError("this OpenCV can write neither MPEG-4 nor Motion JPEG")
    grey = np.full((64, 64, 3), 120, np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"grey{suffix}"
        with writing_video(path, 10.0) as add:
            for _ in range(3):
                add(grey)
        frames = [frame.image for frame in open_source(path)]
    seen = [image for image in frames if image is not None]
    if len(seen) != 3 or not all(abs(float(image.mean()) - 120) < 8 for image in seen):
        raise ConfigError(f"of 3 frames written to a {suffix} video, {len(seen)} can be read")
    return f"{suffix} written and read"


def _browser() -> Finding:
    """Look for a browser and what drives it; none but the developers' tests need them."""
    feature = "the project's tests of HTML pages"
    place = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    lacking = [] if place else ["no Chromium or Chrome in PATH"]
    if find_spec("playwright") is None:
        lacking.append("playwright is not installed (pip install playwright)")
    message = "; ".join(lacking) if lacking else f"{place}, driven by playwright"
    return Finding(TOOLS, "headless browser", None if lacking else True, message, feature)
