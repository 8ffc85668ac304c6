"""The page: text and tables as they stand, and the places where scripts draw."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files
from string import Template
from typing import Any

import matplotlib
import numpy as np
import yaml

from tactorch.report.belief import Judgement
from tactorch.report.data import FIELDS, run_data
from tactorch.report.encode import packed, script_json
from tactorch.report.finding import Finding
from tactorch.report.html import bullets, element, folded, text
from tactorch.report.runs import Run
from tactorch.report.tables import (
    difference_table,
    history_table,
    press_table,
    score_table,
    versions_table,
)
from tactorch.versions import versions
from tactorch.viz.slicing import colour_scale

_SCRIPTS = ("core.js", "mesh.js", "slices.js", "solid.js", "charts.js", "main.js")
_MODULI = ("youngs", "truth", "reference")
_MAPS = {"viridis": "viridis", "cividis": "cividis", "ultrasound": "gray"}
_PERCENTILE = 99.5  # lone elements beyond it do not stretch a colour scale


@dataclass(frozen=True, eq=False)
class Told:
    """A run with all that is told of it."""

    run: Run
    judged: Judgement
    finding: Finding


def document(told: Sequence[Told], colours: str) -> str:
    """Return the whole page."""
    one = len(told) == 1
    first = told[0]
    title = f"{first.run.name}: {first.finding.headline}" if one else f"{len(told)} runs compared"
    parts = [
        _hero(first) if one else _heroes(told),
        _part("slices", "Slices", _SLICES if one else _SLICES_OF_MANY),
        _part("presses", "Presses: observed and foretold", _presses(told)),
        _part("scores", "Scores", _scores(told)),
        _part("convergence", "Convergence", _convergence(told)),
        _part("settings", "How it was made", _made(told)),
    ]
    return Template(_asset("page.html")).substitute(
        title=text(title),
        subject=text(", ".join(one.run.name for one in told)),
        made=text(_made_on(told)),
        style=_asset("style.css"),
        body="\n".join(part for part in parts if part),
        data=script_json(_data(told, colours)),
        script="\n".join(_asset(name) for name in _SCRIPTS),
    )


def _asset(name: str) -> str:
    return (files("tactorch.report") / "page" / name).read_text(encoding="utf-8")


def _part(name: str, title: str, inner: str) -> str:
    """Return a section, or nothing where there is nothing to tell."""
    if not inner:
        return ""
    heading = element("h2", text(title), id=f"{name}-title")
    return element("section", heading + inner, id=name, aria_labelledby=f"{name}-title")


def _made_on(told: Sequence[Told]) -> str:
    made = versions()["tactorch"]
    return f"{datetime.now().astimezone():%d %B %Y, %H:%M} by tactorch {made}"


# ------------------------------------------------------------------ the top

_DOUBT = "What it shows, for what that is worth"


def _hero(told: Told) -> str:
    words = _alarms(told.finding)
    if told.finding.alarms:
        shown = f"{_DOUBT}: {_lower(told.finding.headline)}"
        words += element("h1", text(shown), class_="doubted")
    else:
        words += element("h1", text(told.finding.headline))
    words += element("p", text(told.finding.text), class_="lead")
    words += _facts(told.finding) + _cautions(told.finding) + _absent(told)
    return element("section", element("div", words, class_="words") + _solid(1), class_="hero")


def _lower(line: str) -> str:
    return line[:1].lower() + line[1:]


def _heroes(told: Sequence[Told]) -> str:
    cards = "".join(
        element(
            "article",
            element("h2", text(one.run.name))
            + _alarms(one.finding)
            + _lead(one.finding)
            + _facts(one.finding)
            + _cautions(one.finding)
            + _absent(one),
            class_="card",
        )
        for one in told
    )
    heading = element("h1", f"{len(told)} runs compared")
    cards = element("div", cards, class_="cards")
    return element("section", heading + cards + _solid(len(told)), class_="heroes")


def _lead(found: Finding) -> str:
    if not found.alarms:
        return element("p", text(found.headline), class_="lead")
    return element("p", text(f"{_DOUBT}: {_lower(found.headline)}"), class_="lead doubted")


def _alarms(found: Finding) -> str:
    if not found.alarms:
        return ""
    told = "".join(element("p", text(_sentence(line))) for line in found.alarms)
    title = '<strong><span aria-hidden="true">⚠</span> Do not trust this map</strong>'
    return element("div", title + told, class_="alarm", role="alert")


def _sentence(line: str) -> str:
    """Return an alarm without the words that stand above it."""
    rest = re.sub(r"^DO NOT TRUST THIS MAP:?\s*", "", line)
    return rest[:1].upper() + rest[1:]


def _facts(found: Finding) -> str:
    items = "".join(
        f"<div><dt>{text(fact.label)}</dt><dd>{text(fact.value)}"
        f"<small>{text(fact.note)}</small></dd></div>"
        for fact in found.facts
    )
    return element("dl", items, class_="facts")


def _cautions(found: Finding) -> str:
    if not found.cautions:
        return ""
    title = element("h3", "What not to believe")
    return element("div", title + bullets(found.cautions), class_="cautions")


def _absent(told: Told) -> str:
    """Say what is not in the report, and why."""
    if told.run.recording is None:
        what = "truth, contact, presses and uncertainty are left out: the recording is not there"
    elif told.judged.belief is None:
        what = "credibility and uncertainty are left out"
    else:
        return ""
    return element("p", text(f"Not in this report: {what} ({told.judged.missing})."), class_="note")


def _solid(count: int) -> str:
    """Return the place of the 3-D views, one a run, with controls for all of them."""
    views = "".join(
        '<div class="view"><canvas class="gl" tabindex="0" role="img"></canvas>'
        '<canvas class="overlay" aria-hidden="true"></canvas><img class="still" alt="">'
        '<p class="none" hidden></p><p class="label"></p><p class="paper"></p></div>'
        for _ in range(count)
    )
    return element("figure", element("div", views, class_="views") + _SOLID, class_="solid")


_SOLID = """
<div class="controls" id="solid-controls">
  <span class="wide"><label for="level">Surface at</label>
    <output id="level-out" for="level"></output>
    <input type="range" id="level" min="0" max="1000" step="1"></span>
  <label>Cut across
    <select id="cut"><option value="">nothing</option><option value="0">x</option>
    <option value="1">y</option><option value="2">z</option></select></label>
  <span class="wide" id="cut-place"><label for="cut-at">Cut at</label>
    <output id="cut-out" for="cut-at"></output>
    <input type="range" id="cut-at" min="0" max="1000" step="1"></span>
  <label class="tick" id="flip"><input type="checkbox" id="cut-flip"> other side</label>
  <span class="buttons" role="group" aria-label="Point of view">
    <button type="button" data-view="oblique">Oblique</button>
    <button type="button" data-view="x">x</button>
    <button type="button" data-view="y">y</button>
    <button type="button" data-view="z">z</button></span>
