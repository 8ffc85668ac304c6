"""Ten models of Fig. 4 and 5: the truncated Newton method of the paper and this package (Table I).

Both start from 0.2 MPa, one after the other in one process with one thread, with the same exact
presses on the same mesh. One iteration of TNC in the paper is one solve of all presses here
(`maxfun`). If TNC has not reached the similarity of the paper after all of them, it continues for
up to `tnc_patience` times the time that this package takes to reach it. No mesh follows an
inclusion. This package uses the default settings with the stated accuracy of the data; TNC assumes
exact data.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import TNC, NoiseModel, NoPrior, Scaled, Settings
from tactorch.metrics import scores
from tactorch.recording import Recording
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.objects import mesh_arrays, press_object, stored_mesh
from tactorch.reproduce.paper import row
from tactorch.reproduce.table import Table
from tactorch.reproduce.trace import TracedRun, run_with_trace, warm_up
from tactorch.viz.paper import Panel, plot_panels

MODELS = {
    "4a": "cube_two_tiers",
    "4b": "cube_torus",
    "4c": "cube_cone",
    "4d": "cube_soft_cone",
    "4e": "cylinder_hole_sphere",
    "4f": "hyperboloid_sphere",
    "4g": "hemisphere_spheres",
    "5a": "cube_gradient",
    "5b": "cube_layers",
    "5c": "hemisphere_random",
}
SCORES = {"s": "normalised_correlation", "SSIM": "ssim", "PSNR": "psnr", "RMSE": "rmse_mpa"}
COUNTS = (100, 500, 2500)
_METHODS = ("ours", "tnc")
_UNLIMITED = 10**6


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return one case per model."""
    shared = {k: v for k, v in options.items() if k != "names"}
    return [
        Case("models", name, {"phantom": MODELS[name], "model": name, **shared})
        for name in options["names"]
    ]


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Simulate presses on a model and invert them by both methods."""
    settings = case.settings
    recording = _recording(settings, scratch)
    warm_up(recording)
    default = Settings(model_error="none", noise=NoiseModel(relative=settings["noise_relative"]))
    ours = run_with_trace(recording, default, scratch / "ours")
    target = row("table1", settings["model"])["ssim_2500"]
    tnc = _truncated_newton(recording, settings, target, ours, scratch / "tnc")
    truth = recording.truth
    assert truth is not None
    return CaseResult(
        {
            "elements": recording.mesh.n_tets,
            "presses": len(recording.presses),
            "ours": _figures(ours, target, recording, truth),
            "tnc": _figures(tnc, target, recording, truth),
        },
        mesh_arrays(recording.mesh, truth=truth, ours=ours.result.youngs, tnc=tnc.result.youngs),
    )


def _truncated_newton(
    recording: Recording, settings: Mapping[str, Any], target: float, ours: TracedRun, scratch: Path
) -> TracedRun:
    """Run the method of the paper for its number of solves, and longer if it is slower."""
    paper = Settings(
        optimizer=TNC(max_evaluations=settings["tnc_evaluations"]),
        parameterization=Scaled(),
        regularization=NoPrior(),
        model_error="none",
    )
    run = run_with_trace(recording, paper, scratch)
    reached = ours.first_at(target)
    if reached is None or run.first_at(target) is not None or not run.limited:
        return run
    max_seconds = settings["tnc_patience"] * reached.seconds
    if run.seconds >= max_seconds:
        return run
    optimizer = TNC(max_evaluations=_UNLIMITED)
    continued = replace(paper, optimizer=optimizer, max_seconds=max_seconds)
    return run_with_trace(recording, continued, scratch)


def _recording(settings: Mapping[str, Any], scratch: Path) -> Recording:
    """Return the presses; a continued case uses the stored ones."""
    path = scratch / "recording.h5"
    if path.is_file():
        return Recording.load(path, check_units=False)
    recording = press_object(settings)
    recording.save(path)
    return recording


def _figures(
    run: TracedRun, target: float, recording: Recording, truth: np.ndarray
) -> dict[str, Any]:
    reached, last = run.first_at(target), run.trace[-1]
    return {
        "seconds": run.seconds,
        "evaluations": last.evaluations,
        "seconds_per_evaluation": run.seconds / max(last.evaluations, 1),
        "stop_reason": run.result.stop_reason,
        "to_target": None if reached is None else reached.seconds,
        "evaluations_to_target": None if reached is None else reached.evaluations,
        "best_ssim": max(point.ssim for point in run.trace),
        "after": {str(count): run.ssim_after(count) for count in COUNTS},
        "scores": scores(recording.mesh, run.result.youngs, truth),
    }


def table1(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Write Table I: the paper, its method here, and this package."""
    heads = ["s / iteration: paper", "s / iteration: TNC"]
    for count in COUNTS:
        heads += [f"SSIM at {count}: paper", f"SSIM at {count}: TNC"]
    heads += ["s to the paper's SSIM: TNC", "s to the paper's SSIM: ours", "ratio"]
    heads += ["SSIM at the end: ours", "s to the end: ours"]
    table = Table(
        ["model", "elements: paper", "elements: here", *heads],
        [None, None, None, 2, 3, *[4] * 6, 1, 2, 0, 4, 1],
    )
    for name, result in results.items():
        table.add(*_row(name, result.figures))
    table.write_csv(out / "table1.csv")
    ratios = [r for r in (_ratio(o.figures)[0] for o in results.values()) if r is not None]
    lines = [table.markdown(), ""]
    if ratios:
        lines.append(f"Smallest ratio: {min(ratios):.0f}.")
    bounds = [name for name, o in results.items() if _ratio(o.figures)[1]]
    if bounds:
        lines.append(
            f"In {', '.join(bounds)} TNC did not reach the SSIM of the paper within its time;"
            " its total time is used instead, so that the ratio is a lower bound."
        )
    never = [name for name, o in results.items() if o.figures["ours"]["to_target"] is None]
    if never:
        lines.append(f"In {', '.join(never)} this package did not reach the SSIM of the paper.")
    return "\n".join(lines)


