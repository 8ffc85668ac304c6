"""The ten models of Fig. 4 and 5: the paper's truncated Newton beside ours (Table I).

Both start from 0.2 MPa everywhere, one after the other in one process of one thread, with the
same exact presses on the same mesh. Each thing that the paper calls an iteration of TNC is a
solve of all presses here (`maxfun`); where it has not reached the paper's similarity after all of
them it may go on until it has had so many times (`tnc_patience`) as long as ours took to get there.
No mesh follows an inclusion. Ours are the default settings,
but that they are told how exact the data are; TNC believes its data wholly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import TNC, NoiseModel, NoPrior, Scaled, Settings
from tactorch.metrics import scores
from tactorch.recording import Recording
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import pressed, stored_mesh
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
_ENDLESS = 10**6


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One a model."""
    shared = {k: v for k, v in options.items() if k != "names"}
    return [
        Case("models", name, {"phantom": MODELS[name], "model": name, **shared})
        for name in options["names"]
    ]


def work(case: Case, scratch: Path) -> Outcome:
    """Press a model, and invert by both methods."""
    settings = case.settings
    recording = _recording(settings, scratch)
    warm_up(recording)
    default = Settings(model_error="none", noise=NoiseModel(relative=settings["noise_relative"]))
    ours = run_with_trace(recording, default, scratch / "ours")
    target = row("table1", settings["model"])["ssim_2500"]
    tnc = _truncated_newton(recording, settings, target, ours, scratch / "tnc")
    truth = recording.truth
    assert truth is not None
    return Outcome(
        {
            "elements": recording.mesh.n_tets,
            "presses": len(recording.presses),
            "ours": _figures(ours, target, recording, truth),
            "tnc": _figures(tnc, target, recording, truth),
        },
        {
            "points": recording.mesh.points,
            "tets": recording.mesh.tets,
            "truth": truth,
            "ours": ours.found.youngs,
            "tnc": tnc.found.youngs,
        },
    )


def _truncated_newton(
    recording: Recording, settings: Mapping[str, Any], target: float, ours: TracedRun, scratch: Path
) -> TracedRun:
    """The paper's method, for its number of solves; and on, until it has had time enough."""
    paper = Settings(
        optimizer=TNC(max_evaluations=settings["tnc_evaluations"]),
        parameterization=Scaled(),
        regularization=NoPrior(),
        model_error="none",
    )
    found = run_with_trace(recording, paper, scratch)
    there = ours.first_at(target)
    if there is None or found.first_at(target) is not None or not found.limited:
        return found
    enough = settings["tnc_patience"] * there.seconds
    if found.seconds >= enough:
        return found
    endless = replace(paper, optimizer=TNC(max_evaluations=_ENDLESS), max_seconds=enough)
    return run_with_trace(recording, endless, scratch)


def _recording(settings: Mapping[str, Any], scratch: Path) -> Recording:
    """The presses; a case that goes on takes those that it began with."""
    path = scratch / "recording.h5"
    if path.is_file():
        return Recording.load(path, check_units=False)
    recording = pressed(settings)
    recording.save(path)
    return recording


def _figures(
    run: TracedRun, target: float, recording: Recording, truth: np.ndarray
) -> dict[str, Any]:
    there = run.first_at(target)
    return {
        "seconds": run.seconds,
        "evaluations": run.way[-1].evaluations,
        "seconds_per_evaluation": run.seconds / max(run.way[-1].evaluations, 1),
        "stop_reason": run.found.stop_reason,
        "to_target": None if there is None else there.seconds,
        "evaluations_to_target": None if there is None else there.evaluations,
        "best_ssim": max(moment.ssim for moment in run.way),
        "after": {str(count): run.ssim_after(count) for count in COUNTS},
        "scores": scores(recording.mesh, run.found.youngs, truth),
    }


def table1(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Write Table I: the paper, its method here, and ours."""
    heads = ["s / iteration: paper", "s / iteration: TNC"]
    for count in COUNTS:
        heads += [f"SSIM at {count}: paper", f"SSIM at {count}: TNC"]
    heads += ["s to the paper's SSIM: TNC", "s to the paper's SSIM: ours", "ratio"]
    heads += ["SSIM at the end: ours", "s to the end: ours"]
    table = Table(
        ["model", "elements: paper", "elements: here", *heads],
        [None, None, None, 2, 3, *[4] * 6, 1, 2, 0, 4, 1],
    )
    for name, outcome in outcomes.items():
        table.add(*_row(name, outcome.figures))
    table.write_csv(out / "table1.csv")
    ratios = [r for r in (_ratio(o.figures)[0] for o in outcomes.values()) if r is not None]
    lines = [table.markdown(), ""]
    if ratios:
        lines.append(f"Least ratio: {min(ratios):.0f}.")
    bounds = [name for name, o in outcomes.items() if _ratio(o.figures)[1]]
    if bounds:
        lines.append(
            f"In {', '.join(bounds)} TNC did not reach the paper's SSIM in the time given;"
            " its whole time stands for it, and the ratio is a lower bound."
        )
    never = [name for name, o in outcomes.items() if o.figures["ours"]["to_target"] is None]
    if never:
        lines.append(f"In {', '.join(never)} our map never was as similar as the paper's.")
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
    """How many times sooner ours is there, and whether that is only a lower bound."""
    tnc, ours = figures["tnc"], figures["ours"]
    if ours["to_target"] is None:
        return None, False
    reached = tnc["to_target"]
    slower = tnc["seconds"] if reached is None else reached
    return slower / ours["to_target"], reached is None


def fig4(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 4: two materials; truth above, both methods below."""
    return _maps("fig4", [name for name in outcomes if name[0] == "4"], outcomes, out)


def fig5(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 5: heterogeneous objects."""
    return _maps("fig5", [name for name in outcomes if name[0] == "5"], outcomes, out)


def _maps(exhibit: str, names: Sequence[str], outcomes: Mapping[str, Outcome], out: Path) -> str:
    table = Table(["model", "method", *SCORES, "position error, mm"], [None, None, 4, 4, 2, 4, 2])
    rows: list[list[Panel]] = [[], [], []]
    truths = np.concatenate([outcomes[name].arrays["truth"] for name in names] or [np.ones(1)])
    limits = (float(truths.min()), float(truths.max()))
    for name in names:
        outcome = outcomes[name]
        mesh, arrays = stored_mesh(outcome.arrays), outcome.arrays
        for method in _METHODS:
            found = outcome.figures[method]["scores"]
            marks = [found[key] for key in SCORES.values()]
            table.add(
                name, "ours" if method == "ours" else "TNC", *marks, found["position_error_mm"]
            )
        rows[0].append(Panel(mesh, arrays["truth"], limits, title=f"({name[1]})"))
        for line, method in zip(rows[1:], _METHODS, strict=True):
            similar = outcome.figures[method]["scores"]["ssim"]
            line.append(Panel(mesh, arrays[method], limits, caption=f"SSIM {similar:.3f}"))
    table.write_csv(out / f"{exhibit}.csv")
    if names:
        plot_panels(rows, ["truth", "ours", "TNC"], out / f"{exhibit}.png")
    return f"{table.markdown()}\n\n![Truth, ours and TNC, middle slices]({exhibit}.png)"


EXHIBITS = {"table1": table1, "fig4": fig4, "fig5": fig5}
