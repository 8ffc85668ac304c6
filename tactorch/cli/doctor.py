"""`tactorch doctor`: what works on this machine, and what to do about the rest."""

import importlib
import json
import logging
import os
import platform
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout, suppress
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, NamedTuple

from tactorch.cli import COMMANDS, plug_ins
from tactorch.cli.console import Table, is_rich, show
from tactorch.cli.presets import conf_folder
from tactorch.cli.schema import load_schema
from tactorch.config.registry import package
from tactorch.errors import ConfigError, ConvergenceError, TactorchError
from tactorch.files import cache_folder

HELP = """\
tactorch doctor: what works on this machine, what is missing, and the commands that install it.

  tactorch doctor
  tactorch doctor json=true  # the same for programs

Packages are imported, solvers solve, the mesher meshes, a video is written and read back, and
components of other packages (plug-ins) are imported in another process. The exit
status is 0 where the core works (simulate, invert, evaluate), and 1 where it does not."""

_MARKS = {True: "yes", False: "NO", None: "-"}
_GIB = 2.0**30
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
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


class AbsentError(Exception):
    """An item is absent, which is no failure."""


class Check(NamedTuple):
    """One check: a function that returns the message, or raises the reason of the failure."""

    part: str
    name: str
    function: Callable[[], str]
    feature: str = ""
    remedy: str = ""
    core: bool = False
    works: bool | None = True  # finding of success; None: information only

    def run(self) -> Finding:
        """Return the finding."""
        works, remedy = self.works, ""
        try:
            message = self.function()
        except AbsentError as reason:
            works, message = None, str(reason)
        except Exception as error:  # a broken package may raise anything
            works, message, remedy = False, _reason(error), self.remedy
        return Finding(self.part, self.name, works, message, self.feature, remedy, self.core)


def _reason(error: Exception) -> str:
    """Return an error as one line."""
    text, kind = " ".join(str(error).split()), type(error).__name__
    return text if isinstance(error, TactorchError) else f"{kind}: {text}" if text else kind


def run(words: Sequence[str]) -> int:
    """Check the installation and print the findings; return the exit status."""
    choices = {"json=true": True, "json=false": False}
    unknown = [word for word in words if word not in choices]
    if unknown:
        raise ConfigError(f"'{unknown[0]}' is no setting of it; it takes json=true alone.")
    as_json = bool(words) and choices[words[-1]]
    with nullcontext() if as_json else _spinner():
        findings = check_all()
    core_works = all(finding.works is not False for finding in findings if finding.core)
    if as_json:
        result = {"works": core_works, "findings": [asdict(finding) for finding in findings]}
        print(json.dumps(result, indent=2))
    else:
        _print_findings(findings, core_works)
    return 0 if core_works else 1


def check_all() -> list[Finding]:
    """Return the findings of all checks."""
    disabled = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        # Output of packages would spoil the JSON.
        with warnings.catch_warnings(), redirect_stdout(sys.stderr):
            warnings.simplefilter("ignore")
            return [*(check.run() for check in CHECKS), *_plug_ins()]
    finally:
        logging.disable(disabled)


def _print_findings(findings: Sequence[Finding], core_works: bool) -> None:
    rows, part = [], ""
    for f in findings:
        rows.append((f.part if f.part != part else "", f.name, _MARKS[f.works], f.message))
        part = f.part
    show(Table(("", "", "works", ""), rows, 4, {"yes": "green", "NO": "bold red"}))
    failures = [(f.name, f.feature, f.remedy) for f in findings if f.works is False]
    print()
    if failures:
        title = "Not working, affected features and remedies"
        print(f"{title}; the first may be why others fail:")
        show(Table(("",) * 3, failures, 3))
        print()
    if not core_works:
        print("The core of tactorch does not work here.")
    elif failures:
        print("The core of tactorch works here; what is listed above does not.")
    else:
        print("All of tactorch works here.")