def _row(name: str, figures: Mapping[str, Any]) -> list[Any]:
    paper, tnc, ours = row("table1", name), figures["tnc"], figures["ours"]
    cells: list[Any] = [name, paper["elements"], figures["elements"]]
    cells += [paper["seconds_per_iteration"], tnc["seconds_per_evaluation"]]
    for count in COUNTS:
        cells += [paper[f"ssim_{count}"], tnc["after"][str(count)]]
    reached = tnc["to_target"]
    cells += [reached if reached is not None else f"> {tnc['seconds']:.1f}", ours["to_target"]]
    ratio, bound = _ratio(figures)
    shown = None if ratio is None else f"{'> ' if bound else ''}{ratio:.0f}"
    return [*cells, shown, ours["scores"]["ssim"], ours["seconds"]]


def _ratio(figures: Mapping[str, Any]) -> tuple[float | None, bool]:
    """Return the ratio of the times to the target, and whether it is a lower bound."""
    tnc, ours = figures["tnc"], figures["ours"]
    if ours["to_target"] is None:
        return None, False
    reached = tnc["to_target"]
    slower = tnc["seconds"] if reached is None else reached
    return slower / ours["to_target"], reached is None


def fig4(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 4, objects of two materials: truth (top) and both methods."""
    return _maps("fig4", [name for name in results if name[0] == "4"], results, out)


def fig5(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 5: heterogeneous objects."""
    return _maps("fig5", [name for name in results if name[0] == "5"], results, out)


def _maps(exhibit: str, names: Sequence[str], results: Mapping[str, CaseResult], out: Path) -> str:
    table = Table(["model", "method", *SCORES, "position error, mm"], [None, None, 4, 4, 2, 4, 2])
    rows: list[list[Panel]] = [[], [], []]
    truths = np.concatenate([results[name].arrays["truth"] for name in names] or [np.ones(1)])
    limits = (float(truths.min()), float(truths.max()))
    for name in names:
        result = results[name]
        mesh, arrays = stored_mesh(result.arrays), result.arrays
        for method in _METHODS:
            scored = result.figures[method]["scores"]
            values = [scored[key] for key in SCORES.values()]
            table.add(
                name, "ours" if method == "ours" else "TNC", *values, scored["position_error_mm"]
            )
        rows[0].append(Panel(mesh, arrays["truth"], limits, title=f"({name[1]})"))
        for line, method in zip(rows[1:], _METHODS, strict=True):
            similarity = result.figures[method]["scores"]["ssim"]
            line.append(Panel(mesh, arrays[method], limits, caption=f"SSIM {similarity:.3f}"))
    table.write_csv(out / f"{exhibit}.csv")
    if names:
        plot_panels(rows, ["truth", "ours", "TNC"], out / f"{exhibit}.png")
    return f"{table.markdown()}\n\n![Truth, this package and TNC, middle slices]({exhibit}.png)"


EXHIBITS = {"table1": table1, "fig4": fig4, "fig5": fig5}
