"""Readers of other formats; each returns a `tactorch.recording.Recording`."""

from tactorch.config import Registry
from tactorch.importers.grasp import GraspOptions, import_grasp
from tactorch.importers.palpation import PalpationOptions, import_palpation
from tactorch.importers.published import PublishedOptions, import_published
from tactorch.importers.ros2 import Ros2Options, import_ros2
from tactorch.importers.table import TableOptions, import_table
from tactorch.importers.vtk import VtkOptions, import_vtk

#: Formats by name; calling the settings of one with `path=` reads a recording.
FORMATS = Registry(
    "format",
    {
        "published": "tactorch.importers:PublishedOptions",
        "palpation": "tactorch.importers:PalpationOptions",
        "grasp": "tactorch.importers:GraspOptions",
        "table": "tactorch.importers:TableOptions",
        "vtk": "tactorch.importers:VtkOptions",
        "ros2": "tactorch.importers:Ros2Options",
    },
)

__all__ = [
    "FORMATS",
    "GraspOptions",
    "PalpationOptions",
    "PublishedOptions",
    "Ros2Options",
    "TableOptions",
    "VtkOptions",
    "import_grasp",
    "import_palpation",
    "import_published",
    "import_ros2",
    "import_table",
    "import_vtk",
]
