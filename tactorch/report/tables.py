"""The report's tables: scores, presses, convergence, settings that differ, versions."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.metrics import scores
from tactorch.recording import Recording
from tactorch.report.belief import Judgement
from tactorch.report.html import table
from tactorch.report.runs import Run

# Title of each score, and which value is best: the least, the largest, or the nearest to 1.
_SCORES = {
    "rmse_mpa": ("Error of the modulus, RMS (MPa)", "least"),
    "pearson": ("Correlation", "largest"),
    "ssim": ("Structural similarity (SSIM)", "largest"),
    "psnr": ("Signal to error, PSNR (dB)", "largest"),
    "position_error_mm": ("Centre off by (mm)", "least"),
    "contrast_recovery": ("Contrast, of the true one", "one"),
    "dice": ("Overlap of the inclusions (Dice)", "largest"),
}
_COST = {
    "fit": ("Fit of the presses (standard deviations)", ""),
    "iterations": ("Iterations", ""),
    "seconds": ("Time (s)", "least"),
}
_Column = dict[str, float]


def score_table(runs: Sequence[Run]) -> str:
    """Return scores against the truth, what they cost, the best of each marked."""
    columns = {run.name: _scores(run, run.found.youngs) | _cost(run) for run in runs}
    same, one = _same_truth(runs), _one_reference(runs)
    for run in runs:
        recording = run.recording
        if recording is not None and recording.reference is not None:
            name = "reference" if one else f"reference of {run.name}"
            columns[name] = _scores(run, recording.reference)
    told = _SCORES | _COST
    names = [name for name in told if any(name in column for column in columns.values())]
    body = [[told[name][0], *(_number(c.get(name)) for c in columns.values())] for name in names]
    best = {row: _best(told[name][1], name, columns) for row, name in enumerate(names)}
    caption = "Scores against the truth" if set(names) & set(_SCORES) else "Fit and cost"
    if not same:
        best, caption = {}, f"{caption}; the truths differ, so that no best is marked"
    return table(["", *columns], body, caption=caption, best=best)


def _scores(run: Run, youngs: Float[np.ndarray, " m"]) -> _Column:
    if run.recording is None or run.recording.truth is None:
        return {}
    return scores(run.recording.mesh, youngs, run.recording.truth)


def _same_truth(runs: Sequence[Run]) -> bool:
    """Whether scores of the runs can be compared."""
    known = [run.recording for run in runs if run.recording is not None]
    told = {
        (one.mesh.content_hash(), one.truth.tobytes()) for one in known if one.truth is not None
    }
    return len(told) <= 1


def _one_reference(runs: Sequence[Run]) -> bool:
    """Whether the runs' references are one and the same, and no run is called like it."""
    known = [run.recording for run in runs if run.recording is not None]
    told = {
        (one.mesh.content_hash(), one.reference.tobytes())
        for one in known
        if one.reference is not None
    }
    return len(told) <= 1 and all(run.name != "reference" for run in runs)


def _cost(run: Run) -> _Column:
    cost = {"iterations": float(run.found.iterations), "seconds": float(run.found.seconds)}
    if run.found.history and "chi2" in run.found.history[-1]:
        cost["fit"] = math.sqrt(float(run.found.history[-1]["chi2"]))
    return cost


def _best(rule: str, name: str, columns: Mapping[str, _Column]) -> set[int]:
    """Which columns (from 1) have the best value; none where there is no choice."""
    values = np.array([column.get(name, math.nan) for column in columns.values()])
    known = np.isfinite(values)
    if not rule or known.sum() < 2:
        return set()
    off = {"least": values, "largest": -values, "one": np.abs(values - 1.0)}[rule]
    # As the table shows them: what reads the same is equally good.
    least = np.nanmin(off)
    return {int(k) + 1 for k in np.flatnonzero(off <= least + 1e-4 * max(abs(least), 1e-4))}


def _number(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.4g}"


def press_table(recording: Recording, judged: Judgement) -> str:
    """Return how well each press is foretold."""
    body = []
    for number, (press, fit) in enumerate(
        zip(recording.presses, judged.fits, strict=True), start=1
    ):
        name = f"{number}: {press.name}" if press.name not in ("", str(number)) else f"{number}"
        size = float(np.sqrt(np.nanmean(press.displacement[press.data] ** 2)))
        body.append(
            [
                name,
                f"{np.linalg.norm(press.total_force):.3g}",
                f"{1e3 * size:.4g}",
                f"{1e3 * fit.rms_mm:.3g}",
                f"{fit.rms_deviations:.2g}",
            ]
        )
    head = ["Press", "Force (N)", "Displacement, RMS (µm)", "Missed by, RMS (µm)", "in SD"]
    return table(head, body, caption="How well each press is foretold (SD: standard deviations)")


def history_table(run: Run) -> str:
    """Return the iterations."""
    body = [
        [
            f"{record['iteration']}",
            f"{record.get('seconds', math.nan):.1f}",
            f"{record['misfit']:.4g}",
            f"{math.sqrt(record['chi2']):.3g}",
        ]
        for record in run.found.history
    ]
    return table(["Iteration", "Time (s)", "Misfit (mm²)", "Fit (SD)"], body, caption=run.name)


def versions_table(runs: Sequence[Run]) -> str:
    """Return the versions that the maps were made with."""
    kept = {run.name: run.found.config.get("versions", {}) for run in runs}
    names = list(dict.fromkeys(name for found in kept.values() for name in found))
    body = [[name, *(str(found.get(name, "–")) for found in kept.values())] for name in names]
    return table(["", *kept], body, caption="Versions that the map was made with")


def difference_table(runs: Sequence[Run]) -> str:
    """Return the settings in which runs differ."""
    flat = {run.name: dict(_flat(_compared(run))) for run in runs}
    names = list(dict.fromkeys(name for found in flat.values() for name in found))
    body = [[name, *(found.get(name, "–") for found in flat.values())] for name in names]
    differing = [row for row in body if len(set(row[1:])) > 1]
    if not differing:
        return "<p>All settings are the same.</p>"
    return table(["", *flat], differing, caption="Settings in which the runs differ")


def _compared(run: Run) -> dict[str, Any]:
    config = dict(run.found.config)
    settings = dict(config.pop("settings", {}))
    settings.pop("optimizer", None)  # told under its own name
    config.pop("versions", None)
    return (
        {"recording": {"file": run.summary.get("recording")}}
        | settings
        | {name: config[name] for name in ("start_mpa", "optimizer", "material") if name in config}
    )


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)
