"""Ten models of Fig. 4 and 5: the truncated Newton method of the paper and this package (Table I).

Both start from 0.2 MPa, one after the other in one process with one thread, with the same exact
presses on the same mesh. One iteration of TNC in the paper is one solve of all presses here
(`maxfun`). If TNC has not reached the similarity of the paper after all of them, it continues for
up to `tnc_patience` times the time that this package takes to reach it. No mesh follows an
inclusion. This package uses the default settings with the stated accuracy of the data; TNC assumes
exact data.
"""

import json
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tactorch.files import write_file
from tactorch.inverse import (
    TNC,
    InverseProblem,
    NoiseModel,
    NoPrior,
    Reconstruction,
    Scaled,
    Settings,
    StopReason,
    invert_map,
)
from tactorch.metrics import scores, ssim
from tactorch.recording import Recording
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.paper import START_MPA, press_object, row
from tactorch.viz.paper import Panel, panels_figure

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
_SCORES = ("normalised_correlation", "ssim", "psnr", "rmse_mpa", "position_error_mm")
COUNTS = (100, 500, 2500)
_UNLIMITED = 10**6
_MIN_EVALUATIONS = 0.98  # fraction of a number of evaluations that counts as reached


class TracePoint(NamedTuple):
    """State of an inversion after an iteration, and the time of scoring up to it, s.

    Evaluations are solves of all presses, called iterations of TNC in the paper. The other time is
    that since the start without scoring; the similarity is that to the truth.
    """

    evaluations: int
    seconds: float
    ssim: float
    scoring: float = 0.0


@dataclass(frozen=True, eq=False)
class TracedRun:
    """Result of an inversion with the states of all its iterations."""

    result: Reconstruction
    trace: list[TracePoint]

    @property
    def seconds(self) -> float:
        """Total time, s."""
        return self.trace[-1].seconds

    @property
    def limited(self) -> bool:
        """Whether a limit of time or of evaluations stopped the inversion."""
        limits = StopReason.EVALUATION_LIMIT, StopReason.ITERATION_LIMIT, StopReason.TIME_LIMIT
        return self.result.stop_reason in limits

    def ssim_after(self, evaluations: int) -> float | None:
        """Return the similarity after a number of evaluations; None if a limit stopped it before.

        An iteration takes several evaluations, so that a limit is reached before its exact number.
        """
        points = [point for point in self.trace if point.evaluations <= evaluations]
        short = self.trace[-1].evaluations < _MIN_EVALUATIONS * evaluations
        return None if not points or (short and self.limited) else points[-1].ssim

    def first_at(self, level: float) -> TracePoint | None:
        """Return the first state with at least this similarity, or None."""
        return next((point for point in self.trace if point.ssim >= level), None)


def warm_up(recording: Recording) -> None:
    """Compile and load the code of the first solve, before time is measured."""
    problem = InverseProblem(replace(recording, truth=None))
    evaluation = problem.evaluate(np.full(recording.mesh.n_tets, START_MPA))
    evaluation.gradient()
    evaluation.jacobian()


def run_with_trace(recording: Recording, settings: Settings, scratch: Path) -> TracedRun:
    """Invert from the start of the paper and score the map of each iteration.

    The recording is inverted without its truth. A killed call continues from its checkpoint and
    its trace, which are in the folder `scratch`.
    """
    truth = recording.truth
    assert truth is not None
    checkpoint, file = scratch / "checkpoint.h5", scratch / "trace.json"
    resumed = checkpoint.is_file() and file.is_file()
    trace = [TracePoint(*point) for point in json.loads(file.read_text())] if resumed else []

    def add_point(record: dict[str, Any], youngs: np.ndarray) -> None:
        start = time.perf_counter()
        scoring = trace[-1].scoring if trace else 0.0
        similarity = ssim(recording.mesh, youngs, truth)
        seconds = record["seconds"] - scoring
        scoring += time.perf_counter() - start
        trace.append(TracePoint(record["evaluations"], seconds, similarity, scoring))
        write_file(file, json.dumps(trace))

    result = invert_map(
        replace(recording, truth=None),
        settings,
        start_mpa=START_MPA,
        checkpoint=checkpoint,
        resume=checkpoint if resumed else None,
        show_progress=False,
        on_iteration=add_point,
    )
    return TracedRun(result, trace)


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return one case per model."""
    shared = {k: v for k, v in options.items() if k != "names"}
    return {name: {"phantom": MODELS[name], "model": name, **shared} for name in options["names"]}


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Simulate presses on a model and invert them by both methods."""
    path = scratch / "recording.h5"
    if path.is_file():  # of a case that was interrupted
        recording = Recording.load(path, check_units=False)
    else:
        recording = press_object(settings)
        recording.save(path)
    warm_up(recording)
    default = Settings(model_error="none", noise=NoiseModel(relative=settings["noise_relative"]))
    ours = run_with_trace(recording, default, scratch / "ours")
    target = row("table1", settings["model"])["ssim_2500"]
    tnc = _truncated_newton(recording, settings, target, ours, scratch / "tnc")
    truth = recording.truth
    assert truth is not None
    figures = {
        "elements": recording.mesh.n_tets,
        "presses": len(recording.presses),
        "ours": _figures(ours, target, recording, truth),
        "tnc": _figures(tnc, target, recording, truth),
    }
    maps = {"truth": truth, "ours": ours.result.youngs, "tnc": tnc.result.youngs}
    return CaseResult.on_mesh(recording.mesh, figures, **maps)