def _spinner() -> AbstractContextManager[Any]:
    """Return a spinner at a terminal, elsewhere nothing."""
    with suppress(ImportError):  # reported among the packages
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner

        if is_rich(sys.stderr):
            spinner = Spinner("dots", "looking at packages, solvers and files ...")
            # Not redirected: packages that are imported meanwhile would keep rich's streams.
            return Live(
                spinner, console=Console(stderr=True), transient=True,
                redirect_stdout=False, redirect_stderr=False,
            )  # fmt: skip
    return nullcontext()


#: Module of each package that tactorch uses, and what needs it, by pip's name.
_PACKAGES: dict[str, tuple[str, str]] = {
    **{name: (name, "everything") for name in ("torch", "numpy", "scipy", "numba", "jaxtyping")},
    "h5py": ("h5py", "recordings and reconstructions (.h5)"),
    "hydra-core": ("hydra", "the command line"),
    "pyyaml": ("yaml", "the command line"),
    "pypardiso": ("pypardiso", "solver=pardiso, the fastest"),
    "pyamg": ("pyamg", "solver=multigrid, for the largest meshes"),
    "pytetwild": ("pytetwild", "meshes of surfaces: phantoms, object=mesh"),
    "vtk": ("vtk", "pytetwild, which brings it"),
    "meshio": ("meshio", "reading and writing meshes and maps (.vtu)"),
    "matplotlib": ("matplotlib", "pictures (plots=false does without)"),
    "rich": ("rich", "progress bars and tables at a terminal"),
    "opencv-python-headless": ("cv2", "tactorch sensor: images and videos"),
    "scikit-image": ("skimage", "scores, markers, meshes from voxels"),
    "lightning": ("lightning", "train, evaluate-model, initialization=surrogate"),
    "tensorboard": ("tensorboard", "train"),
    "joblib": ("joblib", "generate with several workers"),
    "threadpoolctl": ("threadpoolctl", "generate"),
    "dask": ("distributed", "generate executor=dask, on a cluster"),
    "nibabel": ("nibabel", "body: segmentations in NIfTI"),
    "highdicom": ("highdicom", "body: segmentations in DICOM"),
    "rosbags": ("rosbags", "import format=ros2, sensor unpack: bags of ROS"),
}
_EXTRAS = {"dask": "dask", "nibabel": "volumes", "highdicom": "volumes", "rosbags": "ros"}
_CORE = ("torch", "numpy", "scipy", "numba", "jaxtyping", "h5py", "hydra-core", "pyyaml")


def _own_version() -> str:
    try:
        return version("tactorch")
    except PackageNotFoundError:
        return "not installed: run from its folder"


def _import(name: str) -> str:
    """Return the version of a package, if tactorch takes it."""
    module = importlib.import_module(_PACKAGES[name][0])
    try:
        installed = version(name)
    except PackageNotFoundError:  # another build of the same module
        return str(getattr(module, "__version__", "")) or "of unknown version"
    needed = _specifiers().get(name)
    if needed is not None and not needed.contains(installed, prereleases=True):
        raise ConfigError(f"{installed} is installed, and tactorch needs {needed}")
    return installed


@cache
def _specifiers() -> dict[str, Any]:
    """Return the versions that tactorch takes, by package; none where they are not known."""
    try:
        from packaging.requirements import Requirement

        requirements = [Requirement(line) for line in requires("tactorch") or ()]
    except Exception:  # not installed, or what reads it is missing or broken
        return {}
    return {requirement.name.lower(): requirement.specifier for requirement in requirements}


def _install(name: str) -> str:
    """Return the command that installs a package."""
    if name in _EXTRAS:
        return f'pip install "tactorch[{_EXTRAS[name]}]"'
    needed = _specifiers().get(name, "")
    return f'pip install "{name}{needed}"' if str(needed) else f"pip install {name}"


def _solve(backend: str) -> str:
    """Solve equations whose solution is known."""
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


def _any_solver() -> str:
    for name in _SOLVERS:
        with suppress(Exception):  # reported before
            _solve(name)
            return f"solver=auto takes {name}"
    raise ConvergenceError("none of them works")


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


