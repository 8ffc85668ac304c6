"""Checks of the installation: packages, solvers, machine, folders and programs."""

import importlib
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from tactorch.cli import COMMANDS
from tactorch.cli.presets import conf_folder
from tactorch.cli.schema import load_schema
from tactorch.errors import ConfigError, ConvergenceError, TactorchError
from tactorch.files import cache_folder

PACKAGES, SOLVERS, MACHINE, FILES, TOOLS = "packages", "solvers", "machine", "files", "tools"
_ALL = "everything"
_GIB = 2.0**30
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
#: Browsers that tests of HTML pages can drive.
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_EQUATIONS = 300
# Uniaxial press of a Neo-Hookean block, E = 1, Poisson's ratio 0.3, nominal traction -0.2: exact.
_STRETCH = 0.828310984658


@dataclass(frozen=True)
class Finding:
    """Result of one check of the installation."""

    part: str  # group of the check, such as "packages"
    name: str
    works: bool | None  # None: information only
    message: str  # version, path or size of the item, or the reason of the failure
    feature: str = ""  # what needs the item
    remedy: str = ""  # command or action if the item does not work
    core: bool = False  # whether everything needs the item


def check(
    part: str,
    name: str,
    function: Callable[[], str],
    feature: str = "",
    remedy: str = "",
    core: bool = False,
) -> Finding:
    """Return the finding on an item: the text of a function, or the error that it raises."""
    try:
        return Finding(part, name, True, function(), feature, core=core)
    except Exception as error:  # a broken package may raise anything
        return Finding(part, name, False, _reason(error), feature, remedy, core)


def _reason(error: Exception) -> str:
    """Return an error as one line."""
    text, kind = " ".join(str(error).split()), type(error).__name__
    return text if isinstance(error, TactorchError) else f"{kind}: {text}" if text else kind


class Package(NamedTuple):
    """A package that tactorch uses."""

    name: str  # for pip
    module: str
    feature: str  # what needs the package
    core: bool = False  # whether everything needs it
    extra: str = ""  # extra of tactorch that has the package


_PACKAGES = (
    Package("torch", "torch", _ALL, core=True),
    Package("numpy", "numpy", _ALL, core=True),
    Package("scipy", "scipy", _ALL, core=True),
    Package("numba", "numba", _ALL, core=True),
    Package("jaxtyping", "jaxtyping", _ALL, core=True),
    Package("h5py", "h5py", "recordings and reconstructions (.h5)", core=True),
    Package("hydra-core", "hydra", "the command line", core=True),
    Package("pyyaml", "yaml", "the command line", core=True),
    Package("pypardiso", "pypardiso", "solver=pardiso, the fastest"),
    Package("pyamg", "pyamg", "solver=multigrid, for the largest meshes"),
    Package("pytetwild", "pytetwild", "meshes of surfaces: phantoms, object=mesh"),
    Package("vtk", "vtk", "pytetwild, which brings it"),
    Package("meshio", "meshio", "reading and writing meshes and maps (.vtu)"),
    Package("matplotlib", "matplotlib", "pictures (plots=false does without)"),
    Package("rich", "rich", "progress bars and tables at a terminal"),
    Package("opencv-python-headless", "cv2", "tactorch sensor: images and videos"),
    Package("scikit-image", "skimage", "scores, markers, meshes from voxels"),
    Package("lightning", "lightning", "train, evaluate-model, initialization=surrogate"),
    Package("tensorboard", "tensorboard", "train"),
    Package("joblib", "joblib", "generate with several workers"),
    Package("threadpoolctl", "threadpoolctl", "generate"),
    Package("dask", "distributed", "generate executor=dask, on a cluster", extra="dask"),
)


def check_packages() -> Iterator[Finding]:
    """Import every package, and compare its version with the ones that tactorch takes."""
    yield Finding(PACKAGES, "python", True, platform.python_version())
    try:
        yield Finding(PACKAGES, "tactorch", True, version("tactorch"))
    except PackageNotFoundError:
        yield Finding(PACKAGES, "tactorch", True, "not installed: run from its folder")
    for package in _PACKAGES:
        test, remedy = partial(_import, package), _install(package)
        yield check(PACKAGES, package.name, test, package.feature, remedy, core=package.core)


