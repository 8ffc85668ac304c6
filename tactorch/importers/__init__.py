"""Readers of other formats; each returns a `tactorch.recording.Recording`."""

from tactorch.config import Registry, options_from_arguments
from tactorch.importers.published import import_published

#: Formats by name; calling the settings of one with `folder=` reads a recording.
FORMATS = Registry("format", {"published": "tactorch.importers:PublishedOptions"})
PublishedOptions = options_from_arguments(import_published, "format", without=("folder",))

__all__ = ["FORMATS", "import_published"]
