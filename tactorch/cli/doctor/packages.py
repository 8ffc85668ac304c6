"""Packages: whether they can be imported, and whether tactorch takes their version."""

import importlib
import platform
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from typing import NamedTuple

from tactorch.cli.doctor.finding import Finding, looked_at
from tactorch.errors import ConfigError

PART = "packages"


class Package(NamedTuple):
    """A package.

    Attributes:
        name: As pip knows it.
        module: As Python does.
        feature: What does not work without it.
        core: Whether nothing works without it.
        extra: Of tactorch's extras, the one that brings it.
    """

    name: str
    module: str
    feature: str
    core: bool = False
    extra: str = ""


_ALL = "everything"
PACKAGES = (
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


def look_at_packages() -> Iterator[Finding]:
    """Look at Python, at tactorch, and at every package."""
    yield looked_at(PART, "python", platform.python_version)
    yield looked_at(PART, "tactorch", _tactorch)
    for package in PACKAGES:
        yield _look_at(package)


def _tactorch() -> str:
    try:
        return version("tactorch")
    except PackageNotFoundError:
        return "not installed: run from its folder"


def _look_at(package: Package) -> Finding:
    remedy = install(package)

    def look() -> str:
        module = importlib.import_module(package.module)
        return _checked(package, getattr(module, "__version__", ""))

    return looked_at(PART, package.name, look, package.feature, remedy, package.core)


def _checked(package: Package, own: object) -> str:
    """Return the version, if tactorch takes it."""
    try:
        found = version(package.name)
    except PackageNotFoundError:  # another build of the same module
        return str(own) or "of unknown version"
    wanted = _ranges().get(package.name, "")
    if wanted:
        from packaging.specifiers import SpecifierSet

        if not SpecifierSet(wanted).contains(found, prereleases=True):
            raise ConfigError(f"{found} is installed, and tactorch needs {wanted}")
    return found


def install(package: Package) -> str:
    """Return the command that installs a package."""
    if package.extra:
        return f'pip install "tactorch[{package.extra}]"'
    wanted = _ranges().get(package.name, "")
    return f'pip install "{package.name}{wanted}"' if wanted else f"pip install {package.name}"


@cache
def _ranges() -> dict[str, str]:
    """Return the versions that tactorch takes, by package; none where that cannot be told."""
    try:
        from packaging.requirements import Requirement

        needed = [Requirement(line) for line in requires("tactorch") or ()]
    except Exception:  # not installed, or what reads it is missing or broken
        return {}
    return {r.name.lower(): str(r.specifier) for r in needed}
