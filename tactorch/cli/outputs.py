"""Results of a run: files, pictures, numbers and a summary."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.cli.logs import log_text
from tactorch.cli.settings import log
from tactorch.cli.tables import Table
from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.findings import find_lump
from tactorch.findings.text import summarize_inclusion
from tactorch.inverse import NuisanceEstimate, Reconstruction
from tactorch.metrics import Inclusion, scores
from tactorch.recording import Recording

History = Sequence[Mapping[str, Any]]

# Results of an inversion, in its folder.
RESULTS = (
    "reconstruction.h5",
    "reconstruction.vtu",
    "slices.png",
    "convergence.png",
    "summary.json",
    "summary.txt",
)
# Results that other commands add.
DERIVED_RESULTS = ("finding.txt", "finding.json", "report.html")


# Largest share of the volume at the bounds of a map that can be trusted.
_MAX_AT_BOUNDS = 0.2


@dataclass(frozen=True)
class ScoreTable:
    """Scores of several maps: values by map and metric, and the same as a table."""

    values: dict[str, dict[str, float]]
    table: Table


def score_table(recording: Recording, maps: Mapping[str, Float[np.ndarray, " m"]]) -> ScoreTable:
    """Score maps, and the reference that the recording carries, against its truth."""
    truth = recording.truth
    assert truth is not None
    shown = dict(maps)
    if recording.reference is not None:
        shown["reference"] = recording.reference
    values = {name: scores(recording.mesh, youngs, truth) for name, youngs in shown.items()}
    names = list(next(iter(values.values())))
    rows = [[name, *(f"{column[name]:.4g}" for column in values.values())] for name in names]
    return ScoreTable(values, Table(["", *values], rows))


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write strict JSON, NaN as null, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(_strict(values), indent=2, allow_nan=False) + "\n")


def _strict(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_outputs(
    out: Path,
    recording: Recording,
    reconstruction: Reconstruction,
    *,
    source: str,
    others: Mapping[str, History] | None = None,
    plots: bool = True,
) -> dict[str, Any]:
    """Write map, pictures, summary and text; print the text; returns the summary."""
    reconstruction.save(out / "reconstruction.h5")
    reconstruction.write_vtu(out / "reconstruction.vtu", recording.truth)
    inclusion = find_lump(recording.mesh, reconstruction.youngs)
    summary = summarise(recording, reconstruction, inclusion, source)
    write_json(out / "summary.json", summary)
    maps = {"reconstruction": reconstruction.youngs}
    tables = [] if recording.truth is None else [score_table(recording, maps).table]
    text = describe(recording, reconstruction, inclusion, summary, tables)
    with atomic_path(out / "summary.txt") as temporary:
        temporary.write_text(text + "\n")
    log_text(f"\n{text}", *tables)
    if plots:
        for path in draw(out, recording, reconstruction, others or {}):
            log.info("picture: %s", path)
    log.info("results: %s", out)
    return summary


def summarise(
    recording: Recording, reconstruction: Reconstruction, inclusion: Inclusion | None, source: str
) -> dict[str, Any]:
    """Return the numbers of a run, with scores where there is a truth."""
    last = reconstruction.history[-1]
    summary: dict[str, Any] = {
        "recording": source,
        "optimizer": reconstruction.config["optimizer"]["name"],
        "seconds": reconstruction.seconds,
        "iterations": reconstruction.iterations,
        "evaluations": last["evaluations"],
        "stop_reason": reconstruction.stop_reason,
        "misfit": reconstruction.misfit_mm2,
        "chi2": last["chi2"],
        "elements": recording.mesh.n_tets,
        "presses": len(recording.presses),
        "youngs_median_mpa": float(np.median(reconstruction.youngs)),
        "volume_at_bounds": _at_bounds(recording, reconstruction),
        "inclusion": None if inclusion is None else inclusion.plain(),
        "nuisance": {name: found.plain() for name, found in reconstruction.nuisance.items()},
    }
    if recording.truth is not None:
        summary |= scores(recording.mesh, reconstruction.youngs, recording.truth)
        if recording.reference is not None:
            found = scores(recording.mesh, recording.reference, recording.truth)
            summary["reference"] = found
    return summary | {"config": reconstruction.config}


def _at_bounds(recording: Recording, found: Reconstruction) -> float:
    """Share of the volume within 1 % of the least or the largest modulus allowed."""
    bounds = found.config["settings"]["bounds"]
    there = (found.youngs < 1.01 * bounds["lower"]) | (found.youngs > 0.99 * bounds["upper"])
    volumes = recording.mesh.volumes
    return float(volumes[there].sum() / volumes.sum())


def describe(
    recording: Recording,
    reconstruction: Reconstruction,
    inclusion: Inclusion | None,
    summary: Mapping[str, Any],
    tables: Sequence[Table] = (),
) -> str:
    """Return a summary of the map in words, followed by tables."""
    lines = [
        f"{summary['optimizer']}: {summary['iterations']} iterations in "
        f"{summary['seconds']:.1f} s; stopped because: {summary['stop_reason']}.",
        f"Displacements are fitted to {math.sqrt(summary['chi2']):.2g} standard deviations "
        f"(misfit {summary['misfit']:.3g} mm2).",
        summarize_inclusion(inclusion, summary["youngs_median_mpa"]),
        *(_estimate(name, found) for name, found in reconstruction.nuisance.items()),
    ]
    if summary["volume_at_bounds"] > _MAX_AT_BOUNDS:
        lines.append(
            f"DO NOT TRUST THIS MAP: {summary['volume_at_bounds']:.0%} of it is at a bound of"
            " Young's modulus. If the bounds are right, presses or model are off by more than the"
            " noise that is stated: give noise.mm larger, or estimate what is wrong (nuisance)."
        )
    if recording.truth is not None:
        true = find_lump(recording.mesh, recording.truth)
        if true is not None and inclusion is not None:
            median = float(np.median(recording.truth))
            lines.append("In truth: " + summarize_inclusion(true, median))
    return "\n".join((*lines, *(f"\n{table.text()}" for table in tables)))


def _estimate(name: str, found: NuisanceEstimate) -> str:
    pairs = zip(found.value, found.deviation, strict=True)
    if not np.isfinite(found.deviation).any():
        values = ", ".join(f"{value:.4g}" for value in found.value)
        return f"Estimated with the map: {name} {values} (uncertainty not computed)."
    values = ", ".join(f"{value:.4g} +- {deviation:.2g}" for value, deviation in pairs)
    note = "" if found.is_informative else " (hardly determined by the data)"
    return f"Estimated with the map: {name} {values}{note}."


def read_histories(runs: Sequence[Path], own_name: str) -> dict[str, History]:
    """Return the convergence of other runs by distinct names.

    Raises:
        FileError: one is no run, or is named twice.
    """
    histories: dict[str, History] = {}
    for run in runs:
        try:
            found = Reconstruction.load(run / "reconstruction.h5" if run.is_dir() else run)
        except FileError as error:
            raise FileError(f"compare: {error}") from error
        histories[_label(found, run, {own_name, *histories})] = found.history
    return histories


def draw(
    out: Path,
    recording: Recording,
    reconstruction: Reconstruction,
    others: Mapping[str, History],
) -> list[Path]:
    """Draw slices of the map and the convergence."""
    from tactorch.viz import convergence_figure, save_figure, slice_figure
    from tactorch.viz.contact import total_forces

    name = reconstruction.config["optimizer"]["name"]
    histories = {name: reconstruction.history, **others}
    slices = slice_figure(
        recording.mesh,
        reconstruction.youngs,
        truth=recording.truth,
        pressed=total_forces(recording.presses),
        title="Young's modulus, reconstructed",
    )
    return [
        save_figure(slices, out / "slices.png"),
        save_figure(convergence_figure(histories), out / "convergence.png"),
    ]


def _label(found: Reconstruction, path: Path, taken: Collection[str]) -> str:
    name = str(found.config.get("optimizer", {}).get("name", path.name))
    for label in (name, path.name, str(path)):
        if label not in taken:
            return label
    raise FileError(f"compare: '{path}' is named twice; give each run once.")
