"""Readers of other formats; each returns a `tactorch.recording.Recording`."""

from tactorch.config import Registry
from tactorch.importers.published import PublishedOptions, import_published

#: Formats by name; calling the settings of one with `folder=` reads a recording.
FORMATS = Registry("format", {"published": "tactorch.importers:PublishedOptions"})

__all__ = ["FORMATS", "PublishedOptions", "import_published"]
