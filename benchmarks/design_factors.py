"""Design factors (Section IV-B, Table II): pressure, number of steps and sides, noise.

    python benchmarks/design_factors.py [--only CELL ...] [--out FOLDER] [--regularization NAME]

The cells are those of `tactorch.reproduce.design`, which describes them; `tactorch reproduce
table2` makes the table with default settings. This script also takes other priors.

`same mesh` inverts on the mesh that the presses were simulated on, as the paper does: an inverse
crime. `other mesh` simulates on a mesh twice as fine. The last line printed is one
JSON object with all figures.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from machine import OtherWork, describe_machine

from tactorch.inverse import Settings, invert
from tactorch.metrics import scores
from tactorch.reproduce.design import CELLS, COLUMNS, METRICS, MODELS, Cell, simulate_cell
from tactorch.reproduce.paper import paper

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
_DEFAULT = "total_variation"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cells and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=list(CELLS), default=list(CELLS))
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--regularization", default=_DEFAULT, help="prior of all cells")
    parser.add_argument("--out", type=Path, help="folder for design_factors.json and .md")
    options = parser.parse_args(arguments)
    known, meter, results = _paper(), OtherWork(), {}
    print(_header(), flush=True)
    lines = [_header()]
    for model in options.models:
        results[model] = {}
        for name in options.only:
            cell = {
                "same_mesh": run_cell(model, CELLS[name], options.regularization, same_mesh=True),
                "other_mesh": run_cell(model, CELLS[name], options.regularization, same_mesh=False),
                "paper": known.get(model, {}).get(COLUMNS.get(name, name)),
            }
            results[model][name] = cell
            lines.append(_row(model, name, cell))
            print(lines[-1], flush=True)
    share = meter.share()
    if share is not None:
        print(f"\nOther processes took {share:.0%} of the cores meanwhile.")
    if options.out is not None:
        more = "" if options.regularization == _DEFAULT else f"_{options.regularization}"
        _write(options.out / f"design_factors{more}", lines, results)
    print(json.dumps(results))


@cache
def run_cell(model: str, cell: Cell, prior: str, *, same_mesh: bool) -> dict[str, float]:
    """Simulate and invert one cell; returns the metrics of Table II and a few more."""
    recording = simulate_cell(model, cell, same_mesh=same_mesh)
    truth = recording.truth
    assert truth is not None
    blind, settings = replace(recording, truth=None), Settings(regularization=prior)
    found = invert(blind, settings, start_mpa=0.2, show_progress=False)
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
    head += ["position error, mm: same", "other", "seconds"]
    return f"| {' | '.join(head)} |\n|{'---|' * len(head)}"


def _row(model: str, name: str, cell: dict[str, Any]) -> str:
    same, other, paper = cell["same_mesh"], cell["other_mesh"], cell["paper"]
    figures = []
    for metric in METRICS:
        digits = 2 if metric == "psnr" else 4
        figures += [f"{part[metric]:.{digits}f}" if part else "" for part in (same, other, paper)]
    figures += [f"{part['position_error_mm']:.2f}" for part in (same, other)]
    figures.append(f"{same['seconds']:.1f}")
    return f"| {' | '.join([model, name, *figures])} |"


def _write(path: Path, lines: list[str], results: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), "models": results}, indent=2)
    path.with_suffix(".json").write_text(text + "\n")
    path.with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
