"""Texts of the page: finding, warnings, limitations and tables."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from tactorch.findings import find_lump, measure_depth
from tactorch.findings.text import (
    Fact,
    describe_inclusion,
    format_modulus,
    headline,
    inclusion_facts,
)
from tactorch.metrics import Inclusion, scores
from tactorch.recording import Press, Recording
from tactorch.report.assessment import Assessment
from tactorch.report.runs import Run
from tactorch.text import one_line

_MAX_FACTOR = 2.0  # an interval of a larger factor is reported as a limitation
_MIN_VOLUME = 0.02  # fraction of the volume from which it is reported
_MAX_FIT = 1.5  # standard deviations; a larger residual is reported
# Title of each score and the best value: the minimum, the maximum, or 1.
_SCORES = {
    "rmse_mpa": ("RMSE of the modulus (MPa)", "min"),
    "pearson": ("Correlation", "max"),
    "ssim": ("Structural similarity (SSIM)", "max"),
    "psnr": ("Peak signal-to-noise ratio, PSNR (dB)", "max"),
    "position_error_mm": ("Position error of the centre (mm)", "min"),
    "contrast_recovery": ("Contrast recovery (true contrast: 1)", "one"),
    "dice": ("Overlap of the inclusions (Dice)", "max"),
}
_COST = {
    "fit": ("Residual of the presses (standard deviations)", ""),
    "iterations": ("Iterations", ""),
    "seconds": ("Time (s)", "min"),
}
_Column = dict[str, float]


@dataclass(frozen=True)
class Table:
    """Table whose first column has the names of the rows.

    Attributes:
        caption: Content of the table.
        header: Titles of the columns.
        rows: Cells of each row.
        best: Columns of the best values by row.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    best: Mapping[int, set[int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RunReport:
    """Texts of one run.

    Attributes:
        run: The run.
        assessment: Uncertainty of its map and residuals of its presses.
        inclusion: Most conspicuous inclusion, or None.
        headline: The finding in one line.
        description: The finding in one sentence.
        facts: Location, size, modulus, probability and fit.
        warnings: Reasons not to trust the map at all.
        limitations: Further limitations of the map.
        omitted: What the report omits and why, or empty.
    """

    run: Run
    assessment: Assessment
    inclusion: Inclusion | None
    headline: str
    description: str
    facts: list[Fact]
    warnings: list[str]
    limitations: list[str]
    omitted: str

    @property
    def presses(self) -> Table | None:
        """Residuals of the presses; None without a recording."""
        recording = self.run.recording
        return None if recording is None else press_table(recording, self.assessment)

    @property
    def details(self) -> list[tuple[str, str]]:
        """Settings, recording, summary and log as titles and texts; empty texts are omitted."""
        run = self.run
        config = {key: value for key, value in run.result.config.items() if key != "versions"}
        provenance = config.pop("recording", {})
        summary = "" if run.recording is None else f"{run.recording.summary()}\n\n"
        file = run.summary.get("recording", "unknown")
        texts = {
            "Settings": _to_yaml(config),
            "Recording": f"file: {file}\n{summary}{_to_yaml(provenance)}",
            "Summary as text": run.text,
            "Log": run.log,
        }
        return [(title, text) for title, text in texts.items() if text]


def describe_run(run: Run, assessment: Assessment) -> RunReport:
    """Return the texts of a run."""
    mesh, youngs = run.result.mesh, run.result.youngs
    inclusion = find_lump(mesh, youngs)
    modulus = format_modulus(float(np.median(youngs)))
    fit = math.sqrt(float(run.summary.get("chi2", math.nan)))
    if inclusion is None:
        description = (
            f"Young's modulus is {modulus} and nearly uniform where the presses resolve it."
        )
        facts = [Fact("Young's modulus", modulus, "median")]
    else:
        presses = () if run.recording is None else run.recording.presses
        depth = measure_depth(mesh, presses, inclusion.center_mm, inclusion.elements)
        uncertainty = assessment.uncertainty
        confidence = None if uncertainty is None else uncertainty.confidence
        description = describe_inclusion(inclusion, depth)
        facts = inclusion_facts(inclusion, depth, confidence)
    note = "RMS residual over the noise of the displacements; a good fit is near 1 or below"
    return RunReport(
        run=run,
        assessment=assessment,
        inclusion=inclusion,
        headline=headline(inclusion),
        description=description,
        facts=[*facts, Fact("Fit", f"{fit:.2g} SD", note)],
        warnings=[str(warning) for warning in run.summary.get("warnings", ())],
        limitations=_limitations(run, assessment, inclusion, fit),
        omitted=_omitted(run, assessment),
    )


def _omitted(run: Run, assessment: Assessment) -> str:
    if run.recording is None:
        parts = "truth, contact, presses and uncertainty, because the recording is missing"
    elif assessment.uncertainty is None:
        parts = "credibility and uncertainty"
    else:
        return ""
    return f"Omitted: {parts} ({assessment.missing})."


def _limitations(
    run: Run, assessment: Assessment, inclusion: Inclusion | None, fit: float
) -> list[str]:
    lines = []
    settings = run.result.config.get("settings", {})
    if fit > _MAX_FIT:
        lines.append(
            f"The map does not explain the presses: the residual is {fit:.2g} standard deviations."
        )
    if assessment.uncertainty is not None:
        volumes = run.result.mesh.volumes
        # The comparison is false for NaN, at a bound.
        wide = ~(assessment.uncertainty.relative_half_width <= _MAX_FACTOR - 1.0)
        fraction = float(volumes[wide].sum() / volumes.sum())
        if fraction > _MIN_VOLUME:
            lines.append(
                f"In {100 * fraction:.0f} % of the volume the uncertainty of the modulus exceeds a"
                " factor of two."
            )
    if inclusion is not None and _prior_name(settings) == "total_variation":
        lines.append(
            "Contrast of the inclusion: the prior (total variation) biases it towards the"
            " surroundings, so that the true contrast is often larger than shown and intervals"
            " within the inclusion are too narrow."
        )
    if run.recording is not None and _is_noise_assumed(settings, run.recording):
        lines.append(
            "The noise of the displacements is an assumption; if it is larger, fine detail of the"
            " map is noise and intervals are too narrow."
        )
    for name, estimate in run.result.nuisance.items():
        if not np.isfinite(estimate.deviation).any():
            lines.append(f"The uncertainty of the estimated {name} was not computed.")
        elif not estimate.is_informative:
            lines.append(f"The presses hardly determine the estimated {name}.")
    return lines


def _prior_name(settings: Mapping[str, Any]) -> str:
    prior = settings.get("regularization", "")
    return str(prior.get("name", "") if isinstance(prior, Mapping) else prior)


def _is_noise_assumed(settings: Mapping[str, Any], recording: Recording) -> bool:
    return (
        settings.get("noise", {}).get("mm") is None
        and recording.unloaded is None
        and any(press.noise_mm is None for press in recording.presses)
    )


def press_label(number: int, press: Press) -> str:
    """Return the number and, if it differs, the name of a press."""
    name = one_line(press.name)
    return f"{number}" if name in ("", str(number)) else f"{number}: {name}"


def score_table(runs: Sequence[Run]) -> Table:
    """Return scores against the truth and cost, with the best values marked."""
    columns = {run.name: _scores(run, run.result.youngs) | _cost(run) for run in runs}
    comparable = _distinct(runs, "truth") <= 1
    shared = _distinct(runs, "reference") <= 1 and all(run.name != "reference" for run in runs)
    for run in runs:
        if run.recording is not None and run.recording.reference is not None:
            name = "reference" if shared else f"reference of {run.name}"
            columns[name] = _scores(run, run.recording.reference)
    titles = _SCORES | _COST
    names = [name for name in titles if any(name in column for column in columns.values())]
    rows = [[titles[name][0], *(_cell(c.get(name)) for c in columns.values())] for name in names]
    caption = "Scores against the truth" if set(names) & set(_SCORES) else "Fit and cost"
    if not comparable:
        return Table(
            f"{caption}; the truths differ, so that no best is marked", ["", *columns], rows
        )
    best = {row: _best(titles[name][1], name, columns) for row, name in enumerate(names)}
    return Table(caption, ["", *columns], rows, best)


def _scores(run: Run, youngs: Float[np.ndarray, " m"]) -> _Column:
    if run.recording is None or run.recording.truth is None:
        return {}
    return scores(run.recording.mesh, youngs, run.recording.truth)


def _distinct(runs: Sequence[Run], attribute: str) -> int:
    """Return the number of distinct maps of an attribute of the recordings."""
    recordings = [run.recording for run in runs if run.recording is not None]
    maps = [(one.mesh, getattr(one, attribute)) for one in recordings]
    return len(
        {(mesh.content_hash(), values.tobytes()) for mesh, values in maps if values is not None}
    )


def _cost(run: Run) -> _Column:
    cost = {"iterations": float(run.result.iterations), "seconds": float(run.result.seconds)}
    if run.result.history and "chi2" in run.result.history[-1]:
        cost["fit"] = math.sqrt(float(run.result.history[-1]["chi2"]))
    return cost


def _best(rule: str, name: str, columns: Mapping[str, _Column]) -> set[int]:
    """Return the columns (from 1) with the best value; none if there is no choice."""
    values = np.array([column.get(name, math.nan) for column in columns.values()])
    if not rule or np.isfinite(values).sum() < 2:
        return set()
    cost = {"min": values, "max": -values, "one": np.abs(values - 1.0)}[rule]
    minimum = np.nanmin(cost)
    # Values that the table shows alike are equally good.
    best = np.flatnonzero(cost <= minimum + 1e-4 * max(abs(minimum), 1e-4))
    return {int(column) + 1 for column in best}


def _cell(value: float | None) -> str:
    return "–" if value is None or math.isnan(value) else f"{value:.4g}"


def press_table(recording: Recording, assessment: Assessment) -> Table:
    """Return force, displacement and residual of each press."""
    rows = []
    for number, (press, fit) in enumerate(
        zip(recording.presses, assessment.fits, strict=True), start=1
    ):
        size = float(np.sqrt(np.nanmean(press.displacement[press.data] ** 2)))
        rows.append(
            [
                press_label(number, press),
                f"{np.linalg.norm(press.total_force):.3g}",
                f"{1e3 * size:.4g}",
                f"{1e3 * fit.rms_mm:.3g}",
                f"{fit.rms_deviations:.2g}",
            ]
        )
    header = ["Press", "Force (N)", "Displacement, RMS (µm)", "Residual, RMS (µm)", "Residual (SD)"]
    return Table("Residual of each press (SD: standard deviations)", header, rows)


def history_table(run: Run) -> Table:
    """Return the iterations of a run."""
    rows = [
        [
            f"{record['iteration']}",
            f"{record.get('seconds', math.nan):.1f}",
            f"{record['misfit']:.4g}",
            f"{math.sqrt(record['chi2']):.3g}",
        ]
        for record in run.result.history
    ]
    return Table(run.name, ["Iteration", "Time (s)", "Misfit (mm²)", "Residual (SD)"], rows)


def versions_table(runs: Sequence[Run]) -> Table:
    """Return the versions of the packages that computed the maps."""
    versions = {run.name: run.result.config.get("versions", {}) for run in runs}
    names = list(dict.fromkeys(name for found in versions.values() for name in found))
    rows = [[name, *(str(found.get(name, "–")) for found in versions.values())] for name in names]
    return Table("Versions at the time of the inversion", ["", *versions], rows)


def difference_table(runs: Sequence[Run]) -> Table:
    """Return the settings in which runs differ; without rows if all are the same."""
    flat = {run.name: dict(_flatten(_compared_settings(run))) for run in runs}
    names = list(dict.fromkeys(name for found in flat.values() for name in found))
    rows = [[name, *(found.get(name, "–") for found in flat.values())] for name in names]
    differing = [row for row in rows if len(set(row[1:])) > 1]
    return Table("Settings in which the runs differ", ["", *flat], differing)


def _compared_settings(run: Run) -> dict[str, Any]:
    config = dict(run.result.config)
    settings = dict(config.pop("settings", {}))
    settings.pop("optimizer", None)  # also under its own name
    return (
        {"recording": {"file": run.summary.get("recording")}}
        | settings
        | {name: config[name] for name in ("start_mpa", "optimizer", "material") if name in config}
    )


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)


def _to_yaml(values: Any) -> str:
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
