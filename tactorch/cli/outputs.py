"""Results of a run: files, pictures, numbers and a summary."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.resume import CHECKPOINT
from tactorch.errors import FileError
from tactorch.files import write_file, write_json
from tactorch.findings import SHAPES, Finding, find_lump
from tactorch.findings.text import summarize_inclusion
from tactorch.inverse import NuisanceEstimate, Reconstruction
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion, scores
from tactorch.recording import Recording

History = Sequence[Mapping[str, Any]]

# Results in the folder of an inversion: its own, and those of other commands.
_RESULTS = (
    *("reconstruction.h5", "reconstruction.vtu", "slices.png", "convergence.png", "summary.json"),
    *(
        "summary.txt",
        CHECKPOINT,
        "finding.txt",
        "finding.json",
        SHAPES,
        "shapes.png",
        "report.html",
    ),
)


def score_table(
    recording: Recording, maps: Mapping[str, Float[np.ndarray, " m"]]
) -> tuple[dict[str, dict[str, float]], Table]:
    """Return the scores of maps, and of the reference of the recording, by map and as a table."""
    truth = recording.truth
    assert truth is not None
    compared = dict(maps)
    if recording.reference is not None:
        compared["reference"] = recording.reference
    values = {name: scores(recording.mesh, youngs, truth) for name, youngs in compared.items()}
    names = list(next(iter(values.values())))
    rows = [[name, *(f"{column[name]:.4g}" for column in values.values())] for name in names]
    return values, Table(["", *values], rows)


def remove_results(out: Path, resume: Path | None) -> None:
    """Remove the results of an earlier run: a killed run must not seem to have them."""
    for path in (out / name for name in _RESULTS):
        if resume is None or resume.resolve() != path.resolve():
            path.unlink(missing_ok=True)


def write_outputs(
    out: Path,
    recording: Recording,
    reconstruction: Reconstruction,
    *,
    source: str,
    others: Mapping[str, History] | None = None,
    plots: bool = True,
) -> None:
    """Write map, pictures and summary of an inversion; print the summary."""
    reconstruction.save(out / "reconstruction.h5")
    reconstruction.write_vtu(out / "reconstruction.vtu", recording.truth)
    log_text("", *write_summary(out, recording, reconstruction, source=source))
    if plots:
        for path in _draw(out, recording, reconstruction, others or {}):
            log.info("picture: %s", path)
    log.info("results: %s", out)


def write_summary(
    out: Path,
    recording: Recording,
    reconstruction: Reconstruction,
    *,
    source: str,
    finding: Finding | None = None,
) -> list[str | Table]:
    """Write summary.json and summary.txt, with the finding where there is one; return the text."""
    inclusion = None
    if not reconstruction.warnings:
        inclusion = find_lump(recording.mesh, reconstruction.youngs)
    summary = summarise(recording, reconstruction, inclusion, source)
    if finding is not None:
        summary["finding"] = finding.plain()
    write_json(out / "summary.json", summary)
    parts: list[str | Table] = [describe(recording, reconstruction, inclusion, summary)]
    if recording.truth is not None:
        parts += ["", score_table(recording, {"reconstruction": reconstruction.youngs})[1]]
    if finding is not None:
        parts += ["", "Finding:", finding.text()]
    texts = [part.text() if isinstance(part, Table) else part for part in parts]
    write_file(out / "summary.txt", "\n".join(texts) + "\n")
    return parts


def summarise(
    recording: Recording, reconstruction: Reconstruction, inclusion: Inclusion | None, source: str
) -> dict[str, Any]:
    """Return the numbers of a run, with scores where there is a truth.

    Args:
        recording: The presses.
        reconstruction: Result of their inversion.
        inclusion: Most conspicuous inclusion of the map; None if there is none, or if the map is
            not to be trusted.
        source: Path of the recording.
    """
    last, youngs = reconstruction.history[-1], reconstruction.youngs
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
        "youngs_median_mpa": float(np.median(youngs)),
        "volume_at_bounds": reconstruction.volume_at_bounds,
        "warnings": reconstruction.warnings,
        "inclusion": None if inclusion is None else inclusion.plain(),
        "regions": region_moduli(recording.mesh, youngs),
        "nuisance": {name: found.plain() for name, found in reconstruction.nuisance.items()},
    }
    if recording.truth is not None:
        values, _ = score_table(recording, {"reconstruction": youngs})
        summary |= values.pop("reconstruction") | values
    return summary | {"config": reconstruction.config}


def describe(
    recording: Recording,
    reconstruction: Reconstruction,
    inclusion: Inclusion | None,
    summary: Mapping[str, Any],
) -> str:
    """Return a summary of the map in words; see `summarise`."""
    lines = [
        f"{summary['optimizer']}: {summary['iterations']} iterations in "
        f"{summary['seconds']:.1f} s; stopped because: {summary['stop_reason']}.",
        f"The data are fitted to {math.sqrt(summary['chi2']):.2g} standard deviations"
        + (f" (misfit {summary['misfit']:.3g} mm2)." if summary["misfit"] else "."),
        *_describe_map(reconstruction, inclusion),
        *_describe_regions(summary["regions"]),
        *(_describe_estimate(name, value) for name, value in reconstruction.nuisance.items()),
        *(f"DO NOT TRUST THIS MAP: {warning}" for warning in reconstruction.warnings),
    ]
    if recording.truth is not None and inclusion is not None:
        true = find_lump(recording.mesh, recording.truth)
        if true is not None:
            median = float(np.median(recording.truth))
            lines.append("In truth: " + summarize_inclusion(true, median))
    return "\n".join(lines)


def _describe_map(reconstruction: Reconstruction, inclusion: Inclusion | None) -> list[str]:
    """Return the inclusion of the map as a sentence; none of a map that is not to be trusted."""
    if reconstruction.warnings:
        return []
    median = float(np.median(reconstruction.youngs))
    return ["In the map: " + summarize_inclusion(inclusion, median)]


def region_moduli(mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> dict[str, dict[str, float]]:
    """Return the median and the deciles of the moduli of each region, by volume, MPa."""
    if mesh.regions is None:
        return {}
    moduli = {}
    for number in np.unique(mesh.regions):
        mine = mesh.regions == number
        order = np.argsort(youngs[mine])
        below = np.cumsum(mesh.volumes[mine][order])
        places = np.searchsorted(below, np.array([0.1, 0.5, 0.9]) * below[-1])
        low, median, high = youngs[mine][order][places].tolist()
        moduli[str(number)] = {"p10_mpa": low, "median_mpa": median, "p90_mpa": high}
    return moduli


def _describe_regions(regions: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return the moduli of each region as text; none of a mesh without regions."""
    return [
        f"Region {number}: median {values['median_mpa']:.3g} MPa, {values['p10_mpa']:.3g} to "
        f"{values['p90_mpa']:.3g} MPa in the middle 80 % of its volume."
        for number, values in regions.items()
    ]


