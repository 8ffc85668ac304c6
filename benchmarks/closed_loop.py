"""A robot in a closed loop against a uniform grid, without inverse crime.

    python benchmarks/closed_loop.py [--objects shallow deep empty] [--rules lump_position grid]
        [--max-presses N] [--seed K] [--out FOLDER] [--merge FILE ...]

Three cubes of 10 mm, 0.2 MPa, held at the bottom: with a ball of 1.2 mm radius and 0.8 MPa, with a
deeper one of 1.5 mm radius and 1 MPa, and with nothing inside. A simulated robot presses the top
with a round sensor of 2 mm radius at 15 kPa, at one of 25 places. The achieved positions are wrong
by 0.2 mm, the reported ones by 0.05 mm; displacements have noise of 2 um at each of 127 points of
the contact. Presses are solved with quadratic elements on a mesh that conforms to the ball and is
refined at the rim of each contact; the inversion has a box mesh that knows of the outline alone.

After each press balls are fitted to all presses so far. The run ends where the 90 % interval of the
position is narrower than 1 mm along every axis for a lump of a probability of 95 %, or where no
lump is as probable after 8 presses. The grid has 16 places in farthest-point order and the same
rule for its end. Both press the middle first. No rule and no fit uses the truth.

The table has the number of presses, that after which the interval of the most probable lump alone
was narrow enough, the width of the interval, the distance of the found centre
from the true one, and the processor time of the whole run (simulation of the presses included). The
last line printed is one JSON object. --merge makes one table of the JSON files of earlier runs.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from machine import write_results

from tactorch.inverse import Settings
from tactorch.inverse.search.draft_errors import DraftOptions
from tactorch.mesh import Box, Sphere, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec
from tactorch.robot import (
    RobotPresser,
    RobotSession,
    SimulatedRobot,
    StopRule,
    position_width_mm,
    press_until_known,
)
from tactorch.sampling import (
    LoopOptions,
    LumpPosition,
    Observer,
    Patch,
    SuggestOptions,
    UniformGrid,
    Update,
)

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
SIDE_MM, BACKGROUND_MPA = 10.0, 0.2
BALLS = {
    "shallow": (Sphere((6.6, 3.6, 7.4), 1.2), 0.8),
    "deep": (Sphere((3.8, 5.6, 6.6), 1.5), 1.0),
    "empty": None,
}
SENSOR_MM, PRESSURE_MPA, NOISE_MM = 2.0, 0.015, 0.002
REPORT_MM, FORCE = 0.05, 0.005  # deviations of what the robot reports, which its user knows
PLACES_MM = (2.4, 3.7, 5.0, 6.3, 7.6)  # along x and y
GRID = 16
RULES = {"lump_position": LumpPosition(), "grid": UniformGrid(GRID)}
MATERIAL = MaterialSpec("neo_hookean", 0.45)
CELLS, EDGE_MM = 7, 1.5


def main(arguments: Sequence[str] | None = None) -> None:
    """Run both rules on every object and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", nargs="+", choices=tuple(BALLS), default=tuple(BALLS))
    parser.add_argument("--rules", nargs="+", choices=tuple(RULES), default=tuple(RULES))
    parser.add_argument("--max-presses", type=int, default=14)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cells", type=int, default=CELLS, help="of the inversion's mesh, a side")
    parser.add_argument("--out", type=Path, help="folder for closed_loop.json and .md")
    parser.add_argument("--merge", type=Path, nargs="+", help="results of runs, made before")
    options = parser.parse_args(arguments)
    runs = (
        merged(options.merge, options.seed)
        if options.merge
        else [
            run(name, rule, options.max_presses, options.seed, options.cells)
            for name in options.objects
            for rule in options.rules
            if name != "empty" or rule != "grid"  # both end after the same number of presses
        ]
    )
    report = {"seed": options.seed, "stop": StopRule().width_mm, "runs": runs}
    lines = table(runs)
    print("\n".join(lines))
    if options.out is not None:
        write_results(options.out, "closed_loop", lines, report, PACKAGES)
    print(json.dumps(report))


def merged(paths: Sequence[Path], seed: int) -> list[dict[str, Any]]:
    """Return the runs of files in the order of the table; each object and rule once."""
    runs: dict[tuple[str, str], dict[str, Any]] = {}
    for path in paths:
        report = json.loads(path.read_text())
        if (report["seed"], report["stop"]) != (seed, StopRule().width_mm):
            raise SystemExit(f"{path} is of another seed or stop rule.")
        for one in report["runs"]:
            key = (one["object"], one["rule"])
            if key in runs:
                raise SystemExit(f"{path} has {' by '.join(key)}, as a file before.")
            runs[key] = one
    return [runs[key] for key in product(BALLS, RULES) if key in runs]