def _missing_gpu() -> str:
    """Return why torch can use no GPU; empty where it can."""
    try:
        import torch

        if torch.version.cuda is None:
            return f"torch {torch.__version__} is built without CUDA"
        if torch.cuda.is_available():
            return ""
        torch.cuda.init()
    except Exception as error:  # no driver, or a broken torch, reported among the packages
        return _reason(error)
    return "torch finds no device"


def _gpu() -> str:
    """Compute on each device, which may be listed and fail."""
    if reason := _missing_gpu():
        raise AbsentError(f"none: {reason}")
    import torch

    names = []
    for k in range(torch.cuda.device_count()):
        if float(torch.ones(8, device=f"cuda:{k}").sum()) != 8.0:
            raise ConfigError(f"device {k} computes a wrong sum")
        names.append(torch.cuda.get_device_name(k))
    return f"{', '.join(names)} (CUDA {torch.version.cuda})"


def _conf() -> str:
    for command in COMMANDS:
        load_schema(command)
    return f"{conf_folder()}"


def _plug_ins() -> list[Finding]:
    """Return the findings of components of other packages."""
    try:
        installed = plug_ins.installed()
    except ConfigError as damage:
        return [Finding("plug-ins", "entry points", False, str(damage), "all of tactorch")]
    findings = []
    for key, error in plug_ins.check(installed).items():
        entries = installed[key]
        names = ", ".join(dict.fromkeys(entry.name for entry in entries))
        remedy = f"pip uninstall {package(entries[0])}, or repair it" if error else ""
        findings.append(Finding("plug-ins", key, not error, error or names, names, remedy))
    return findings


def _numba_cache() -> str:
    from tactorch.linalg.pattern import symmetric_product

    return _writable(Path(symmetric_product.stats.cache_path))


def _writable(folder: Path) -> str:
    """Return a folder in which a file can be made; it is made itself, if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".doctor-"):
        pass
    return f"{folder} ({shutil.disk_usage(folder).free / 1e9:.0f} GB free)"


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


#: Package of each solver, in the order in which solver=auto takes them.
_SOLVERS = {"pardiso": "pypardiso", "superlu": "scipy", "multigrid": "pyamg", "torch_cg": "torch"}
_FACTS = {
    "system": lambda: f"{platform.system()} {platform.machine()}",
    "cores": _cores, "threads": _threads, "memory": _memory,
}  # fmt: skip
_REINSTALL = "pip install --force-reinstall"
CHECKS = (
    Check("packages", "python", platform.python_version),
    Check("packages", "tactorch", _own_version),
    *(
        Check("packages", name, partial(_import, name), feature, _install(name), name in _CORE)
        for name, (_, feature) in _PACKAGES.items()
    ),
    *(
        Check("solvers", name, partial(_solve, name), f"solver={name}", _install(package))
        for name, package in _SOLVERS.items()
    ),
    Check("solvers", "any of them", _any_solver, "every simulation", _install("scipy"), True),
    Check("solvers", "a pressed block", _press, "every simulation",
          "see what is wrong above", True),
    *(Check("machine", name, function, works=None) for name, function in _FACTS.items()),
    Check("machine", "GPU", _gpu, "solver=torch_cg, trainer=gpu",
          "see what nvidia-smi says of its driver"),
    Check("files", "settings (conf)", _conf, "the command line", f"{_REINSTALL} tactorch", True),
    Check("files", "cache of meshes", lambda: _writable(cache_folder()),
          "caching meshes: they are made again each time",
          "set TACTORCH_CACHE to a folder that can be written"),
    Check("files", "cache of numba", _numba_cache,
          "quick starts: kernels are compiled each time",
          "set NUMBA_CACHE_DIR to a folder that can be written"),
    Check("tools", "mesher", _mesh, _PACKAGES["pytetwild"][1], f"{_REINSTALL} pytetwild"),
    Check("tools", "videos", _video, "tactorch sensor: videos",
          f"{_REINSTALL} opencv-python-headless"),
)  # fmt: skip