</div>
<figcaption>Drag, or the arrow keys, to turn; + and − to enlarge. The solid surface is where the
modulus, smoothed to the nodes, passes the value chosen; faces that were pressed are tinted.
</figcaption>"""

_LOOK = """
  <label>Colours <select id="colours"><option value="viridis">viridis</option>
    <option value="cividis">cividis</option>
    <option value="ultrasound">grey (ultrasound)</option></select></label>
  <label>Scale <select id="scale"><option value="linear">linear</option>
    <option value="log">logarithmic</option></select></label>
  <label class="tick"><input type="checkbox" id="outlines" checked> outlines</label>
"""

_GRID = """
<div id="grid" class="grid"></div>
<p class="legend" id="legend"></p>
<p class="readout" id="readout" aria-live="polite">Point at a slice to read its numbers; click to
move the other slices there.</p>
<p class="note" id="field-notes"></p>
<div id="print-slices" aria-hidden="true"></div>"""

_SLICES = f"""
<div class="controls">
  <fieldset id="shown"><legend>Show</legend></fieldset>{_LOOK}</div>{_GRID}"""

_SLICES_OF_MANY = f"""
<div class="controls">
  <label>Show <select id="quantity"></select></label>{_LOOK}</div>{_GRID}"""


# ------------------------------------------------------------------ further down


def _presses(told: Sequence[Told]) -> str:
    tables = ""
    for one in told:
        if one.run.recording is not None:
            inner = press_table(one.run.recording, one.judged)
            tables += folded(f"All presses of {one.run.name} in numbers", inner)
    if not tables:
        return ""
    choice = "" if len(told) == 1 else '<label>Run <select id="press-run"></select></label>'
    return f"""
