"""Content of the page about each run: figures, finding, limitations and tables."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import yaml
from jaxtyping import Bool, Float

from tactorch.findings import Finding, Lump, Status
from tactorch.findings.text import Fact, describe_lump, format_modulus, headline, lump_facts
from tactorch.metrics import Inclusion, scores
from tactorch.recording import Press
from tactorch.report.runs import Run
from tactorch.text import one_line

_MAX_FACTOR = 2.0  # an interval of a larger factor is reported as a limitation
_MIN_VOLUME = 0.02  # fraction of the volume from which it is reported
_MAX_LISTED, _LISTED = 100, 20  # presses up to which all are shown, and the number of those of more
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
    """Table whose first column has the names of the rows."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    best: Mapping[int, set[int]] = field(default_factory=dict)  # columns of the best values by row


@dataclass(frozen=True, eq=False)
class UncertaintySummary:
    """Uncertainty of the modulus of each element."""

    credibility: Float[np.ndarray, " m"]  # L of eq. (15) of the paper, mm/MPa
    low: Float[np.ndarray, " m"]  # ends of the 95 % interval, MPa
    high: Float[np.ndarray, " m"]
    resolution: Float[np.ndarray, " m"]  # 1 if the data determine the modulus, 0 if the prior does
    at_bound: Bool[np.ndarray, " m"]  # whether a bound of the moduli truncates the interval
    kind: str  # class of the posterior

    @property
    def relative_half_width(self) -> Float[np.ndarray, " m"]:
        """Relative half width of the interval (m,): 0.3 is a factor of 1.3; NaN at a bound."""
        return np.where(self.at_bound, np.nan, np.sqrt(self.high / self.low) - 1.0)


@dataclass(frozen=True, eq=False)
class PressFit:
    """Residual of one press: predicted less observed displacement; NaN if not observed."""

    residual: Float[np.ndarray, "n 3"]  # mm
    deviations: Float[np.ndarray, "n 3"]  # in standard deviations, weighted as in the inversion
    others: Float[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))  # of other data

    @property
    def rms_mm(self) -> float:
        """Root mean square residual of displacements of nodes, mm; NaN without any."""
        return _rms(self.residual)

    @property
    def rms_deviations(self) -> float:
        """Root mean square residual of all data, standard deviations."""
        return _rms(np.concatenate([self.deviations.ravel(), self.others]))


