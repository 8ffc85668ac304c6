"""Page of a live session: the viewer of the report, whose content is replaced as presses arrive.

The page `live.html` has everything that is known when it is written. The script `live-data.js`
beside it has what changes, and an open page loads it again and again: that needs no server.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tactorch.files import write_file
from tactorch.report.content import RunReport
from tactorch.report.figure_data import figure_data, script_json
from tactorch.report.write import render
from tactorch.sampling import Patch

PAGE, SCRIPT = "live.html", "live-data.js"
_SCRIPTS = ("core.js", "mesh.js", "slices.js", "solid.js", "controls.js", "live.js")
_MESH = ("points", "tets", "surface", "bounds")  # of the data of a run


@dataclass(frozen=True, eq=False)
class LivePage:
    """Content of the page."""

    name: str  # of the session
    version: int  # of the content; later ones are larger
    texts: Mapping[str, str]  # `status`, `headline`, `finding` and `next`; empty ones are hidden
    columns: Sequence[str] = ()  # titles of the table of updates
    rows: Sequence[Sequence[str]] = ()  # its cells, the last update first
    notes: Sequence[str] = ()  # warnings
    report: RunReport | None = None  # map and finding; None before the first update
    next_press: Patch | None = None  # place that was chosen for the next press
    ended: bool = False  # the page needs no further content

    @cached_property
    def _data(self) -> dict[str, Any]:
        report, place, following = self.report, self.next_press, None
        if place is not None:
            center, inward = place.center.tolist(), place.inward.tolist()
            following = {"center": center, "inward": inward, "radius": float(place.radius_mm)}
        data = figure_data([] if report is None else [report], "viridis")
        data["runs"] = [run | {"next": following} for run in data["runs"]]
        mesh = "" if report is None else report.run.result.mesh.content_hash()[:16]
        return data | {"version": self.version, "mesh": mesh, "script": SCRIPT, "ended": self.ended}

    def write(self, folder: Path) -> None:
        """Write page and script into a folder, each of them whole."""
        page = render("live.html", _SCRIPTS, self._data, page=self)
        write_file(folder / PAGE, page)
        write_file(folder / SCRIPT, f"window.tactorchLive({script_json(self._update())});\n")

    def _update(self) -> dict[str, Any]:
        """Return what replaces the content of an open page, as JSON values."""
        runs = [{k: v for k, v in run.items() if k not in _MESH} for run in self._data["runs"]]
        update = {name: self._data[name] for name in ("version", "mesh", "ended", "limits")}
        content = {"texts": self.texts, "notes": self.notes, "rows": self.rows}
        return update | content | {"run": runs[0] if runs else None}
