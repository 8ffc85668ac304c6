"""Tactile elastography: from presses on a soft object to a map of its Young's modulus.

Units are mm, N, MPa and tonne/mm^3 everywhere. The names below are the ones that most users need;
they load on first use, so that `import tactorch` is fast.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Threads that wait for work sleep, as other processes may use the cores. The libraries read these
# variables when they are loaded.
os.environ.setdefault("KMP_BLOCKTIME", "0")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# What OpenCV and FFmpeg print about a damaged file, tactorch reports with its name and the remedy.
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

if TYPE_CHECKING:
    from tactorch.fem import SoftBody, Supports, make_material
    from tactorch.importers import import_published
    from tactorch.inverse import GaussNewton, Reconstruction, Settings, find_lump, invert
    from tactorch.loading import load
    from tactorch.mesh import TetMesh, read_mesh, tetrahedralize
    from tactorch.metrics import find_inclusion, scores
    from tactorch.phantoms import Phantom, make_phantom
    from tactorch.recording import MaterialSpec, Press, Recording
    from tactorch.simulation import PressPlan, simulate

_HOMES = {
    "tactorch.fem": ("SoftBody", "Supports", "make_material"),
    "tactorch.importers": ("import_published",),
    "tactorch.inverse": ("GaussNewton", "Reconstruction", "Settings", "find_lump", "invert"),
    "tactorch.loading": ("load",),
    "tactorch.mesh": ("TetMesh", "read_mesh", "tetrahedralize"),
    "tactorch.metrics": ("find_inclusion", "scores"),
    "tactorch.phantoms": ("Phantom", "make_phantom"),
    "tactorch.recording": ("MaterialSpec", "Press", "Recording"),
    "tactorch.simulation": ("PressPlan", "simulate"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "GaussNewton",
    "MaterialSpec",
    "Phantom",
    "Press",
    "PressPlan",
    "Reconstruction",
    "Recording",
    "Settings",
    "SoftBody",
    "Supports",
    "TetMesh",
    "find_inclusion",
    "find_lump",
    "import_published",
    "invert",
    "load",
    "make_material",
    "make_phantom",
    "read_mesh",
    "scores",
    "simulate",
    "tetrahedralize",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its home at first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'tactorch' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
