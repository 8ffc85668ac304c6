"""Design factors (Section IV-B, Table II): how hard, how often, from how many sides, how noisy.

    python benchmarks/design_factors.py [--paper FILE] [--only CELL ...] [--out FOLDER]
                                        [--regularization NAME]

Two cubes of 10 mm and 0.2 MPa with a ball of 1 MPa, radius 0.2 sides, 0.3 (model 1) and 0.6
(model 2) sides below the top; Poisson's ratio 0.45; whole faces pressed, bottom on springs:

- p1 to p4: from above, up to 5, 10, 15 and 20 kPa in steps of 5 kPa (1, 2, 3, 4 frames);
- t2 to t9: from above, up to 20 kPa in 1, 2, 4 and 8 frames (the paper's header counts the
  unloaded one as well);
- dir1 to dir3: 8 frames up to 20 kPa from one, two and three sides (the paper does not say how
  many frames; "a consistent resolution");
- snr20, snr10: the three sides, with white noise of 20 and 10 dB on every press, as the ratio of
  powers (a tenth and a third of the signal's root mean square);
- amp20, amp10: the same as the ratio of amplitudes (a hundredth and a tenth), beside the paper's
  snr20 and snr10 once more. The paper does not define its dB; its scores at 20 dB are those
  without noise, so these may be its cells.

`same mesh` inverts on the mesh that the presses were simulated on, as the paper does: an inverse
crime. `other mesh` simulates on a mesh twice as fine. Every cell is inverted with the default
settings, started from 0.2 MPa everywhere as in the paper, which is the modulus of the cube around
the inclusion: a start that the paper's protocol leaks, and so do we, in both columns.

The paper's numbers come from a JSON file (`table2`), by default the project's shared reference
(TACTORCH_SHARED or ../shared); without it the columns stay empty. The last line printed is one
JSON object with all figures.
"""

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from machine import OtherWork, describe_machine

from tactorch.inverse import Settings, invert
from tactorch.metrics import scores
from tactorch.phantoms import make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.simulation import PressPlan, simulate

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
MODELS = {"model1": "cube_shallow_sphere", "model2": "cube_deep_sphere"}
SIDES = ("z+", "x+", "y+")
METRICS = {"s": "normalised_correlation", "ssim": "ssim", "psnr": "psnr", "rmse_mpa": "rmse_mpa"}
KPA = 1e-3  # MPa
_DEFAULT = Settings().regularization


@dataclass(frozen=True)
class Cell:
    """One column of Table II."""

    p_max_kpa: float = 20.0
    frames: int = 8
    sides: int = 1
    snr_db: float | None = None
    # The paper's, where it is not the cell's own name; cells that differ in no more run once.
    column: str | None = field(default=None, compare=False)


CELLS = {
    **{f"p{k}": Cell(p_max_kpa=5.0 * k, frames=k) for k in (1, 2, 3, 4)},
    **{f"t{t + 1}": Cell(frames=t) for t in (1, 2, 4, 8)},
    **{f"dir{n}": Cell(sides=n) for n in (1, 2, 3)},
    "snr20": Cell(sides=3, snr_db=20.0),
    "snr10": Cell(sides=3, snr_db=10.0),
    "amp20": Cell(sides=3, snr_db=40.0, column="snr20"),
    "amp10": Cell(sides=3, snr_db=20.0, column="snr10"),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cells and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--paper", type=Path, help="JSON file with the paper's table2")
    parser.add_argument("--only", nargs="+", choices=list(CELLS), default=list(CELLS))
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS))
    parser.add_argument("--regularization", default=_DEFAULT, help="prior of all cells")
    parser.add_argument("--out", type=Path, help="folder for design_factors.json and .md")
    options = parser.parse_args(arguments)
    paper, meter, results = _paper(options.paper), OtherWork(), {}
    print(_header(), flush=True)
    lines = [_header()]
    for model in options.models:
        results[model] = {}
        for name in options.only:
            cell = {
                "same_mesh": run_cell(model, CELLS[name], options.regularization, same_mesh=True),
                "other_mesh": run_cell(model, CELLS[name], options.regularization, same_mesh=False),
                "paper": paper.get(model, {}).get(CELLS[name].column or name),
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
    recording = record(model, cell, same_mesh=same_mesh)
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


def record(model: str, cell: Cell, *, same_mesh: bool) -> Recording:
    """Simulate the presses of one cell."""
    phantom = make_phantom(MODELS[model])
    return simulate(
        phantom,
        plan_of(cell),
        material=MaterialSpec("neo_hookean", 0.45),
        mesh=phantom.mesh(relative_edge_length=0.1),
        fine_mesh=None if same_mesh else phantom.mesh(relative_edge_length=0.05),
        samples=1 if same_mesh else 4,
        snr_db=cell.snr_db,
        seed=0,
    )


def plan_of(cell: Cell) -> PressPlan:
    """The presses of one cell."""
    faces = SIDES[: cell.sides]
    return PressPlan.ramp(faces=faces, p_max_mpa=cell.p_max_kpa * KPA, steps=cell.frames)


def _paper(path: Path | None) -> dict[str, dict[str, dict[str, float]]]:
    """The paper's Table II by model, cell and metric; empty where it is not to be had."""
    if path is None:
        shared = Path(os.environ.get("TACTORCH_SHARED", "../shared"))
        path = shared / "reference" / "paper_numbers.json"
        if not path.is_file():
            return {}
    table = json.loads(path.read_text())["table2"]
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
