"""Page of a live session: the viewer of the report, whose content is replaced as presses arrive.

The page `live.html` has everything that is known when it is written. The script `live-data.js`
beside it has what changes, and an open page loads it again and again: that needs no server.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from tactorch.files import write_file
from tactorch.report.content import RunReport
from tactorch.report.figure_data import figure_data, script_json
from tactorch.report.write import asset, make_environment

PAGE, SCRIPT = "live.html", "live-data.js"
_SCRIPTS = ("core.js", "mesh.js", "slices.js", "solid.js", "controls.js", "live.js")
_MESH = ("points", "tets", "surface", "bounds")  # of the data of a run


@dataclass(frozen=True, eq=False)
class NextPress:
    """A round patch to press next.

    Attributes:
        center_mm: Centre, (3,), mm.
        inward: Unit normal into the object, (3,).
        radius_mm: Radius, mm.
    """

    center_mm: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]
    radius_mm: float

    def plain(self) -> dict[str, Any]:
        """Return plain values for the page."""
        center, inward = self.center_mm.tolist(), self.inward.tolist()
        return {"center": center, "inward": inward, "radius": self.radius_mm}


@dataclass(frozen=True, eq=False)
class LivePage:
    """Content of the page.

    Attributes:
        name: Name of the session.
        version: Number of the content; later ones are larger.
        texts: Text of each of `status`, `headline`, `finding` and `next`; an empty one is hidden.
        columns: Titles of the table of updates.
        rows: Its cells, the last update first.
        notes: Warnings.
        report: Map and finding; None before the first update.
        next_press: Place that was chosen for the next press, if there is one.
        ended: Whether the session has ended, so that the page needs no further content.
    """

    name: str
    version: int
    texts: Mapping[str, str]
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()
    report: RunReport | None = None
    next_press: NextPress | None = None
    ended: bool = False
    _data: dict[str, Any] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        reports = [] if self.report is None else [self.report]
        data = figure_data(reports, "viridis")
        for run in data["runs"]:
            run["next"] = None if self.next_press is None else self.next_press.plain()
        mesh = "" if self.report is None else self.report.run.result.mesh.content_hash()[:16]
        data |= {"version": self.version, "mesh": mesh, "script": SCRIPT, "ended": self.ended}
        object.__setattr__(self, "_data", data)

    def write(self, folder: Path) -> None:
        """Write page and script into a folder, each of them whole."""
        write_file(folder / PAGE, self.html())
        write_file(folder / SCRIPT, f"window.tactorchLive({script_json(self.update())});\n")

    def html(self) -> str:
        """Return the page; all text is escaped."""
        return (
            make_environment()
            .get_template("live.html")
            .render(
                page=self,
                style=Markup(asset("style.css")),
                script=Markup("\n".join(asset(name) for name in _SCRIPTS)),
                data=Markup(script_json(self._data)),
            )
        )

    def update(self) -> dict[str, Any]:
        """Return what replaces the content of an open page, as JSON values."""
        runs = [{k: v for k, v in run.items() if k not in _MESH} for run in self._data["runs"]]
        update = {name: self._data[name] for name in ("version", "mesh", "ended", "limits")}
        texts = {"texts": dict(self.texts), "notes": list(self.notes)}
        rows = [list(row) for row in self.rows]
        update |= {**texts, "rows": rows, "run": runs[0] if runs else None}
        return update
