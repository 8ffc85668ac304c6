"""The result of a growing recording: inclusions that are fitted to its presses, else its map."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tactorch.errors import UNCOMPUTABLE, CancelledError, FileError
from tactorch.files import read_json, write_json
from tactorch.inverse import Reconstruction, Settings, ShapeReconstruction, invert
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.result.build import config_of, of_inclusions
from tactorch.inverse.search.draft import DraftShapes
from tactorch.inverse.search.model import Start
from tactorch.recording import Recording

SHAPES = "shapes.json"  # the inclusions that were fitted last, and to how many presses
_COUNT = "presses"


class InclusionSearch:
    """Inclusions of a growing recording, each fitted from those before.

    They are kept in a file, with the number of presses that they are fitted to.

    Args:
        settings: Settings of the inversions.
        folder: Folder of the run; None keeps no file.
        draft: Fast search for balls instead of that of `invert`.
    """

    def __init__(
        self, settings: Settings, folder: str | Path | None, draft: DraftShapes | None = None
    ) -> None:
        self._draft = draft
        self._settings, self._kept = replace(settings, method="inclusions"), KeptRims()
        self._path = None if folder is None else Path(folder) / SHAPES
        self._last: tuple[Reconstruction, int] | None = None  # of inclusions, and how many presses
        self._reached: Start | None = None  # by a search that was stopped

    def present(self, recording: Recording, elements: Reconstruction) -> tuple[Reconstruction, int]:
        """Return the result before a search, and the number of presses that it is of.

        It is by the last inclusions, if there are any. Those of fewer presses give way to a map
        that cannot be trusted, as the new presses may contradict them.

        Args:
            recording: All presses.
            elements: Their element map.
        """
        count, last = len(recording.presses), self._last
        if last is not None and (last[1] == count or not elements.reasons):
            return replace(last[0], other=elements), last[1]
        return elements, count

    def search(
        self, recording: Recording, elements: Reconstruction, stop: Callable[[], bool]
    ) -> Reconstruction:
        """Fit inclusions to all presses; return the element map where this fails.

        Raises:
            CancelledError: `stop` returned True. The next search starts from what this one reached.
        """
        try:
            result = self._find(recording, stop)
        except CancelledError as error:
            self._reached = error.reached or self._reached
            raise
        except UNCOMPUTABLE as error:
            self._reached, reason = None, str(error).rstrip(".") or "not enough memory"
            return elements.with_warning(f"No inclusions can be fitted ({reason}).")
        self._reached = None
        self._last = result, len(recording.presses)
        if self._path is not None and result.shapes is not None:
            write_json(self._path, {**result.shapes.plain(), _COUNT: self._last[1]})
        return replace(result, other=elements)

    def _find(self, recording: Recording, stop: Callable[[], bool]) -> Reconstruction:
        if self._draft is not None:
            return self._result(recording, self._draft.fit(recording, self.shapes, stop))
        search: dict[str, Any] = {"start": self._reached or self.shapes, "kept": self._kept}
        return invert(recording, self._settings, stop=stop, **search)

    def restore(self, recording: Recording) -> None:
        """Read the inclusions of a run that is continued; those that cannot be read are ignored.

        Args:
            recording: All presses of the run.
        """
        if self._path is None or not self._path.is_file():
            return
        try:
            values = read_json(self._path, "shapes", "delete it.")
            shapes, count = ShapeReconstruction.of(values), int(values[_COUNT])
        except (FileError, KeyError, TypeError, ValueError):
            return
        if 0 < count <= len(recording.presses):
            self._last = self._result(recording.select(range(count)), shapes), count

    def _result(self, recording: Recording, shapes: ShapeReconstruction) -> Reconstruction:
        return of_inclusions(recording, shapes, config_of(recording, self._settings), 0.0)

    def clear(self) -> None:
        """Remove the inclusions of an earlier run."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    @property
    def shapes(self) -> ShapeReconstruction | None:
        """Inclusions that were fitted last; None if there are none."""
        return None if self._last is None else self._last[0].shapes
