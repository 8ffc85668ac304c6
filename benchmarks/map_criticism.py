"""How well element maps that explain wrong forces as structure are recognised.

    python benchmarks/map_criticism.py [--first 0] [--count 6] [--errors 0 0.05] [--snr 40]
        [--cache FOLDER] [--workers N] [--out FOLDER]

The presses are those of some random objects of `true_objects.py`, with exact forces or forces
that are wrong by a normal factor for each press. For each map the table has its correlation with
the object, the most probable deviation of the forces, its log-evidence over exact forces, the part
of the variance that the maps with and without these errors share, and whether the map is trusted.

The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import map_in_processes, write_results
from true_cases import RANDOM_CASES, Case, Truth, make_recording

from tactorch.inverse import Settings, invert_map
from tactorch.inverse.invert import solution
from tactorch.inverse.search.criticism import force_errors

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
HEADER = (
    "| object | error of forces | r | probable error | log-evidence | shared | trusted |\n|"
    + "---|" * 7
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=6, help="number of objects")
    parser.add_argument("--first", type=int, default=0, help="number of the first object")
    parser.add_argument("--errors", type=float, nargs="+", default=[0.0, 0.05], help="of forces")
    parser.add_argument("--snr", type=float, default=40.0, help="signal-to-noise ratio, dB")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="folder for map_criticism.json and .md")
    options = parser.parse_args(arguments)
    cases = [
        replace(case, snr_db=options.snr, fault="")
        for case in RANDOM_CASES[options.first : options.first + options.count]
    ]
    jobs = [(case, error) for case in cases for error in options.errors]
    lines, results = [HEADER], []
    print(HEADER, flush=True)
    work = partial(run, cache=options.cache)
    for found in map_in_processes(work, jobs, options.workers):
        results.append(found)
        lines.append(row(found))
        print(lines[-1], flush=True)
    summary = {"snr_db": options.snr, "cases": results}
    if options.out:
        write_results(options.out, "map_criticism", lines, summary, PACKAGES)
    print(json.dumps(summary))


def run(job: tuple[Case, float], *, cache: Path | None) -> dict[str, Any]:
    """Return the figures of one map."""
    case, error = job
    recording = make_recording(case, cache)
    factors = 1.0 + error * np.random.default_rng([case.seed, 2]).standard_normal(
        len(recording.presses)
    )
    presses = tuple(
        replace(press, forces=factor * press.forces)
        for press, factor in zip(recording.presses, factors, strict=True)
    )
    recording, settings = replace(recording, presses=presses), Settings()
    result = invert_map(recording, settings, show_progress=False)
    found = force_errors(solution(recording, result, settings), result.history[-1]["weight"])
    truth = Truth.of(case.body)
    r = np.corrcoef(np.log(result.youngs_at(truth.points)), np.log(truth.youngs))[0, 1]
    return {
        "object": case.object,
        "force_error": error,
        "elements": recording.mesh.n_tets,
        "r": float(r),
        "found": found and {**found._asdict(), "likely": found.are_likely},
    }


def row(found: dict[str, Any]) -> str:
    """Return the row of the table."""
    errors = found["found"]
    figures = (
        f"{errors['level']:.0%} | {errors['gain']:.1f} | {errors['shared']:.2f}"
        if errors
        else "| | too many elements"
    )
    trusted = "no" if errors and errors["likely"] else "yes"
    return (
        f"| {found['object']} | {found['force_error']:.0%} | {found['r']:.2f} | {figures} | "
        f"{trusted} |"
    )


if __name__ == "__main__":
    main()
