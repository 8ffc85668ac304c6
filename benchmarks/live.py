"""`tactorch live`: time from a press to the map, compared with an inversion of all presses.

    python benchmarks/live.py [--session sides] [--rule auto] [--out FOLDER]

Two sessions of twelve presses on a cube of 10 mm with a stiff ball, 2,058 elements, simulated on a
finer mesh of quadratic elements with 40 dB of noise:

- `sides`: whole sides, alternating between three directions with increasing pressure (192 data per
  press);
- `patches`: a round sensor of 3 mm radius at four places on each of three sides (33 data per
  press).

A press is appended to the recording when the run waits for one. The table has the seconds from then
on: `map` until the map is saved and logged, `picture` until live.png and live.html show it, `next`
until the next location is suggested and shown. `processor` is the processor time of this process on
all cores, which other processes affect less; `host` is the share of all cores that the host of a
virtual machine gave to other guests (a dash where unknown). Updates have a time limit; a row `at
rest` is of the converged map, while no press waits. The last rows compare the map after the last
press with an inversion of the complete recording from 0.2 MPa (`invert`), and with `invert` started
from the last map. No shapes are fitted. Only the scores use the truth. The last line printed is one
JSON object.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, write_results

from tactorch.cli.live_view import Screen
from tactorch.inverse import Settings, invert_map
from tactorch.mesh import box_mesh
from tactorch.metrics import find_inclusion, scores
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording, append_press
from tactorch.sampling import (
    LoopOptions,
    RecordingSource,
    SamplingLoop,
    Suggester,
    SuggestOptions,
    Update,
)
from tactorch.simulation import PressPlan, simulate

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl", "matplotlib")
CELLS, FINE_CELLS, SNR_DB = 7, 10, 40.0
SIDES = ["z+", "x+", "y+"]
CORNERS = [[3, 3, 3], [7, 7, 7], [3, 7, 3], [7, 3, 7]]
AIM_S = 3.0
QUIET = 0.05  # of the cores given to others by the host, and no more
SESSIONS = ("sides", "patches")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run both sessions and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for live.json and .md")
    parser.add_argument("--session", choices=SESSIONS, nargs="*", default=SESSIONS)
    parser.add_argument("--rule", default="auto", help="of the suggested places")
    options = parser.parse_args(arguments)
    meter, lines, result = OtherWork(), [], {}
    for name in options.session:
        figures = session(name, options.rule)
        result[name] = figures
        lines += table(name, figures)
        print("\n".join(table(name, figures)), flush=True)
    busy = meter.share()
    result["other_work"] = busy
    result["stolen"] = meter.stolen()
    lines.append(
        f"Meanwhile other processes took {_percent(busy)} of the cores, and the host gave "
        f"{_percent(result['stolen'])} to other machines."
    )
    print(lines[-1] + "\n")
    if options.out is not None:
        write_results(options.out, "live", lines, result, PACKAGES)
    print(json.dumps(result))


def recording_of(name: str) -> Recording:
    """Simulate a session."""
    if name == "sides":
        phantom, plan = (
            make_phantom("cube_sphere", depth=0.4),
            PressPlan(p_max_mpa=0.02, steps=4, faces=SIDES),
        )
    else:
        phantom = make_phantom("cube_sphere", depth=0.4, radius=0.22)
        plan = PressPlan(
            SIDES, [0.03], patch_radius_mm=3.0, patch_centers_mm=CORNERS, support="fixed"
        )
    made = simulate(
        phantom,
        plan,
        mesh=box_mesh(10.0, CELLS, tets_per_cell=6),
        fine_mesh=box_mesh(10.0, FINE_CELLS, tets_per_cell=5),
        element="tet10",
        snr_db=SNR_DB,
    )
    return made.select([4 * side + turn for turn in range(4) for side in range(3)])


class Robot(Screen):
    """Screen of a run that presses when the run waits."""

    def __init__(self, folder: Path, path: Path, recording: Recording) -> None:
        """Set the presses to replay."""
        super().__init__(folder, path)
        self._recording, self._path, self._pressed = recording, path, 0
        self._began, self._cpu, self._meter = 0.0, 0.0, OtherWork()
        self.rows: list[dict[str, Any]] = []

    def waiting(self, presses: int, idle_seconds: float) -> None:
        """Press, if the last press is in the map."""
        if presses < self._pressed or self._pressed == len(self._recording.presses):
            return
        self._began, self._cpu = time.perf_counter(), time.process_time()
        self._meter = OtherWork()
        if self._pressed == 0:
            self._recording.select([0]).save(self._path)
        else:
            append_press(self._path, self._recording.presses[self._pressed])
        self._pressed += 1

    def updated(self, update: Update) -> None:
        """Record the time to the map and to its figure."""
        until_map = time.perf_counter() - self._began
        worked, stolen = time.process_time() - self._cpu, self._meter.stolen()
        super().updated(update)
        youngs = update.youngs
        self.rows.append(
            {
                "press": update.entry["press"],
                "at_rest": not update.entry["names"],
                "map_s": until_map,
                "map_cpu_s": worked,
                "stolen": stolen,
                "picture_s": time.perf_counter() - self._began,
                "next_s": None,
                "iterations": update.entry["iterations"],
                "chi2": update.entry["chi2"],
                **quality(self._recording, youngs),
            }
        )
        print(f"press {update.entry['press']}: {until_map:.1f} s", flush=True)

    def suggested(self, update: Update) -> None:
        """Record the time to the suggestion."""
        super().suggested(update)
        press = next(row for row in reversed(self.rows) if not row["at_rest"])
        press["next_s"] = time.perf_counter() - self._began


def session(name: str, rule: str) -> dict[str, Any]:
    """Follow a session, and invert it whole."""
    recording = recording_of(name)
    with tempfile.TemporaryDirectory() as place:
        folder, path = Path(place) / "run", Path(place) / "session.h5"
        folder.mkdir()
        count = len(recording.presses)
        options = LoopOptions(poll_seconds=0.05, max_presses=count)
        with Robot(folder, path, recording) as robot:
            suggester = Suggester(Settings(), SuggestOptions(rule=rule))
            ended = SamplingLoop(
                RecordingSource(path),
                Settings(method="map"),
                folder,
                robot,
                options=options,
                suggester=suggester,
            ).run()
    assert ended.update is not None
    before = time.perf_counter()
    whole = invert_map(recording, show_progress=False)
    whole_s = time.perf_counter() - before
    live = ended.update.youngs
    before = time.perf_counter()
    invert_map(recording, start_mpa=live, show_progress=False)
    again_s = time.perf_counter() - before
    presses = [row for row in robot.rows if not row["at_rest"]]
    quiet = [row for row in presses if row["stolen"] is not None and row["stolen"] <= QUIET]
    return {
        "presses": robot.rows,
        "median_map_cpu_s": float(np.median([row["map_cpu_s"] for row in presses])),
        "median_map_s": float(np.median([row["map_s"] for row in presses])),
        "longest_map_s": max(row["map_s"] for row in presses),
        "within_aim": _in_time(presses),
        "quiet": {"presses": len(quiet), "within_aim": _in_time(quiet)},
        "live": quality(recording, live),
        "invert": {"seconds": whole_s, **quality(recording, whole.youngs)},
        "invert_from_last_map_s": again_s,
        "mean_difference_of_log_youngs": float(np.abs(np.log(live / whole.youngs)).mean()),
    }


def quality(recording: Recording, youngs: np.ndarray) -> dict[str, Any]:
    """Scores against the truth, and where the inclusion is."""
    assert recording.truth is not None
    got = scores(recording.mesh, youngs, recording.truth)
    found = find_inclusion(recording.mesh, youngs)
    return {
        "r": got["pearson"],
        "ssim": got["ssim"],
        "position_error_mm": got["position_error_mm"],
        "center_mm": None if found is None else [round(float(x), 2) for x in found.center_mm],
    }


def table(name: str, figures: dict[str, Any]) -> list[str]:
    """The session as Markdown."""
    rows = [
        f"| {row['press']}{' (at rest)' if row['at_rest'] else ''} "
        f"| {row['map_s']:.1f} | {row['map_cpu_s']:.1f} | {_percent(row['stolen'])} "
        f"| {row['picture_s']:.1f} | {_seconds(row['next_s'])} | {row['iterations']} "
        f"| {row['chi2']:.3f} | {row['r']:.3f} | {row['ssim']:.3f} "
        f"| {_millimetres(row['position_error_mm'])} |"
        for row in figures["presses"]
    ]
    live, whole, quiet = figures["live"], figures["invert"], figures["quiet"]
    presses = sum(not row["at_rest"] for row in figures["presses"])
    compared = [
        f"| {label} | {seconds} | {got['r']:.3f} | {got['ssim']:.3f} "
        f"| {_millimetres(got['position_error_mm'])} | {got['center_mm']} |"
        for label, seconds, got in (
            ("live, after the last press", "", live),
            ("invert, whole", f"{whole['seconds']:.1f}", whole),
        )
    ]
    return [
        f"## {name}",
        "",
        "| press | map, s | processor, s | host | picture, s | next, s | iterations | chi2 | r "
        "| SSIM | position, mm |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
        *rows,
        "",
        f"A map within {AIM_S:g} s: {figures['within_aim']} of {presses} presses; median "
        f"{figures['median_map_s']:.1f} s, longest {figures['longest_map_s']:.1f} s. While the "
        f"host gave at most {QUIET:.0%} to others: {quiet['within_aim']} of {quiet['presses']}. "
        f"From the same map `invert` would take {figures['invert_from_last_map_s']:.1f} s.",
        "",
        "| all presses | s | r | SSIM | position, mm | centre, mm |",
        "|---|---|---|---|---|---|",
        *compared,
        "",
        "Mean difference of the two maps' log-moduli: "
        f"{figures['mean_difference_of_log_youngs']:.3f}.",
        "",
    ]


def _in_time(presses: list[dict[str, Any]]) -> int:
    return sum(row["map_s"] <= AIM_S for row in presses)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.0%}"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _millimetres(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.2f}"


if __name__ == "__main__":
    main()