@dataclass(frozen=True, eq=False)
class RunReport:
    """One run: its finding, uncertainty and residuals, and texts about them."""

    run: Run
    finding: Finding
    uncertainty: UncertaintySummary | None = None
    fits: Sequence[PressFit] = ()
    missing: str = ""  # reason why something is missing
    # Whether the discretisation error is removed from the residuals; None if the inversion does
    # not correct it.
    corrected: bool | None = False

    @property
    def lump(self) -> Lump | None:
        """Most conspicuous lump."""
        return next(iter(self.finding.lumps), None)

    @property
    def inclusion(self) -> Inclusion | None:
        """Most conspicuous inclusion."""
        return None if self.lump is None else self.lump.inclusion

    @property
    def headline(self) -> str:
        """The finding in one line."""
        if self.finding.status is Status.UNKNOWN:
            return "The presses cannot tell whether there is an inclusion"
        count = len(self.finding.lumps)
        return headline(self.inclusion) if count < 2 else f"{count} inclusions"

    @property
    def description(self) -> str:
        """The finding in one sentence."""
        if self.lump is not None:
            first = f"{headline(self.lump.inclusion)}. " if len(self.finding.lumps) > 1 else ""
            return first + describe_lump(self.lump)
        if self.finding.status is Status.UNKNOWN:
            return " ".join(reason[0].upper() + reason[1:] for reason in self.finding.reasons)
        modulus = format_modulus(float(np.median(self.run.result.youngs)))
        return f"Young's modulus is {modulus} and nearly uniform where the presses resolve it."

    @property
    def others(self) -> list[str]:
        """Sentences on all lumps but the most conspicuous."""
        return [lump.text() for lump in self.finding.lumps[1:]]

    @property
    def facts(self) -> list[Fact]:
        """Location, size, modulus, probability and fit."""
        modulus = format_modulus(float(np.median(self.run.result.youngs)))
        facts = [Fact("Young's modulus", modulus, "median")]
        if self.lump is not None:
            facts = lump_facts(self.lump)
        note = "RMS residual over the noise of the displacements; a good fit is near 1 or below"
        return [*facts, Fact("Fit", f"{_fit(self.run):.2g} SD", note)]

    @property
    def omitted(self) -> str:
        """What the report omits and why, or empty."""
        if self.run.recording is None:
            parts = "truth, contact, presses and uncertainty, because the recording is missing"
        elif self.uncertainty is None:
            parts = "credibility and uncertainty"
        else:
            return ""
        reason = self.missing.rstrip(".")
        return f"Omitted: {parts} ({reason})."

    @property
    def limitations(self) -> list[str]:
        """Further limitations of the map and of the recording."""
        run, uncertainty, lines = self.run, self.uncertainty, list(self.finding.notes)
        if _fit(run) > _MAX_FIT:
            lines.append(
                f"The map does not explain the presses: the residual is {_fit(run):.2g} standard"
                " deviations."
            )
        if uncertainty is not None:
            volumes = run.result.mesh.volumes
            # The comparison is false for NaN, at a bound.
            wide = ~(uncertainty.relative_half_width <= _MAX_FACTOR - 1.0)
            fraction = float(volumes[wide].sum() / volumes.sum())
            if fraction > _MIN_VOLUME:
                lines.append(
                    f"In {100 * fraction:.0f} % of the volume the uncertainty of the modulus"
                    " exceeds a factor of two."
                )
        prior = run.result.config.get("settings", {}).get("regularization", "")
        prior_name = prior.get("name") if isinstance(prior, Mapping) else prior
        if self.inclusion is not None and prior_name == "total_variation":
            lines.append(
                "Contrast of the inclusion: the prior (total variation) biases it towards the"
                " surroundings, so that the true contrast is often larger than shown and intervals"
                " within the inclusion are too narrow."
            )
        if run.recording is not None and run.noise.assumed(run.recording):
            lines.append(
                "The noise of the displacements is an assumption; if it is larger, fine detail of"
                " the map is noise and intervals are too narrow."
            )
        for name, estimate in run.result.nuisance.items():
            if not np.isfinite(estimate.deviation).any():
                lines.append(f"The uncertainty of the estimated {name} was not computed.")
            elif not estimate.is_informative:
                lines.append(f"The presses hardly determine the estimated {name}.")
        return lines

    @property
    def presses(self) -> Table | None:
        """Residuals of the presses; None without a recording."""
        if self.run.recording is None:
            return None
        rows = []
        for k in self.listed:
            press, fit = self.run.recording.presses[k], self.fits[k]
            size = _rms(press.displacement[press.data])
            force = f"{np.linalg.norm(press.total_force):.3g}"
            residual = (_number(1e3 * fit.rms_mm), _number(fit.rms_deviations, 2))
            rows.append([press_label(k + 1, press), force, _number(1e3 * size, 4), *residual])
        header = ["Press", "Force (N)", "Displacement, RMS (µm)", "Residual, RMS (µm)"]
        caption = "Residual of each press (SD: standard deviations)"
        if len(self.listed) < len(self.fits):
            caption = (
                f"Presses of the largest residuals, of {len(self.fits)} (SD: standard deviations)"
            )
        return Table(caption, [*header, "Residual (SD)"], rows)

    @property
    def drawn(self) -> list[int]:
        """Indices of the listed presses with observed displacements, which figures show."""
        recording = self.run.recording
        if recording is None:
            return []
        return [k for k in self.listed if recording.presses[k].data.any()]

    @property
    def listed(self) -> list[int]:
        """Indices of the presses that are shown: those of the largest residuals, of many."""
        if len(self.fits) <= _MAX_LISTED:
            return list(range(len(self.fits)))
        sizes = np.nan_to_num([fit.rms_deviations for fit in self.fits])
        return np.argsort(-sizes, kind="stable")[:_LISTED].tolist()

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


