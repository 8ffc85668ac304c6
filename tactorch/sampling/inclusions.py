"""The finding of a growing recording: shapes that are fitted to its presses, else its map's."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tactorch.errors import CancelledError, ConvergenceError, FileError
from tactorch.files import read_json, write_json
from tactorch.findings import SHAPES, Finding, build_shape_finding, find
from tactorch.inverse import Reconstruction, Settings, ShapeReconstruction
from tactorch.inverse.shapes import KeptRims, ShapeState
from tactorch.inverse.shapes.draft import DraftShapes
from tactorch.recording import Recording

_COUNT = "presses"  # in the file of the shapes: the number of presses that they are fitted to


class InclusionSearch:
    """Shapes of a growing recording, each fitted from those before.

    The shapes are kept in a file, with the number of presses that they are fitted to.

    Args:
        settings: Settings of the inversions.
        folder: Folder of the run; None keeps no file.
    """

    def __init__(self, settings: Settings, folder: str | Path | None) -> None:
        self._settings, self._kept = settings, KeptRims()
        self._path = None if folder is None else Path(folder) / SHAPES
        self._last: tuple[Finding, int] | None = None  # of shapes, and of how many presses
        self._reached: ShapeState | None = None  # by a search that was stopped

    def present(self, recording: Recording, reconstruction: Reconstruction) -> tuple[Finding, int]:
        """Return the finding before a search, and the number of presses that it is of.

        It is of the last shapes, if there are any. Those of fewer presses give way to a map that
        cannot be trusted, as the new presses may contradict them.

        Args:
            recording: All presses.
            reconstruction: Their map.
        """
        count, last = len(recording.presses), self._last
        if last is not None and (last[1] == count or not reconstruction.warnings):
            return last
        return find(recording, reconstruction, shapes=False, uncertainty=False), count

    def search(
        self, recording: Recording, reconstruction: Reconstruction, stop: Callable[[], bool]
    ) -> Finding:
        """Fit shapes to all presses, and return their finding; that of the map where this fails.

        Raises:
            CancelledError: `stop` returned True. The next search starts from what this one reached.
        """
        try:
            finding = self._find(recording, reconstruction, stop)
        except CancelledError as error:
            self._reached = error.reached or self._reached
            raise
        self._reached = None
        if finding.shapes is not None:
            self._last = finding, len(recording.presses)
            if self._path is not None:
                write_json(self._path, {**finding.shapes.plain(), _COUNT: self._last[1]})
        return finding

    def _find(
        self, recording: Recording, reconstruction: Reconstruction, stop: Callable[[], bool]
    ) -> Finding:
        return find(
            recording, reconstruction, self._settings,
            uncertainty=False, start=self._reached or self.shapes, stop=stop, kept=self._kept,
        )  # fmt: skip

    def restore(self, recording: Recording) -> None:
        """Read the shapes of a run that is continued; those that cannot be read are ignored.

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
            finding = build_shape_finding(recording.select(range(count)), shapes)
            self._last = finding, count

    def clear(self) -> None:
        """Remove the shapes of an earlier run."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    @property
    def shapes(self) -> ShapeReconstruction | None:
        """Shapes that were fitted last; None if there are none."""
        return None if self._last is None else self._last[0].shapes


class DraftInclusionSearch(InclusionSearch):
    """The same by the fast search for balls, `tactorch.inverse.shapes.draft`.

    Args:
        settings: Settings of the inversions.
        folder: Folder of the run; None keeps no file.
        draft: The search.
    """

    def __init__(self, settings: Settings, folder: str | Path | None, draft: DraftShapes) -> None:
        super().__init__(settings, folder)
        self._draft = draft

    def _find(
        self, recording: Recording, reconstruction: Reconstruction, stop: Callable[[], bool]
    ) -> Finding:
        try:
            shapes = self._draft.fit(recording, self.shapes, stop)
        except ConvergenceError as error:
            finding = find(recording, reconstruction, shapes=False, uncertainty=False)
            note = f"The finding is that of the map: no balls can be fitted ({error})."
            return replace(finding, notes=(note, *finding.notes))
        return build_shape_finding(recording, shapes)
