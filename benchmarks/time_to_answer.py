"""Time from a recording to the result of the search for inclusions, posterior included.

    python benchmarks/time_to_answer.py [--before CHECKOUT] [--limit SECONDS] [--only NAME ...]
        [--cache FOLDER] [--out FOLDER]

The recordings are those of `true_objects.py` (solved on other, finer meshes): whole sides, nine
patches, a dome under fingers, and patches that are misplaced by 0.3 mm; a robot's palpation of two
nodules (589 probes, where the data of the folder TACTORCH_SHARED or ../shared exist), and a
simulated one of 2,304 probes (`simulated_palpation.py`). Each is inverted in a separate process, by
the package of this checkout, and with `--before` also by that of another one, one after the other.
The latter ends after the time of `--limit`.
`cpu` is the processor time of the process, `seconds` the elapsed time, both of `find_shapes` alone,
`first` that to the provisional answer; `GiB` is the largest memory. Stages of the search are those
that it logs, with the processor time at their end. `centre` is the distance of the first
inclusion's centre (mm), `E` and `R` its modulus and radius over those of the object, and `in 90 %`
whether these are within their intervals. The last line printed is one JSON object.
"""

import argparse
import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CASES = {
    "sides": "ball-sides4-40db",
    "patches": "ball-patches-40db",
    "fingers": "dome-fingers-40db",
    "misplaced": "ball-patches-40db-places",
    "palpation": "two-nodules",
    "probes": "simulated_palpation",
}
PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
HEADER = """\
| case | version | cpu | seconds | first | GiB | chi2 | lumps | centre | E | R | in 90 % |
|---|---|---|---|---|---|---|---|---|---|---|---|"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, help="checkout of another version")
    parser.add_argument("--limit", type=float, help="longest time of the other version, s")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--out", type=Path, help="folder for time_to_answer.md and .json")
    parser.add_argument("--invert", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.invert:
        print(json.dumps(invert(*options.invert)))
        return
    from machine import OtherWork, write_results

    meter, rows, lines = OtherWork(), [], [HEADER]
    versions: dict[str, tuple[Path, float | None]] = {"now": (ROOT, None)}
    if options.before:
        versions["before"] = options.before.resolve(), options.limit
    print(HEADER, flush=True)
    for name in options.only:
        for version, (checkout, limit) in versions.items():
            row = {"case": name, "version": version, **run(name, checkout, options.cache, limit)}
            rows.append(row)
            lines.append(describe(row))
            print(lines[-1], flush=True)
    result = {"rows": rows, "other_work": meter.share()}
    if options.out is not None:
        write_results(options.out, "time_to_answer", lines, result, PACKAGES)
    print(json.dumps(result))


def run(name: str, checkout: Path, cache: Path | None, limit: float | None) -> dict[str, Any]:
    """Invert the recording of a case by a checkout, in another process; None after the limit."""
    command = [sys.executable, __file__, "--invert", str(checkout), name, str(cache or "")]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return {"limit": limit}
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def make(name: str, cache: Path | None) -> tuple[Any, tuple[Any, float, float] | None]:
    """Return the recording of a case; centre (mm), modulus (MPa) and radius (mm) if known."""
    if name == "palpation":
        from tactorch.importers import import_palpation

        shared = Path(os.environ.get("TACTORCH_SHARED", ROOT.parent / "shared"))
        table = shared / "data" / "robot-palpation" / f"{CASES[name]}.csv"
        return import_palpation(table, depth_mm=8.0), None
    if name == "probes":
        from simulated_palpation import CENTER, LUMP, RADIUS, simulated_palpation

        return simulated_palpation(), (CENTER, LUMP, RADIUS)
    from true_cases import CASES as OBJECTS
    from true_cases import Truth, make_recording

    case = next(case for case in OBJECTS if case.name == CASES[name])
    truth = Truth.of(case.body)
    center = truth.points[truth.lumps == 1].mean(axis=0)
    known = center, float(truth.lump_moduli_mpa[0]), float(truth.lump_radii_mm[0])
    return make_recording(case, cache), known


def score(
    center: Any, youngs: float, radius: float, inclusions: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the errors of the first inclusion; none without one."""
    import numpy as np

    if not inclusions:
        return {}
    first = inclusions[0]
    within = [
        low <= true <= high
        for (low, high), true in ((first["youngs_90"], youngs), (first["radius_90"], radius))
    ]
    return {
        "center_error_mm": float(np.linalg.norm(center - first["center_mm"])),
        "youngs_ratio": first["youngs_mpa"] / youngs,
        "radius_ratio": first["radius_mm"] / radius,
        "within_90": within,
    }


def describe(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    if "limit" in row:
        return f"| {row['case']} | {row['version']} | | > {row['limit']:.0f} |{' |' * 8}"
    cells = [row["case"], row["version"], f"{row['cpu']:.0f}", f"{row['seconds']:.0f}"]
    first = [s for what, _, s in row["stages"] if what.startswith("provisional")]
    cells += [f"{first[0]:.0f}" if first else "", f"{row['gib']:.1f}", f"{row['chi2']:.4f}"]
    cells.append(str(len(row["inclusions"])))
    if "center_error_mm" in row:
        cells += [f"{row[key]:.3f}" for key in ("center_error_mm", "youngs_ratio", "radius_ratio")]
        cells.append(", ".join("yes" if within else "no" for within in row["within_90"]))
    else:
        cells += [""] * 4
    return f"| {' | '.join(cells)} |"


def invert(checkout: str, name: str, cache: str) -> dict[str, Any]:
    """Return figures of a search by the package of a checkout, which makes the recording."""
    sys.path.insert(0, checkout)
    import tactorch
    from tactorch.inverse.search import find_shapes

    assert tactorch.__file__ is not None
    assert Path(tactorch.__file__).is_relative_to(checkout), tactorch.__file__
    from machine import peak_gib

    (recording, truth), stages = make(name, Path(cache) if cache else None), Stages()
    logging.getLogger("tactorch").addHandler(stages)
    logging.getLogger("tactorch").setLevel(logging.INFO)
    began, cpu = time.perf_counter(), time.process_time()
    result = find_shapes(recording)
    figures: dict[str, Any] = {
        "cpu": time.process_time() - cpu,
        "seconds": time.perf_counter() - began,
        "gib": peak_gib(),
        "chi2": result.chi2,
        "errors": dict(result.errors),
        "models": [entry["model"] for entry in result.history],
        "stages": stages.found,
        "inclusions": [
            {
                "center_mm": i.shape.center_mm, "radius_mm": i.shape.radius_mm,
                "youngs_mpa": i.youngs_mpa, "youngs_90": i.youngs_90_mpa,
                "radius_90": i.radius_90_mm, "probability": i.probability,
            }
            for i in result.inclusions
        ],
    }  # fmt: skip
    return figures | (score(*truth, figures["inclusions"]) if truth else {})


class Stages(logging.Handler):
    """What a search logs, with the processor time and the elapsed time."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, float, float]] = []
        self._began = time.process_time(), time.perf_counter()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message."""
        cpu, elapsed = time.process_time() - self._began[0], time.perf_counter() - self._began[1]
        self.found.append((record.getMessage(), round(cpu, 2), round(elapsed, 2)))


if __name__ == "__main__":
    main()