def _import(package: Package) -> str:
    """Return the version of a package, if tactorch takes it."""
    module = importlib.import_module(package.module)
    try:
        installed = version(package.name)
    except PackageNotFoundError:  # another build of the same module
        return str(getattr(module, "__version__", "")) or "of unknown version"
    needed = _ranges().get(package.name, "")
    if needed:
        from packaging.specifiers import SpecifierSet

        if not SpecifierSet(needed).contains(installed, prereleases=True):
            raise ConfigError(f"{installed} is installed, and tactorch needs {needed}")
    return installed


def _install(package: Package) -> str:
    """Return the command that installs a package."""
    if package.extra:
        return f'pip install "tactorch[{package.extra}]"'
    needed = _ranges().get(package.name, "")
    return f'pip install "{package.name}{needed}"' if needed else f"pip install {package.name}"


@cache
def _ranges() -> dict[str, str]:
    """Return the versions that tactorch takes, by package; none where they are not known."""
    try:
        from packaging.requirements import Requirement

        requirements = [Requirement(line) for line in requires("tactorch") or ()]
    except Exception:  # not installed, or what reads it is missing or broken
        return {}
    return {r.name.lower(): str(r.specifier) for r in requirements}


def check_solvers() -> Iterator[Finding]:
    """Solve equations with each solver, then press a block; the answers are known."""
    packages = {package.name: package for package in _PACKAGES}
    solvers = {"pardiso": "pypardiso", "superlu": "scipy", "multigrid": "pyamg"}
    works = []
    for name, package in {**solvers, "torch_cg": "torch"}.items():
        remedy = _install(packages[package])
        finding = check(SOLVERS, name, partial(_solve, name), f"solver={name}", remedy)
        works += [name] if finding.works else []
        yield finding
    message = f"solver=auto takes {works[0]}" if works else "none of them works"
    remedy = "" if works else _install(packages["scipy"])
    feature = "every simulation"
    yield Finding(SOLVERS, "any of them", bool(works), message, feature, remedy, core=True)
    yield check(SOLVERS, "a pressed block", _press, feature, "see what is wrong above", core=True)


def _solve(backend: str) -> str:
    import numpy as np

    from tactorch.linalg import SymmetricPattern, analyse

    chain = np.arange(_EQUATIONS - 1)
    pattern = SymmetricPattern.from_pairs(_EQUATIONS, chain, chain + 1)
    values = np.where(pattern.rows == pattern.indices, 2.5, -1.0)
    expected = np.sin(np.arange(_EQUATIONS))
    solver = analyse(pattern, backend)
    if not solver.factor(values):
        raise ConvergenceError("a positive definite matrix was taken for an indefinite one")
    error = np.abs(solver.solve(pattern.product(values, expected)) - expected).max()
    if not error < 1e-8:
        raise ConvergenceError(f"the solution of {_EQUATIONS} equations is off by {error:.1e}")
    return f"{_EQUATIONS} equations solved"


def _press() -> str:
    import torch

    from tactorch.fem import SoftBody, Supports, make_material
    from tactorch.mesh import box_mesh, face_nodes

    mesh = box_mesh(1.0, 2)
    body = SoftBody(mesh, make_material("neo_hookean", poisson=0.3))
    rollers = Supports(fixed=mesh.points < 1e-9)  # each low side slides in its plane
    youngs = torch.ones(mesh.n_tets, dtype=torch.float64)
    u = body.solve(youngs, body.traction("z+", [0.0, 0.0, -0.2]), rollers)
    stretch = 1.0 + float(u[torch.from_numpy(face_nodes(mesh, "z+")), 2].mean())
    if not abs(stretch - _STRETCH) < 1e-6:
        raise ConvergenceError(f"its stretch is {stretch:.6f}, and should be {_STRETCH:.6f}")
    return f"stretch {stretch:.6f}, as in theory"


def check_machine() -> Iterator[Finding]:
    """Yield system, cores, threads, memory and GPU."""
    yield Finding(MACHINE, "system", None, f"{platform.system()} {platform.machine()}")
    for name, function in (("cores", _cores), ("threads", _threads), ("memory", _memory)):
        finding = check(MACHINE, name, function)
        yield replace(finding, works=None) if finding.works else finding
    yield _gpu()


def _cores() -> str:
    total = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else total
    quota = _container_limit("cpu.max")
    share = f", {float(quota[0]) / float(quota[1]):g} of them by the container" if quota else ""
    return f"{usable} usable of {total}{share}"


def _threads() -> str:
    """Return the threads that libraries use by themselves, and those of the environment."""
    import torch

    given = ", ".join(f"{name}={os.environ[name]}" for name in _THREADS if name in os.environ)
    return f"torch uses {torch.get_num_threads()}" + (f" ({given})" if given else "")