def _describe_estimate(name: str, estimate: NuisanceEstimate) -> str:
    if not np.isfinite(estimate.deviation).any():
        values = ", ".join(f"{value:.4g}" for value in estimate.value)
        return f"Estimated with the map: {name} {values} (uncertainty not computed)."
    pairs = zip(estimate.value, estimate.deviation, strict=True)
    values = ", ".join(f"{value:.4g} +- {deviation:.2g}" for value, deviation in pairs)
    note = "" if estimate.is_informative else " (hardly determined by the data)"
    return f"Estimated with the map: {name} {values}{note}."


def read_histories(runs: Sequence[Path], own_name: str) -> dict[str, History]:
    """Return the convergence of other runs by distinct names."""
    histories: dict[str, History] = {}
    for run in runs:
        try:
            result = Reconstruction.load(run / "reconstruction.h5" if run.is_dir() else run)
        except FileError as error:
            raise FileError(f"compare: {error}") from error
        name = str(result.config.get("optimizer", {}).get("name", run.name))
        free = (n for n in (name, run.name, str(run)) if n not in {own_name, *histories})
        label = next(free, None)
        if label is None:
            raise FileError(f"compare: '{run}' is named twice; give each run once.")
        histories[label] = result.history
    return histories


def _draw(
    out: Path, recording: Recording, reconstruction: Reconstruction, others: Mapping[str, History]
) -> list[Path]:
    """Draw slices of the map and the convergence."""
    from tactorch.viz import convergence_figure, save_figure, slice_figure
    from tactorch.viz.contact import total_forces

    histories = {reconstruction.config["optimizer"]["name"]: reconstruction.history, **others}
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
