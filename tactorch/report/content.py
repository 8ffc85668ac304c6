"""Content of the page about each run: figures, finding, limitations and tables."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import yaml
from jaxtyping import Bool, Float

from tactorch.config.values import leaves
from tactorch.inverse import Lump, Reconstruction
from tactorch.inverse.result.text import (
    Fact,
    describe_alternatives,
    describe_lump,
    describe_steps,
    format_modulus,
    headline,
    lead,
    lump_facts,
)
from tactorch.metrics import scores
from tactorch.recording import Press
from tactorch.report.runs import Run
from tactorch.text import one_line

_MAX_FACTOR = 2.0  # an interval of a larger factor is reported as a limitation
_MIN_VOLUME = 0.02  # fraction of the volume from which it is reported
_MAX_LISTED, _LISTED = 100, 20  # presses up to which all are shown, and the number of those of more
_MAX_FIT = 1.5  # standard deviations; a larger residual is reported
_IN_SD, _UNKNOWN = "Residual (SD)", "–"
_BIASED = "total_variation"  # prior that shrinks contrasts
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

    low: Float[np.ndarray, " m"]  # ends of the 90 % interval, MPa
    high: Float[np.ndarray, " m"]
    # 1 if the data determine the modulus, 0 if the prior does; None for inclusions.
    resolution: Float[np.ndarray, " m"] | None = None
    credibility: Float[np.ndarray, " m"] | None = None  # L of eq. (15) of the paper, mm/MPa
    # Whether a bound of the moduli truncates the interval; None if none does.
    at_bound: Bool[np.ndarray, " m"] | None = None
    kind: str = ""  # class of the posterior of an element map

    @property
    def relative_half_width(self) -> Float[np.ndarray, " m"]:
        """Relative half width of the interval (m,): 0.3 is a factor of 1.3; NaN at a bound."""
        width = np.sqrt(self.high / self.low) - 1.0
        return width if self.at_bound is None else np.where(self.at_bound, np.nan, width)


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
    """One run: its result, uncertainty and residuals, and texts about them."""

    run: Run
    uncertainty: UncertaintySummary | None = None
    fits: Sequence[PressFit] = ()
    missing: str = ""  # reason why something is missing

    @property
    def result(self) -> Reconstruction:
        """The result, in the description that is shown."""
        return self.run.result

    @property
    def lump(self) -> Lump | None:
        """Most probable or conspicuous lump."""
        return next(iter(self.result.lumps), None)

    @property
    def headline(self) -> str:
        """The finding in one line."""
        return headline(self.result)

    @property
    def description(self) -> str:
        """The finding in one or two sentences."""
        return lead(self.result)

    @property
    def others(self) -> list[str]:
        """Sentences on all lumps but the first, steps beside a lump, and alternatives."""
        lumps = self.result.lumps
        steps = describe_steps(self.result) if lumps else []
        alternatives = [] if self.result.reasons else describe_alternatives(self.result)
        return [*map(describe_lump, lumps[1:]), *steps, *alternatives]

    @property
    def facts(self) -> list[Fact]:
        """Location, size, modulus, probability, description and fit."""
        facts = [Fact("Young's modulus", format_modulus(self.result.background_mpa), "background")]
        if self.lump is not None:
            facts = lump_facts(self.lump)
        note = "RMS residual over the noise; well above 1 the presses are not explained"
        return [*facts, Fact("Fit", f"{math.sqrt(self.result.chi2):.2g} SD", note), self._described]

    @property
    def _described(self) -> Fact:
        """The description that is shown, and how the other one fits."""
        result, note = self.result, "one modulus per element"
        if result.shapes is not None:
            count = len(result.shapes.inclusions)
            note = f"{count} inclusion{'s' * (count != 1)} in a background"
        if result.other is not None:
            residual = f"{math.sqrt(result.other.chi2):.2g} SD"
            note += f"; computed too: {result.other.name}, which fits the presses to {residual}"
        return Fact("Description", result.name, note)

    @property
    def omitted(self) -> str:
        """What the report omits and why, or empty."""
        known = self.uncertainty
        if self.run.recording is None:
            parts = "truth, contact, presses and credibility, because the recording is missing"
        elif known is None:
            parts = "credibility and uncertainty"
        elif known.credibility is None:
            parts = "credibility"
        else:
            return ""
        reason = self.missing.rstrip(".")
        return f"Omitted: {parts} ({reason})."

    @property
    def limitations(self) -> list[str]:
        """Warnings and further limitations of the result and of the recording."""
        run, uncertainty, lines = self.run, self.uncertainty, list(self.result.warnings)
        fit = math.sqrt(self.result.chi2)
        if fit > _MAX_FIT:
            lines.append(
                f"The presses are not explained: the residual is {fit:.2g} standard deviations."
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
        if self.lump is not None and self.result.shapes is None and _prior(run) == _BIASED:
            lines.append(
                "Contrast of the lump: the prior of the element map (total variation) biases it"
                " towards the surroundings, so that the true contrast is often larger than shown"
                " and intervals within the lump are too narrow."
            )
        if run.recording is not None and run.noise.assumed(run.recording):
            lines.append(
                "The noise of the displacements is an assumption; if it is larger, details are"
                " noise and intervals are too narrow."
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
        header = ["Press", "Force (N)", "Displacement, RMS (µm)", "Residual, RMS (µm)", _IN_SD]
        # A palpation has no displacements.
        known = [k for k in range(len(header)) if any(row[k] != _UNKNOWN for row in rows)]
        rows = [[row[k] for k in known] for row in rows]
        caption = "Residual of each press"
        if len(self.listed) < len(self.fits):
            caption = f"Presses of the largest residuals, of {len(self.fits)}"
        caption += " (SD: standard deviations)"
        return Table(caption, [header[k] for k in known], rows)

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


def _number(value: float | None, digits: int = 3) -> str:
    return _UNKNOWN if value is None or math.isnan(value) else f"{value:.{digits}g}"


def _prior(run: Run) -> Any:
    prior = run.result.config.get("settings", {}).get("regularization", "")
    return prior.get("name") if isinstance(prior, Mapping) else prior


def press_label(number: int, press: Press) -> str:
    """Return the number and, if it differs, the name of a press."""
    name = one_line(press.name)
    return f"{number}" if name in ("", str(number)) else f"{number}: {name}"


def score_table(runs: Sequence[Run]) -> Table:
    """Return scores against the truth and cost, with the best values marked."""
    columns = {}
    for run in runs:
        columns[run.name] = _scores(run, run.result.youngs) | _cost(run)
        if run.result.other is not None:
            columns[f"{run.name}, {run.result.other.name}"] = _scores(run, run.result.other.youngs)
    shared = _distinct(runs, "reference") <= 1 and all(run.name != "reference" for run in runs)
    for run in runs:
        if run.recording is not None and run.recording.reference is not None:
            name = "reference" if shared else f"reference of {run.name}"
            columns[name] = _scores(run, run.recording.reference)
    titles = _SCORES | _COST
    names = [name for name in titles if any(name in column for column in columns.values())]
    rows = [
        [titles[name][0], *(_number(c.get(name), 4) for c in columns.values())] for name in names
    ]
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


def history_table(run: Run) -> Table:
    """Return the iterations of an element map, or the models that a search accepted."""
    rows = []
    for record in run.result.history:
        residual = f"{math.sqrt(record['chi2']):.3g}"
        if run.result.shapes is None:
            seconds = record.get("seconds", math.nan)
            cells = [f"{seconds:.1f}", f"{record['misfit']:.4g}", residual]
        else:
            cells = [record["model"], residual, f"{record['log_evidence']:.4g}"]
        rows.append([f"{record['iteration']}", *cells])
    header = ["Iteration", "Time (s)", "Misfit (mm²)", "Residual (SD)"]
    if run.result.shapes is not None:
        header = ["Number", "Model", "Residual (SD)", "Log-evidence"]
    return Table(run.name, header, rows)


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
    settings = {run.name: dict(leaves(_compared_settings(run))) for run in runs}
    table = _compare("Settings in which the runs differ", settings)
    return replace(table, rows=[row for row in table.rows if len(set(row[1:])) > 1])


def _compared_settings(run: Run) -> dict[str, Any]:
    config = dict(run.result.config)
    settings = dict(config.pop("settings", {}))
    settings.pop("optimizer", None)  # also under its own name
    others = {k: config[k] for k in ("start_mpa", "optimizer", "material") if k in config}
    return {"recording": {"file": run.summary.get("recording")}} | settings | others


def _to_yaml(values: Any) -> str:
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