def _memory() -> str:
    if not hasattr(os, "sysconf"):
        return "unknown"
    page = os.sysconf("SC_PAGE_SIZE")
    message = f"{page * os.sysconf('SC_PHYS_PAGES') / _GIB:.1f} GiB"
    if limit := _container_limit("memory.max"):
        message += f", {float(limit[0]) / _GIB:.1f} GiB of them for the container"
    # Available without swapping; not all systems say it.
    lines = _read_lines("/proc/meminfo")
    kib = next((float(x.split()[1]) for x in lines if x.startswith("MemAvailable:")), None)
    return message if kib is None else f"{message}, {kib * 1024 / _GIB:.1f} GiB free"


def _container_limit(name: str) -> list[str]:
    """Return a limit of the container of this process; empty where there is none."""
    words = " ".join(_read_lines(f"/sys/fs/cgroup/{name}")).split()
    return [] if words[:1] == ["max"] else words


def _read_lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []


def _gpu() -> Finding:
    """Return the finding on the GPU; its absence is reported, but is no failure."""
    feature = "solver=torch_cg, trainer=gpu"
    try:
        reason = _missing_gpu()
    except Exception as error:  # a broken torch, reported among the packages
        reason = _reason(error)
    if reason:
        return Finding(MACHINE, "GPU", None, f"none: {reason}", feature)
    return check(MACHINE, "GPU", _gpus, feature, "see what nvidia-smi says of its driver")


def _missing_gpu() -> str:
    """Return why torch can use no GPU; empty where it can."""
    import torch

    if torch.version.cuda is None:
        return f"torch {torch.__version__} is built without CUDA"
    if torch.cuda.is_available():
        return ""
    try:
        torch.cuda.init()
    except (RuntimeError, AssertionError) as error:
        return _reason(error)
    return "torch finds no device"


def _gpus() -> str:
    """Compute on each device, which may be listed and fail."""
    import torch

    names = []
    for k in range(torch.cuda.device_count()):
        if float(torch.ones(8, device=f"cuda:{k}").sum()) != 8.0:
            raise ConfigError(f"device {k} computes a wrong sum")
        names.append(torch.cuda.get_device_name(k))
    return f"{', '.join(names)} (CUDA {torch.version.cuda})"


def check_places() -> Iterator[Finding]:
    """Check the folders of tactorch, then the programs for meshes, videos and pages."""
    reinstall = "pip install --force-reinstall"
    remedy, feature = f"{reinstall} tactorch", "the command line"
    yield check(FILES, "settings (conf)", _conf, feature, remedy, core=True)
    remedy = "set TACTORCH_CACHE to a folder that can be written"
    feature = "caching meshes: they are made again each time"
    yield check(FILES, "cache of meshes", _cache, feature, remedy)
    remedy = "set NUMBA_CACHE_DIR to a folder that can be written"
    feature = "quick starts: kernels are compiled each time"
    yield check(FILES, "cache of numba", _numba_cache, feature, remedy)
    yield _shared_data()
    remedy, feature = f"{reinstall} pytetwild", "meshes of surfaces: phantoms, object=mesh"
    yield check(TOOLS, "mesher", _mesh, feature, remedy)
    remedy = f"{reinstall} opencv-python-headless"
    yield check(TOOLS, "videos", _video, "tactorch sensor: videos", remedy)
    yield _browser()


def _conf() -> str:
    for command in COMMANDS:
        load_schema(command)
    return f"{conf_folder()}"


def _cache() -> str:
    return _writable(cache_folder())


def _numba_cache() -> str:
    from tactorch.linalg.pattern import symmetric_product

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
    place = Path(chosen) if chosen else Path(__file__).resolve().parents[3] / "shared"
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
        images = [frame.image for frame in open_source(path) if frame.image is not None]
    if len(images) != 3 or not all(abs(float(image.mean()) - 120) < 8 for image in images):
        raise ConfigError(f"of 3 frames written to a {suffix} video, {len(images)} can be read")
    return f"{suffix} written and read"


def _browser() -> Finding:
    """Return the finding on a browser and playwright; only tests of the project need them."""
    feature = "the project's tests of HTML pages"
    place = next(filter(None, map(shutil.which, _BROWSERS)), None)
    missing = [] if place else ["no Chromium or Chrome in PATH"]
    if find_spec("playwright") is None:
        missing.append("playwright is not installed (pip install playwright)")
    message = "; ".join(missing) or f"{place}, driven by playwright"
    return Finding(TOOLS, "headless browser", None if missing else True, message, feature)
