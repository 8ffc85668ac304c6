"""Versions of what a result depends on."""

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "pytetwild", "hydra-core")


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that decide results."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found