def run(name: str, rule: str, max_presses: int, seed: int, cells: int = CELLS) -> dict[str, Any]:
    """Press one object by one rule until the stop rule is met."""
    ball, began = BALLS[name], time.process_time()
    balls = () if ball is None else (ball,)
    cube = Box((SIDE_MM / 2,) * 3, (SIDE_MM,) * 3)
    robot = SimulatedRobot(
        phantom=Phantom(cube, balls, BACKGROUND_MPA), edge_mm=EDGE_MM, noise_mm=NOISE_MM,
        report_deviation_mm=REPORT_MM, force_deviation=FORCE, move_seconds=3.0,
        press_seconds=2.0, seed=seed,
    )  # fmt: skip
    mesh = box_mesh(SIDE_MM, cells, tets_per_cell=5)
    presser = RobotPresser(robot, mesh, mesh.points[:, 2] < 1e-6, MATERIAL, PRESSURE_MPA, NOISE_MM)
    with tempfile.TemporaryDirectory() as folder:
        session = RobotSession(presser, patches(), Path(folder), observers=(Progress(name, rule),))
        ended = press_until_known(
            session,
            Settings(),
            options=LoopOptions(poll_seconds=0.01, max_presses=max_presses),
            suggest=SuggestOptions(rule=RULES[rule]),
            draft=DraftOptions(pose_deviation_mm=REPORT_MM, scale_deviation=FORCE),
        )
    steps = [step(entry, name) for entry in ended.history if entry.get("searched")]
    by_press = {one["presses"]: one for one in steps}
    found = {
        "object": name,
        "rule": rule,
        "reason": ended.reason,
        **steps[-1],
        "places": list(session.pressed),
        "widths_mm": [one["width_mm"] for one in by_press.values()],
        "cpu_seconds": time.process_time() - began,
        "robot_seconds": robot.elapsed_seconds,
    }
    print(f"# {name}, {rule}: {ended.reason}; {found['cpu_seconds']:.0f} s", flush=True)
    return found


def patches() -> list[Patch]:
    """Return the candidates, the one in the middle first."""
    down = np.array([0.0, 0.0, -1.0])
    made = [Patch(np.array([x, y, SIDE_MM]), down, SENSOR_MM) for x in PLACES_MM for y in PLACES_MM]
    return sorted(made, key=lambda patch: float(np.abs(patch.center[:2] - SIDE_MM / 2).sum()))


def step(entry: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the most probable lump after an update, and its distance from the true one."""
    lumps, ball = entry["finding"]["lumps"], BALLS[name]
    values: dict[str, Any] = {"presses": entry["press"], "lumps": len(lumps)}
    values |= {"probability": None, "width_mm": None, "error_mm": None}
    if lumps:
        lump = lumps[0]
        values |= {"probability": lump["probability"], "width_mm": position_width_mm(lump)}
        values |= {"center_mm": lump["center_mm"], "deviation_mm": lump["center_deviation_mm"]}
        if ball is not None:
            offset = np.subtract(lump["center_mm"], ball[0].center_mm)
            values["error_mm"] = float(np.linalg.norm(offset))
    return values


class Progress(Observer):
    """Prints each fit."""

    def __init__(self, name: str, rule: str) -> None:
        """Set what is run."""
        self._what, self._began = f"{name}, {rule}", time.process_time()

    def found(self, update: Update) -> None:
        """See `Observer.found`."""
        shapes, count = update.result.shapes, update.entry["press"]
        text = " ".join(f"{odds:.1f}" for odds in shapes.log_odds) if shapes else "no shapes"
        width = [f"{position_width_mm(lump):.2f} mm" for lump in update.entry["finding"]["lumps"]]
        chi2 = f"{shapes.chi2:.2f}" if shapes else "-"
        seconds = time.process_time() - self._began
        print(
            f"# {self._what}, press {count}: odds {text}, widths {width}, chi2 {chi2}, "
            f"{seconds:.0f} s",
            flush=True,
        )

    def show_message(self, text: str) -> None:
        """See `Observer.show_message`."""
        print(f"# {self._what}: {text}", flush=True)


def table(runs: Sequence[dict[str, Any]]) -> list[str]:
    """One row a run."""
    lines = [
        "| object | rule | presses | most probable lump | lumps "
        "| widest 90 % interval of the position, mm | error of the position, mm "
        "| processor, s | end |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in runs:
        lines.append(
            f"| {one['object']} | {one['rule']} | {one['presses']} "
            f"| {_first(one['widths_mm'])} | {one['lumps']} "
            f"| {_mm(one['width_mm'])} | {_mm(one['error_mm'])} | {one['cpu_seconds']:.0f} "
            f"| {one['reason']} |"
        )
    return lines


def _first(widths: Sequence[float | None]) -> str:
    """Return the number of presses after which a width is small enough, not before the least."""
    rule = StopRule()
    for count, width in enumerate(widths, start=1):
        if count >= rule.min_presses and width is not None and width <= rule.width_mm:
            return str(count)
    return "-"


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
