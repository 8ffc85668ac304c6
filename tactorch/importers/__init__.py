"""Readers of other formats; each returns a `tactorch.recording.Recording`."""

from tactorch.config import Registry
from tactorch.importers.palpation import PalpationOptions, import_palpation
from tactorch.importers.published import PublishedOptions, import_published
from tactorch.importers.ros2 import Ros2Options, import_ros2

#: Formats by name; calling the settings of one with `path=` reads a recording.
FORMATS = Registry(
    "format",
    {
        "published": "tactorch.importers:PublishedOptions",
        "palpation": "tactorch.importers:PalpationOptions",
        "ros2": "tactorch.importers:Ros2Options",
    },
)

__all__ = [
    "FORMATS",
    "PalpationOptions",
    "PublishedOptions",
    "Ros2Options",
    "import_palpation",
    "import_published",
    "import_ros2",
]