def _truncated_newton(
    recording: Recording, settings: CaseSettings, target: float, ours: TracedRun, scratch: Path
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
    continued = replace(paper, optimizer=TNC(max_evaluations=_UNLIMITED), max_seconds=max_seconds)
    return run_with_trace(recording, continued, scratch)


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


def table1(results: Results, options: CaseSettings) -> Exhibit:
    """Return Table I: the paper, its method here, and this package."""
    columns: dict[str, int | None] = {"model": None, "elements: paper": None}
    columns |= {"elements: here": None, "s / iteration: paper": 2, "s / iteration: TNC": 3}
    columns |= {f"SSIM at {count}: {method}": 4 for count in COUNTS for method in ("paper", "TNC")}
    columns |= {"s to the paper's SSIM: TNC": 1, "s to the paper's SSIM: ours": 2, "ratio": 0}
    table = Table({**columns, "SSIM at the end: ours": 4, "s to the end: ours": 1})
    ratios, bounds, never = [], [], []
    for name, result in results.items():
        figures, known = result.figures, row("table1", name)
        tnc, ours = figures["tnc"], figures["ours"]
        reached, cells = tnc["to_target"], []
        for count in COUNTS:
            cells += [known[f"ssim_{count}"], tnc["after"][str(count)]]
        ratio = None
        if ours["to_target"] is None:
            never.append(name)
        else:
            ratios.append((tnc["seconds"] if reached is None else reached) / ours["to_target"])
            ratio = f"{'> ' if reached is None else ''}{ratios[-1]:.0f}"
            bounds += [name] if reached is None else []
        table.add(
            name, known["elements"], figures["elements"],
            known["seconds_per_iteration"], tnc["seconds_per_evaluation"], *cells,
            f"> {tnc['seconds']:.1f}" if reached is None else reached, ours["to_target"], ratio,
            ours["scores"]["ssim"], ours["seconds"],
        )  # fmt: skip
    lines = []
    if ratios:
        lines.append(f"Smallest ratio: {min(ratios):.0f}.")
    if bounds:
        lines.append(
            f"In {', '.join(bounds)} TNC did not reach the SSIM of the paper within its time;"
            " its total time is used instead, so that the ratio is a lower bound."
        )
    if never:
        lines.append(f"In {', '.join(never)} this package did not reach the SSIM of the paper.")
    return Exhibit([table.markdown(), "\n".join(lines)], table)


def maps(number: str, results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 4 (objects of two materials) or 5 (heterogeneous ones): truth, both methods."""
    results = {name: result for name, result in results.items() if name[0] == number}
    table = Table(
        {"model": None, "method": None, "s": 4, "SSIM": 4, "PSNR": 2, "RMSE": 4,
         "position error, mm": 2}
    )  # fmt: skip
    truths = np.concatenate([result.arrays["truth"] for result in results.values()] or [np.ones(1)])
    limits = (float(truths.min()), float(truths.max()))
    rows: dict[str, list[Panel]] = {"truth": [], "ours": [], "TNC": []}
    for name, result in results.items():
        mesh, arrays = result.mesh, result.arrays
        rows["truth"].append(Panel(mesh, arrays["truth"], limits, title=f"({name[1]})"))
        for label, method in (("ours", "ours"), ("TNC", "tnc")):
            scored = result.figures[method]["scores"]
            table.add(name, label, *(scored[key] for key in _SCORES))
            caption = f"SSIM {scored['ssim']:.3f}"
            rows[label].append(Panel(mesh, arrays[method], limits, caption=caption))
    figure = panels_figure(rows) if results else None
    return Exhibit([table.markdown()], table, figure, "Truth, this package and TNC, middle slices")


EXHIBITS = {"table1": table1, "fig4": partial(maps, "4"), "fig5": partial(maps, "5")}