def _rms(values: Float[np.ndarray, "*n"]) -> float:
    """Root mean square of the values that are not NaN; NaN without any."""
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def _number(value: float, digits: int = 3) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


def _fit(run: Run) -> float:
    return math.sqrt(float(run.summary.get("chi2", math.nan)))


def press_label(number: int, press: Press) -> str:
    """Return the number and, if it differs, the name of a press."""
    name = one_line(press.name)
    return f"{number}" if name in ("", str(number)) else f"{number}: {name}"


def score_table(runs: Sequence[Run]) -> Table:
    """Return scores against the truth and cost, with the best values marked."""
    columns = {run.name: _scores(run, run.result.youngs) | _cost(run) for run in runs}
    shared = _distinct(runs, "reference") <= 1 and all(run.name != "reference" for run in runs)
    for run in runs:
        if run.recording is not None and run.recording.reference is not None:
            name = "reference" if shared else f"reference of {run.name}"
            columns[name] = _scores(run, run.recording.reference)
    titles = _SCORES | _COST
    names = [name for name in titles if any(name in column for column in columns.values())]
    rows = [[titles[name][0], *(_cell(c.get(name)) for c in columns.values())] for name in names]
    caption = "Scores against the truth" if set(names) & set(_SCORES) else "Fit and cost"
    best = {row: _best(titles[name][1], name, columns) for row, name in enumerate(names)}
    if _distinct(runs, "truth") > 1:
        caption, best = f"{caption}; the truths differ, so that no best is marked", {}
    return Table(caption, ["", *columns], rows, best)


def _scores(run: Run, youngs: Float[np.ndarray, " m"]) -> _Column:
    if run.recording is None or run.recording.truth is None:
        return {}
    return scores(run.recording.mesh, youngs, run.recording.truth)


def _distinct(runs: Sequence[Run], attribute: str) -> int:
    """Return the number of distinct maps of an attribute of the recordings."""
    recordings = [run.recording for run in runs if run.recording is not None]
    maps = [(recording.mesh, getattr(recording, attribute)) for recording in recordings]
    return len({(mesh.content_hash(), v.tobytes()) for mesh, v in maps if v is not None})


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


def history_table(run: Run) -> Table:
    """Return the iterations of a run."""
    rows = []
    for record in run.result.history:
        seconds, residual = record.get("seconds", math.nan), math.sqrt(record["chi2"])
        cells = (f"{seconds:.1f}", f"{record['misfit']:.4g}", f"{residual:.3g}")
        rows.append([f"{record['iteration']}", *cells])
    return Table(run.name, ["Iteration", "Time (s)", "Misfit (mm²)", "Residual (SD)"], rows)


def versions_table(runs: Sequence[Run]) -> Table:
    """Return the versions of the packages that computed the maps."""
    versions = {run.name: run.result.config.get("versions", {}) for run in runs}
    return _compare("Versions at the time of the inversion", versions)


def _compare(caption: str, columns: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return a table of several columns, each with values by name of the row."""
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    rows = [[name, *(str(c.get(name, "–")) for c in columns.values())] for name in names]
    return Table(caption, ["", *columns], rows)


def difference_table(runs: Sequence[Run]) -> Table:
    """Return the settings in which runs differ; without rows if all are the same."""
    settings = {run.name: dict(_flatten(_compared_settings(run))) for run in runs}
    table = _compare("Settings in which the runs differ", settings)
    return replace(table, rows=[row for row in table.rows if len(set(row[1:])) > 1])


def _compared_settings(run: Run) -> dict[str, Any]:
    config = dict(run.result.config)
    settings = dict(config.pop("settings", {}))
    settings.pop("optimizer", None)  # also under its own name
    others = {k: config[k] for k in ("start_mpa", "optimizer", "material") if k in config}
    return {"recording": {"file": run.summary.get("recording")}} | settings | others


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)


def _to_yaml(values: Any) -> str:
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
