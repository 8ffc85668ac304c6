"""Design factors (Section IV-B, Table II): pressure, number of steps and sides, noise.

    python benchmarks/design_factors.py [--only CELL ...] [--out FOLDER] [--regularization NAME]
        [--method map|shapes] [--workers N]

The cells are those of `tactorch.reproduce.design`, which describes them; `tactorch reproduce
table2` makes the table with default settings. This script also takes other priors.

`same mesh` inverts on the mesh that the presses were simulated on, as the paper does: an inverse
crime. `other mesh` simulates on a mesh twice as fine. With `--method shapes`, the presses of `other
mesh` are solved with quadratic elements on a mesh that is twice as fine and follows the ball, and
`find_shapes` finds the ball; `same mesh` is left out. Cells with noise then have the median score
of an efficient estimator too: fifty balls drawn about the true one with the covariance of the
Cramer-Rao bound. The last line printed is one JSON object with all figures.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, describe_machine, map_in_processes

from tactorch.inverse import Settings, invert_map
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior, Sites
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.search import find_shapes
from tactorch.mesh import Sphere
from tactorch.mesh.quadrature import element_means
from tactorch.metrics import scores
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import Recording
from tactorch.reproduce.design import (
    CELLS,
    COLUMNS,
    METRICS,
    MODELS,
    Cell,
    make_plan,
    simulate_cell,
)
from tactorch.reproduce.paper import MATERIAL, paper
from tactorch.simulation import simulate

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
_DEFAULT = "total_variation"
_EDGE = 0.1  # of the recording's mesh, over the diagonal
_SAMPLES = 6  # along the edge of an element, for its mean modulus
_DRAWS = 50  # of an efficient estimator


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cells and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=list(CELLS), default=list(CELLS))
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--regularization", default=_DEFAULT, help="prior of all cells")
    parser.add_argument("--method", choices=("map", "shapes"), default="map")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="folder for design_factors.json and .md")
    options = parser.parse_args(arguments)
    known, meter, results = _paper(), OtherWork(), {model: {} for model in options.models}
    print(_header(), flush=True)
    lines = [_header()]
    # Several columns of the paper's table have the same presses.
    runs = list(dict.fromkeys((m, CELLS[name]) for m in options.models for name in options.only))
    work = partial(run, method=options.method, prior=options.regularization)
    finished = zip(runs, map_in_processes(work, runs, options.workers), strict=True)
    found: dict[tuple[str, Cell], dict[str, Any]] = {}
    for model in options.models:
        for name in options.only:
            while (model, CELLS[name]) not in found:
                found.update([next(finished)])
            published = known.get(model, {}).get(COLUMNS.get(name, name))
            cell = {"paper": published, **found[model, CELLS[name]]}
            results[model][name] = cell
            lines.append(_row(model, name, cell))
            print(lines[-1], flush=True)
    share = meter.share()
    if share is not None:
        print(f"\nOther processes took {share:.0%} of the cores meanwhile.")
    if options.out is not None:
        more = "" if options.regularization == _DEFAULT else f"_{options.regularization}"
        more += "_shapes" if options.method == "shapes" else ""
        _write(options.out / f"design_factors{more}", lines, results)
    print(json.dumps(results))


def run(item: tuple[str, Cell], method: str, prior: str) -> dict[str, Any]:
    """Run one cell of one model; the metrics for presses of the same mesh and of another."""
    model, cell = item
    print(f"# {model}, {cell}", file=sys.stderr, flush=True)
    if method == "shapes":
        return {"same_mesh": None, "other_mesh": run_shapes(model, cell)}
    return {
        f"{mesh}_mesh": run_cell(model, cell, prior, same_mesh=mesh == "same")
        for mesh in ("same", "other")
    }


def run_cell(model: str, cell: Cell, prior: str, *, same_mesh: bool) -> dict[str, float]:
    """Simulate and invert one cell; returns the metrics of Table II and a few more."""
    recording = simulate_cell(model, cell, same_mesh=same_mesh)
    truth = recording.truth
    assert truth is not None
    blind, settings = replace(recording, truth=None), Settings(regularization=prior)
    found = invert_map(blind, settings, start_mpa=0.2, show_progress=False)
    all_scores = scores(recording.mesh, found.youngs, truth)
    own = {short: all_scores[name] for short, name in METRICS.items()}
    more = {name: all_scores[name] for name in ("position_error_mm", "contrast_recovery", "dice")}
    return {
        **own,
        **more,
        "seconds": found.seconds,
        "iterations": found.iterations,
        "chi2": found.history[-1]["chi2"],
        "elements": recording.mesh.n_tets,
    }


def run_shapes(model: str, cell: Cell) -> dict[str, Any]:
    """Press the object on a finer, conforming, quadratic mesh, and find its shapes."""
    phantom = make_phantom(MODELS[model])
    recording = simulate(
        phantom,
        make_plan(cell),
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=_EDGE),
        fine_mesh=phantom.mesh(relative_edge_length=_EDGE / 2.0, conforming=True),
        element="tet10",
        snr_db=cell.snr_db,
        seed=0,
    )
    mesh, truth = recording.mesh, recording.truth
    assert truth is not None
    began = time.perf_counter()
    found = find_shapes(replace(recording, truth=None))
    seconds = time.perf_counter() - began

    def score(youngs_at: Callable[[Any], Any]) -> dict[str, float]:
        all_scores = scores(mesh, element_means(mesh, youngs_at, _SAMPLES), truth)
        keys = {**METRICS, "position_error_mm": "position_error_mm", "dice": "dice"}
        return {short: all_scores[name] for short, name in keys.items()}

    inclusions = [
        {"center_mm": i.shape.center_mm, "radius_mm": i.shape.radius_mm,
         "radius_90_mm": i.radius_90_mm, "youngs_mpa": i.youngs_mpa,
         "youngs_90_mpa": i.youngs_90_mpa}
        for i in found.inclusions
    ]  # fmt: skip
    result = score(found.youngs_at) | {
        "seconds": seconds,
        "chi2": found.chi2,
        "elements": mesh.n_tets,
        "inclusions": inclusions,
        "bound": None,
    }
    if cell.snr_db is not None:
        drawn = [score(youngs_at) for youngs_at in efficient_estimates(recording, phantom)]
        result["bound"] = {key: float(np.median([d[key] for d in drawn])) for key in METRICS}
    return result


def efficient_estimates(recording: Recording, phantom: Phantom) -> Iterator[Callable[[Any], Any]]:
    """Yield maps of balls drawn about the true one with the covariance of the Cramer-Rao bound."""
    ((ball, modulus),) = phantom.inclusions
    assert isinstance(ball, Sphere)
    problem = InverseProblem(replace(recording, truth=None), element="tet10")
    background = float(phantom.youngs_mpa)
    field = ShapeField(ShapePrior.of(recording.mesh, background), (BALL,))
    log_contrast = np.log(modulus / background)
    values = [np.log(background), *ball.center_mm, np.log(ball.radius_mm), log_contrast]
    z, sites = field.standard(np.array(values)), Sites.of(problem.body.assembly)
    point = ShapesOnSites(field, sites).at(z)
    jacobian = point.jacobian(problem.evaluate(point.youngs))
    bound = np.linalg.inv(jacobian.T @ jacobian)
    for draw in np.random.default_rng(0).multivariate_normal(z, bound, size=_DRAWS):
        yield partial(_youngs_at, field, draw)


def _youngs_at(field: ShapeField, z: Any, points: Any) -> Any:
    return np.exp(field.log_youngs(z, Sites.at(points)))


def _paper() -> dict[str, dict[str, dict[str, float]]]:
    """The paper's Table II by model, cell and metric."""
    table = paper()["table2"]
    return {
        model: {
            name: {metric: table[model][metric][i] for metric in METRICS}
            for i, name in enumerate(table["columns"])
        }
        for model in MODELS
    }


def _header() -> str:
    head = ["model", "cell"]
    for metric in METRICS:
        head += [f"{metric}: same mesh", "other mesh", "paper"]
    head += ["position error, mm: same", "other", "seconds", "s: bound", "ssim: bound"]
    return f"| {' | '.join(head)} |\n|{'---|' * len(head)}"


def _row(model: str, name: str, cell: dict[str, Any]) -> str:
    same, other, paper = cell["same_mesh"], cell["other_mesh"], cell["paper"]
    figures = []
    for metric in METRICS:
        digits = 2 if metric == "psnr" else 4
        figures += [f"{part[metric]:.{digits}f}" if part else "" for part in (same, other, paper)]
    figures += [f"{part['position_error_mm']:.2f}" if part else "" for part in (same, other)]
    figures.append(f"{(same or other)['seconds']:.1f}")
    bound = other.get("bound")
    figures += [f"{bound[metric]:.4f}" if bound else "" for metric in ("s", "ssim")]
    return f"| {' | '.join([model, name, *figures])} |"


def _write(path: Path, lines: list[str], results: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), "models": results}, indent=2)
    path.with_suffix(".json").write_text(text + "\n")
    path.with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
