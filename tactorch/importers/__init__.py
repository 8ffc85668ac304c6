"""Readers of other people's data; each gives a `tactorch.recording.Recording`."""

from tactorch.importers.published import import_published

__all__ = ["import_published"]
