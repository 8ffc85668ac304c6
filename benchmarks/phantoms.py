"""All test objects of the paper: what is found of each with default settings, in numbers and words.

    python benchmarks/phantoms.py [--only NAME...] [--workers N] [--runs FOLDER] [--out FOLDER]
        [--picture FILE]

Each object is pressed, inverted and scored by the commands of a user: `tactorch simulate`,
`tactorch invert` and `tactorch evaluate`. Cubes are pressed on three sides, bodies with a flat top
there, and others at six points around (`PRESSES`). The presses are solved on finer meshes whose
faces follow the inclusions, with noise of 40 dB. Scores compare with the object, averaged over the
elements of the recording. The picture has slices through the middle of each object: the object
above, what is found below.

A run that is in the folder `--runs` is not made again: use a new one for each version of the code.
The last line printed is one JSON object.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from machine import OtherWork, map_in_processes, write_results

from tactorch.inverse import Reconstruction
from tactorch.phantoms import PHANTOMS
from tactorch.recording import Recording
from tactorch.viz.figure import save_figure
from tactorch.viz.paper import Panel, panels_figure

NAMES = tuple(name for name in PHANTOMS.names() if name not in ("mesh", "labelled"))
PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
COLUMNS = 6  # of the picture
TOP, AROUND = ["press=top"], ["press=around", "press.points=6", "press.steps=1"]
PRESSES = {
    "cylinder_sphere": TOP,
    "cylinder_hole_sphere": TOP,
    "hyperboloid_sphere": [*TOP, "press.p_max_mpa=0.01"],  # it buckles under twice as much
    "hemisphere_spheres": AROUND,
    "hemisphere_random": AROUND,
    "hemisphere_two_spheres": AROUND,
    # Its neck bends under the pressure that the others bear.
    "toy_two_spheres": [*AROUND, "press.p_max_mpa=0.01"],
}
LIMITS = (0.0, 1.0)  # of its colours, MPa


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the objects, and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", default=list(NAMES), choices=NAMES)
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--runs", type=Path, default=Path("runs/phantoms"))
    parser.add_argument("--out", type=Path, help="folder for phantoms.json and .md")
    parser.add_argument("--picture", type=Path, help="PNG of all objects")
    options = parser.parse_args(arguments)
    work, meter = partial(run, folder=options.runs), OtherWork()
    lines = ["| phantom | r | contrast | s | words |", "|---|---|---|---|---|"]
    rows = dict(
        zip(options.only, map_in_processes(work, options.only, options.workers), strict=True)
    )
    lines += [_line(name, row) for name, row in rows.items()]
    print("\n".join(lines))
    result = {"phantoms": rows, "other_work": meter.share()}
    if options.out is not None:
        write_results(options.out, "phantoms", lines, result, PACKAGES)
    if options.picture is not None:
        known = [name for name, row in rows.items() if "error" not in row]
        save_figure(panels_figure(picture(known, options.runs)), options.picture, dpi=70)
    print(json.dumps(result))


def run(name: str, folder: Path) -> dict[str, Any]:
    """Press, invert and score an object; return scores, words and seconds."""
    print(f"{name} ...", file=sys.stderr, flush=True)
    recording, out = folder / f"{name}.h5", folder / name
    try:
        if not recording.exists():
            tactorch("simulate", f"phantom={name}", *PRESSES.get(name, []), f"out={recording}")
        began = time.perf_counter()
        if not (out / "scores.json").exists():
            tactorch("invert", f"recording={recording}", f"run_dir={out}", "plots=false")
            (out / "seconds").write_text(f"{time.perf_counter() - began:.0f}")
            tactorch("evaluate", f"run={out}")
    except subprocess.CalledProcessError as error:
        return {"error": error.stderr.strip().splitlines()[-1]}
    scores = json.loads((out / "scores.json").read_text())["reconstruction"]
    words = (out / "finding.txt").read_text().strip()
    return {"scores": scores, "words": words, "seconds": float((out / "seconds").read_text())}


def tactorch(*arguments: str) -> None:
    """Run a command of the package."""
    command = [sys.executable, "-m", "tactorch", *arguments]
    subprocess.run(command, check=True, capture_output=True, text=True)


def picture(names: Sequence[str], folder: Path) -> dict[str, list[Panel]]:
    """Return rows of slices, alternately of objects and of what is found."""
    rows: dict[str, list[Panel]] = {}
    for first in range(0, len(names), COLUMNS):
        number = f" {first // COLUMNS + 1}" if len(names) > COLUMNS else ""
        for name in names[first : first + COLUMNS]:
            recording = Recording.load(folder / f"{name}.h5")
            result, truth = (
                Reconstruction.load(folder / name / "reconstruction.h5"),
                recording.truth,
            )
            assert truth is not None
            title = name.replace("_", " ")
            panels = {
                "object": Panel(recording.mesh, recording.truth, LIMITS, title=title),
                "found": Panel(recording.mesh, result.youngs, LIMITS),
            }
            for row, panel in panels.items():
                rows.setdefault(row + number, []).append(panel)
    return rows


def _line(name: str, row: Mapping[str, Any]) -> str:
    if "error" in row:
        return f"| {name} | failed: {row['error']} |"
    scores = row["scores"]
    known = scores["pearson"] is not None  # not of a uniform body
    cells = [f"{scores['pearson']:.3f}", f"{scores['contrast_recovery']:.2f}"] if known else "--"
    words = " ".join(row["words"].split())
    return f"| {name} | {' | '.join(cells)} | {row['seconds']:.0f} | {words} |"


if __name__ == "__main__":
    main()
