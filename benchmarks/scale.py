"""Time and memory of an inversion by mesh size, and a real anatomy (DigiBreast).

    python benchmarks/scale.py [--sizes N ...] [--without-breast] [--only-breast] [--out FOLDER]

The objects are cubes of 10 mm and 0.2 MPa with a ball of 1 MPa (radius 2 mm, centre 3 mm below the
top), meshed with five tetrahedra per cell to about the requested sizes. There are twelve presses on
three sides at 5, 10, 15 and 20 kPa, with noise of 40 dB. Each cube is inverted with matrix-free
Newton-CG from a uniform 0.2 MPa in a separate process, whose peak resident memory and processor
time (including start-up; least affected by other processes) are read at its end. Another process
computes the presses on the mesh of the inversion. This inverse crime affects neither time nor
memory, but raises the correlation with the truth.

The breast (`breast.py`) is without inverse crime. The last line printed is one JSON object.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from machine import describe_machine, peak_gib

from tactorch.inverse import NewtonCG, Settings, invert_map
from tactorch.mesh import box_mesh
from tactorch.metrics import position_error_mm, scores
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)
LIMIT_GIB = 12.0
FIGURES = (
    "elements", "iterations", "seconds", "cpu_seconds", "peak_gib", "pearson", "position_error_mm",
    "chi2",
)  # fmt: skip
_START_MPA = 0.2
_TETS_PER_CELL = 5


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the sizes and the breast; print the tables and the JSON line."""
    options = _parse(arguments)
    if options.simulate:
        record(*options.simulate).save(options.file)
        return
    if options.invert:
        print(json.dumps(inverted(Recording.load(options.file), options.max_seconds)))
        return
    results: dict[str, Any] = {"sizes": [], "breast": None}
    print(_header(), flush=True)
    for size in () if options.only_breast else options.sizes:
        row = run_size(size, options.max_seconds)
        results["sizes"].append(row)
        print(_row(row), flush=True)
    if not options.without_breast:
        results["breast"] = _breast(options.out, options.max_seconds)
    if hasattr(os, "getloadavg"):
        results["load"] = round(os.getloadavg()[2], 1)
        print(f"\nLoad of the machine in the last quarter of an hour: {results['load']}.")
    if options.out is not None:
        write(options.out, results)
    print(json.dumps(results))


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES))
    parser.add_argument("--without-breast", action="store_true")
    parser.add_argument("--only-breast", action="store_true")
    parser.add_argument("--max-seconds", type=float, help="time limit of each inversion")
    parser.add_argument("--out", type=Path, help="folder for scale.json, .md and pictures")
    parser.add_argument("--simulate", nargs=1, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--invert", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def cells(size: int) -> int:
    """Return the number of cells along an edge for about `size` tetrahedra."""
    return max(1, round((size / _TETS_PER_CELL) ** (1.0 / 3.0)))


def record(size: int) -> Recording:
    """Simulate the presses on a cube of about `size` tetrahedra."""
    mesh = box_mesh(10.0, cells(size), tets_per_cell=_TETS_PER_CELL)
    plan = PressPlan(("z+", "x+", "y+"), (0.005, 0.01, 0.015, 0.02))
    return simulate(
        make_phantom("cube_shallow_sphere"), plan, mesh=mesh, samples=4, snr_db=40.0, seed=0
    )


def run_size(size: int, max_seconds: float | None) -> dict[str, Any]:
    """Simulate in one process and invert in another; return the figures."""
    began = time.perf_counter()
    box_mesh(10.0, cells(size), tets_per_cell=_TETS_PER_CELL)
    meshing = time.perf_counter() - began
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        began = time.perf_counter()
        child("--simulate", str(size), "--file", str(path))
        simulating = time.perf_counter() - began
        limit = () if max_seconds is None else ("--max-seconds", str(max_seconds))
        figures = json.loads(child("--invert", "--file", str(path), *limit).splitlines()[-1])
    return {**figures, "mesh_seconds": meshing, "simulation_seconds": simulating}


def child(*arguments: str) -> str:
    """Run this script in a separate process and return its output."""
    command = [sys.executable, str(Path(__file__).resolve()), *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def inverted(recording: Recording, max_seconds: float | None = None) -> dict[str, Any]:
    """Invert from 0.2 MPa; return the figures, with the peak memory of this process."""
    settings = Settings(optimizer=NewtonCG(), max_seconds=max_seconds)
    result = invert_map(recording, settings, start_mpa=_START_MPA, show_progress=False)
    figures: dict[str, Any] = {
        "elements": recording.mesh.n_tets,
        "unknowns": 3 * recording.mesh.n_points,
        "presses": len(recording.presses),
        "seconds": result.seconds,
        "cpu_seconds": time.process_time(),
        "peak_gib": peak_gib(),
        "iterations": result.iterations,
        "products": sum(entry["products"] for entry in result.history),
        "chi2": result.history[-1]["chi2"],
        "stop_reason": result.stop_reason,
    }
    if recording.truth is not None:
        figures["pearson"] = scores(recording.mesh, result.youngs, recording.truth)["pearson"]
        figures["position_error_mm"] = position_error_mm(
            recording.mesh, result.youngs, recording.truth
        )
    return figures


def _breast(out: Path | None, max_seconds: float | None) -> dict[str, Any] | None:
    import breast

    folder = breast.folder()
    if folder is None:
        print(f"\nDigiBreast is omitted: {breast.WHERE} does not exist.")
        return None
    figures = breast.run(folder, out, max_seconds)
    print("\n" + breast.table(figures), flush=True)
    return figures


def _header() -> str:
    return f"| {' | '.join(FIGURES)} |\n|{'---|' * len(FIGURES)}"


def _row(figures: dict[str, Any]) -> str:
    return f"| {' | '.join(_text(figures.get(name)) for name in FIGURES)} |"


def _text(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw seconds and memory over elements, on logarithmic axes."""
    from matplotlib.figure import Figure

    elements = [row["elements"] for row in rows]
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    for axes, name, label in zip(
        figure.subplots(1, 2), ("seconds", "peak_gib"), ("seconds", "peak memory, GiB"), strict=True
    ):
        axes.loglog(elements, [row[name] for row in rows], "o-", color="#0072B2")
        axes.set_xlabel("tetrahedra")
        axes.set_ylabel(label)
        axes.grid(which="both", color="0.9")
        if name == "peak_gib":
            axes.axhline(LIMIT_GIB, color="#D55E00", linestyle="--")
            axes.annotate("limit", (elements[0], 0.85 * LIMIT_GIB), va="top", color="#D55E00")
    figure.suptitle("Inversion of twelve presses, matrix-free Newton-CG")
    figure.savefig(path, dpi=150)


def write(folder: Path, results: dict[str, Any]) -> None:
    """Save the table, the figures and the picture."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), **results}, indent=2)
    (folder / "scale.json").write_text(text + "\n")
    lines = [_header(), *map(_row, results["sizes"])]
    if results["breast"] is not None:
        import breast

        lines += ["", breast.table(results["breast"])]
    (folder / "scale.md").write_text("\n".join(lines) + "\n")
    if len(results["sizes"]) > 1:
        plot(results["sizes"], folder / "scale.png")


if __name__ == "__main__":
    main()