<div class="controls">{choice}<label>Press <select id="press"></select></label>
<output id="press-out"></output></div>
<p class="paper" id="press-told"></p>
<div class="row">
  <figure><canvas id="scatter" role="img"></canvas>
    <figcaption>Each displacement of the touched surface: what the map foretells against what was
    observed. On the line they are equal.</figcaption></figure>
  <figure><canvas id="felt" role="img"></canvas>
    <figcaption>Observed, foretold, and their difference in standard deviations, on the surface
    seen along the press. The larger a disc of the third, the larger the difference.
    </figcaption></figure>
</div>
<p class="note" id="press-note"></p>{tables}"""


def _scores(told: Sequence[Told]) -> str:
    table = score_table([one.run for one in told])
    if any(one.run.recording is not None and one.run.recording.truth is not None for one in told):
        return table
    return '<p class="note">There is no truth to score the map against.</p>' + table


def _convergence(told: Sequence[Told]) -> str:
    reasons = [
        f"{one.run.name}: {one.run.found.iterations} iterations, {one.run.found.seconds:.0f} s;"
        f" stopped because: {one.run.found.stop_reason}."
        for one in told
    ]
    tables = "".join(history_table(one.run) for one in told)
    return f"""
<figure><canvas id="curve" role="img"></canvas>
<figcaption>How far the presses were missed at each iteration, in standard deviations of their
noise; at the line they are fitted to it.</figcaption></figure>
{bullets(reasons)}{folded("Iterations in numbers", tables)}"""


def _made(told: Sequence[Told]) -> str:
    runs = [one.run for one in told]
    parts = difference_table(runs) if len(runs) > 1 else ""
    for run in runs:
        kept = {key: value for key, value in run.found.config.items() if key != "versions"}
        source = kept.pop("recording", {})
        of = f" of {run.name}" if len(runs) > 1 else ""
        about = "" if run.recording is None else run.recording.summary() + "\n\n"
        parts += folded(f"Settings{of}", _listing(_yaml(kept)))
        file = f"file: {run.summary.get('recording', 'not named')}\n{about}"
        parts += folded(f"Recording{of}", _listing(file + _yaml(source)))
        if run.text:
            parts += folded(f"Summary as text{of}", _listing(run.text))
        if run.log:
            parts += folded(f"Log{of}", _listing(run.log))
    return parts + folded("Versions", versions_table(runs))


def _listing(content: str) -> str:
    return f'<pre tabindex="0">{text(content)}</pre>'


def _yaml(values: Any) -> str:
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))


# ------------------------------------------------------------------ what scripts draw from


def _data(told: Sequence[Told], colours: str) -> dict[str, Any]:
    runs = [run_data(one.run, one.judged, one.finding) for one in told]
    return {
        "runs": runs,
        "fields": {
            name: dict(zip(("title", "unit", "note"), of, strict=True))
            for name, of in FIELDS.items()
        },
        "limits": _limits(told),
        "colours": colours,
        "maps": {name: _colour_map(known) for name, known in _MAPS.items()},
    }


def _colour_map(name: str) -> dict[str, Any]:
    shades = matplotlib.colormaps[name](np.linspace(0.0, 1.0, 256))[:, :3]
    return packed(np.rint(255.0 * shades), "uint8")


def _limits(told: Sequence[Told]) -> dict[str, list[float]]:
    """Ends of each field's colours, the same for all runs."""
    maps = {"reconstruction": np.concatenate([one.run.found.youngs for one in told])}
    truths = [one.run.recording.truth for one in told if one.run.recording is not None]
    known = [truth for truth in truths if truth is not None]
    if known:
        maps["truth"] = np.concatenate(known)
    norm = colour_scale(maps, "linear", None)
    limits = {name: [float(norm.vmin or 0.0), float(norm.vmax or 1.0)] for name in _MODULI}
    beliefs = [one.judged.belief for one in told if one.judged.belief is not None]
    if beliefs:
        spread = np.concatenate([100.0 * belief.spread for belief in beliefs])
        felt = np.concatenate([belief.credibility for belief in beliefs])
        resolved = np.concatenate([100.0 * belief.resolution for belief in beliefs])
        spread = spread[np.isfinite(spread)]
        limits["spread"] = [0.0, float(np.percentile(spread, _PERCENTILE)) if len(spread) else 1.0]
        top = float(np.percentile(felt, _PERCENTILE)) or 1.0
        limits["credibility"] = [max(float(felt.min()), 1e-4 * top), top]
        limits["resolution"] = [0.0, float(np.percentile(resolved, _PERCENTILE)) or 1.0]
    return limits
