"""Results of a run: files, pictures, numbers and a summary, all of one result."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.resume import CHECKPOINT
from tactorch.errors import UNCOMPUTABLE, FileError
from tactorch.files import write_file, write_json
from tactorch.inverse import (
    NuisanceEstimate,
    Reconstruction,
    Settings,
    compute_posterior,
    find_lump,
)
from tactorch.inverse.data.plain import to_plain
from tactorch.inverse.result.text import describe
from tactorch.mesh import TetMesh
from tactorch.metrics import scores
from tactorch.recording import Recording

History = Sequence[Mapping[str, Any]]

# Files that other commands make of the results.
_DERIVED = ("scores.json", "report.html")
# Results in the folder of an inversion: its own, those of other commands and of earlier versions.
_RESULTS = (
    "reconstruction.h5", "reconstruction.vtu", "slices.png", "convergence.png", "summary.json",
    "summary.txt", CHECKPOINT, "finding.txt", "finding.json", "shapes.json", "shapes.png",
    *_DERIVED,
)  # fmt: skip


def score_table(
    recording: Recording, result: Reconstruction
) -> tuple[dict[str, dict[str, float]], Table]:
    """Return the scores of each element's modulus, by name and as a table.

    They are of the result, of its other description and of the reference of the recording.
    """
    truth = recording.truth
    assert truth is not None
    maps = {"reconstruction": result.youngs}
    if result.other is not None:
        maps[result.other.name] = result.other.youngs
    if recording.reference is not None:
        maps["reference"] = recording.reference
    values = {name: scores(recording.mesh, youngs, truth) for name, youngs in maps.items()}
    names = list(next(iter(values.values())))
    rows = [[name, *(f"{column[name]:.4g}" for column in values.values())] for name in names]
    return values, Table(["", *values], rows)


def remove_results(out: Path, resume: Path | None) -> None:
    """Remove the results of an earlier run: a killed run must not seem to have them."""
    for path in (out / name for name in _RESULTS):
        if resume is None or resume.resolve() != path.resolve():
            path.unlink(missing_ok=True)


def remove_derived(run: Path) -> None:
    """Remove what other commands made of results that change: they would contradict them."""
    for path in (run / name for name in _DERIVED):
        if path.is_file():
            log.info("%s, of the earlier result, is removed.", path)
            path.unlink()


def with_uncertainty(
    result: Reconstruction, recording: Recording, settings: Settings
) -> Reconstruction:
    """Return a result whose lumps have intervals; those of inclusions have them already."""
    if result.shapes is not None or not result.lumps:
        return result
    log.info("Solving the presses again for the uncertainty of the element map ...")
    try:
        return result.with_posterior(recording, compute_posterior(recording, result, settings))
    except UNCOMPUTABLE as error:
        reason = str(error).rstrip(".") or "not enough memory"
        return result.with_warning(f"The intervals cannot be computed ({reason}).")


def write_outputs(
    out: Path,
    recording: Recording,
    result: Reconstruction,
    *,
    source: str,
    others: Mapping[str, History] | None = None,
    plots: bool = True,
) -> None:
    """Write files, pictures and summary of a result; print the summary."""
    result.save(out / "reconstruction.h5")
    result.write_vtu(out / "reconstruction.vtu", recording.truth)
    summary, parts = summarise(recording, result, source), describe_run(recording, result)
    write_json(out / "summary.json", summary)
    write_json(out / "finding.json", summary["finding"])
    texts = [part.text() if isinstance(part, Table) else part for part in parts]
    write_file(out / "summary.txt", "\n".join(texts) + "\n")
    write_file(out / "finding.txt", f"{describe(result)}\n")
    log_text("", *parts)
    if plots:
        for path in _draw(out, recording, result, others or {}):
            log.info("picture: %s", path)
    log.info("results: %s", out)


def summarise(recording: Recording, result: Reconstruction, source: str) -> dict[str, Any]:
    """Return the numbers of a run, with scores where there is a truth."""
    summary: dict[str, Any] = {
        "recording": source,
        "description": result.name,
        "optimizer": result.config["optimizer"]["name"],
        "seconds": result.seconds,
        "iterations": result.iterations,
        "stop_reason": result.stop_reason,
        "misfit": result.misfit_mm2,
        "chi2": result.chi2,
        "elements": recording.mesh.n_tets,
        "presses": len(recording.presses),
        "finding": result.plain(),
        "regions": region_moduli(recording.mesh, result.youngs),
        "nuisance": to_plain(result.nuisance),
    }
    if result.shapes is None:
        summary["evaluations"] = result.history[-1]["evaluations"]
        summary["volume_at_bounds"] = result.volume_at_bounds
    if recording.truth is not None:
        values, _ = score_table(recording, result)
        summary |= values.pop("reconstruction") | values
    return summary | {"config": result.config}


def describe_run(recording: Recording, result: Reconstruction) -> list[str | Table]:
    """Return a summary of a result in words, with its scores where there is a truth."""
    steps = "iterations" if result.shapes is None else "models"
    misfit = f" (misfit {result.misfit_mm2:.3g} mm2)" if result.misfit_mm2 > 0 else ""
    parts: list[str | Table] = [
        describe(result),
        "",
        f"Description: {result.name}, {result.iterations} {steps} in {result.seconds:.1f} s; "
        f"stopped because: {result.stop_reason}.",
        f"The RMS residual is {np.sqrt(result.chi2):.2f} times the noise{misfit}.",
        *_describe_regions(recording.mesh, result.youngs),
        *(_describe_estimate(name, value) for name, value in result.nuisance.items()),
    ]
    if result.other is not None:
        parts.append(
            f"The presses were described by {result.other.name} too, with an RMS residual of "
            f"{np.sqrt(result.other.chi2):.2f} times the noise."
        )
    if recording.truth is not None:
        parts += ["", *_describe_truth(recording), score_table(recording, result)[1]]
    return parts


def _describe_truth(recording: Recording) -> list[str]:
    """Return the simulated inclusions, or the most conspicuous one of the truth by element."""
    assert recording.truth is not None
    phantom = recording.provenance.get("phantom", {})
    if inclusions := phantom.get("inclusions"):
        parts = [_describe_inclusion(dict(inclusion)) for inclusion in inclusions]
        around = phantom.get("youngs_mpa")
        if isinstance(around, float):
            parts.append(f"background {around} MPa")
        return [f"Simulated: {'; '.join(parts)}."]
    true = find_lump(recording.mesh, recording.truth)
    if true is None:
        return []
    center = ", ".join(f"{x:.2f}" for x in true.center_mm)
    return [
        f"In truth, averaged over the elements: a {true.side} inclusion at ({center}) mm, radius "
        f"{true.equivalent_radius_mm:.2f} mm, {true.mean_mpa:.3g} in {true.background_mpa:.3g} MPa."
    ]


def _describe_inclusion(values: dict[str, Any]) -> str:
    shape, youngs = values.pop("shape", "inclusion"), values.pop("youngs_mpa", "?")
    parts = [f"{name} {value}" for name, value in values.items() if isinstance(value, list | float)]
    return ", ".join([f"{shape} of {youngs} MPa", *parts])


def region_moduli(mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> dict[str, dict[str, float]]:
    """Return the median and the deciles of the moduli of each region, by volume, MPa."""
    if mesh.regions is None:
        return {}
    moduli = {}
    for number in np.unique(mesh.regions):
        mine = mesh.regions == number
        low, median, high = np.quantile(
            youngs[mine], (0.1, 0.5, 0.9), method="inverted_cdf", weights=mesh.volumes[mine]
        ).tolist()
        moduli[str(number)] = {"p10_mpa": low, "median_mpa": median, "p90_mpa": high}
    return moduli


def _describe_regions(mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> list[str]:
    """Return the moduli of each region as text; none of a mesh without regions."""
    return [
        f"Region {number}: median {values['median_mpa']:.3g} MPa, {values['p10_mpa']:.3g} to "
        f"{values['p90_mpa']:.3g} MPa in the middle 80 % of its volume."
        for number, values in region_moduli(mesh, youngs).items()
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
    """Return the convergence of the element maps of other runs by distinct names."""
    histories: dict[str, History] = {}
    for run in runs:
        try:
            result = Reconstruction.load(run / "reconstruction.h5" if run.is_dir() else run)
        except FileError as error:
            raise FileError(f"compare: {error}") from error
        if (elements := result.element_map) is None:
            raise FileError(f"compare: '{run}' has no element map; invert it with method=map.")
        name = str(result.config.get("optimizer", {}).get("name", run.name))
        free = (n for n in (name, run.name, str(run)) if n not in {own_name, *histories})
        label = next(free, None)
        if label is None:
            raise FileError(f"compare: '{run}' is named twice; give each run once.")
        histories[label] = elements.history
    return histories


def _draw(
    out: Path, recording: Recording, result: Reconstruction, others: Mapping[str, History]
) -> list[Path]:
    """Draw slices of the result, and the convergence of an element map."""
    from tactorch.viz import convergence_figure, reconstruction_figure, save_figure
    from tactorch.viz.contact import total_forces

    pressed = total_forces(recording.presses)
    slices = reconstruction_figure(result, truth=recording.truth, pressed=pressed)
    paths = [save_figure(slices, out / "slices.png")]
    if (elements := result.element_map) is not None:
        histories = {result.config["optimizer"]["name"]: elements.history, **others}
        paths.append(save_figure(convergence_figure(histories), out / "convergence.png"))
    return paths
