"""Frames a second of the sensor's stages, and of a published reconstruction on the same images.

    OMP_NUM_THREADS=1 python benchmarks/sensor_speed.py [--peer FOLDER] [--quick] [--out FOLDER]

A ball is pressed without slip into the gel of the GelSight Mini (320 x 240 px), in a simulation on
another mesh than that of the model, and dragged along. Two frames are rendered, of a small and of a
large deformation; the marker and depth stages and the forces then process them. Times are medians
over repeated frames, by the wall clock and by the processor, with one thread (OMP_NUM_THREADS=1);
the rates in the table are by the processor, which other processes affect less. The forces are
compared with those of the simulation and with those of `GelModel.smooth_forces`, which iterates to
the equilibrium as the sensor chain did before.

`--peer` names a folder with the package `gs_sdk` of github.com/joehjhuang/gs_sdk (MLP and
integration by cosine transforms). It is not on the package index, where the name belongs to another
project; neither is 9DTact. Its network has random weights here, on which its speed does not depend.
The last line printed is one JSON object.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from machine import OtherWork, write_results

from tactorch.errors import ConvergenceError
from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    fit_map,
    image_change,
    marker_pixels,
)
from tactorch.sensor.chain import ChainOptions, Measurement, SensorChain
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.description import load_sensor
from tactorch.sensor.frames import Frame
from tactorch.sensor.gel import GelContact, GelModel, GelOptions
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.render import GelSurface, build_surface, render

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "opencv-python-headless", "pypardiso", "mkl")
SENSOR = load_sensor("gelsight_mini")
BALL_MM, CENTER = 5.0, np.array([1.0, -0.5])
DEPTHS = {"small": 0.2, "large": 0.5}  # mm
REPEATS = 9
LIMIT_S = 45.0  # processor time, for the iteration


def main(arguments: Sequence[str] | None = None) -> None:
    """Time the stages and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--peer", type=Path, help="folder that has the package gs_sdk")
    parser.add_argument("--quick", action="store_true", help="coarse meshes, no slow comparison")
    parser.add_argument("--out", type=Path, help="folder for sensor_speed.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    cells = GelOptions(2.0, 2) if options.quick else GelOptions()
    fine = GelModel(SENSOR.gel, GelOptions(1.6, 2) if options.quick else GelOptions(0.8))
    chain = SensorChain(
        SENSOR, calibrated(), still(50), GelModel(SENSOR.gel, cells), ChainOptions(min_slope=0.06)
    )
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder, patch.dict(os.environ, TACTORCH_CACHE=folder):
        chain.forces.prepare()  # not from the cache
    prepared_s = time.process_time() - began
    rows = shared_stages(chain, options.peer)
    forces = []
    for name, depth in DEPTHS.items():
        truth = pressed(fine, depth)
        print(f"{name}: simulated", file=sys.stderr, flush=True)
        row, force = force_stage(chain, name, truth, compare=not options.quick)
        rows.append(row)
        forces.append(force)
    result = {"prepared_s": prepared_s, "stages": rows, "forces": forces}
    result["peer"] = options.peer is not None
    lines = format_tables(result)
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write_results(options.out, "sensor_speed", lines, result, PACKAGES)
    print(json.dumps(result))


def timed(stage: str, work: Callable[[], Any], repeats: int = REPEATS) -> dict[str, Any]:
    """Median times of a stage, s, after one call that is not timed."""
    work()
    wall, processor = [], []
    for _ in range(repeats):
        before = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - before[0])
        processor.append(time.process_time() - before[1])
    return {
        "stage": stage,
        "wall_s": float(np.median(wall)),
        "processor_s": float(np.median(processor)),
    }


def shared_stages(chain: SensorChain, peer: Path | None) -> list[dict[str, Any]]:
    """Time slopes, depth and markers on a rendered ball, and the peer on the same image."""
    image = render(SENSOR, ball_face((160.0, 120.0), 18.0), seed=7)
    calibration, reference = chain.calibration, chain.reference
    slopes = calibration.slopes(image, reference)
    assert chain.tracker is not None
    tracker = chain.tracker
    rows = [
        timed("slopes", lambda: calibration.slopes(image, reference)),
        timed("depth", lambda: reconstruct_height(slopes, SENSOR.mm_per_px, 0.06)),
        timed("markers", lambda: tracker.track(image)),
    ]
    tracker.track(reference)
    both = rows[0]["processor_s"] + rows[1]["processor_s"]
    rows.append({"stage": "slopes and depth", "processor_s": both,
                 "wall_s": rows[0]["wall_s"] + rows[1]["wall_s"]})  # fmt: skip
    if peer is not None:
        reconstruct = published(peer, reference)
        rows.append(timed("gs_sdk: slopes and depth", lambda: reconstruct(image)))
        rows[-2]["ratio"] = rows[-1]["processor_s"] / both
    return rows


def published(peer: Path, reference: np.ndarray) -> Callable[[np.ndarray], Any]:
    """Reconstruction by the published package, with random weights."""
    import torch

    sys.path.insert(0, str(peer))
    from gs_sdk.gs_reconstruct import BGRXYMLPNet, Reconstructor

    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.pth"
        torch.save(BGRXYMLPNet().state_dict(), path)
        reconstructor = Reconstructor(str(path))
    reconstructor.load_bg(reference[..., ::-1])
    return lambda image: reconstructor.get_surface_info(
        np.ascontiguousarray(image[..., ::-1]), 1.0 / SENSOR.mm_per_px[0]
    )


def force_stage(
    chain: SensorChain, name: str, truth: GelContact, *, compare: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Time the forces of a frame, and compare them."""
    face = build_surface(SENSOR, truth.points, truth.displacement)
    assert chain.tracker is not None
    chain.tracker.track(render(SENSOR, still_face(), seed=60))
    measured = chain.measure_deformation(Frame(0, name, render(SENSOR, face, seed=61), 0.0))
    assert measured.displacement is not None
    row = timed(f"forces, {name} deformation", lambda: chain.solve_contact(measured))
    contact = chain.solve_contact(measured)
    assert contact is not None
    assert contact.covariance is not None
    force: dict[str, Any] = {
        "deformation": name,
        "depth_mm": DEPTHS[name],
        "simulated_n": truth.total.tolist(),
        "force_n": contact.total.tolist(),
        "deviation_n": np.sqrt(np.diag(contact.covariance)).tolist(),
    }
    if compare:
        force |= iterated(chain, measured)
        row["ratio"] = force["iterated_s"] / row["processor_s"]
    alone = replace(measured, displacement=measured.displacement * (np.nan, np.nan, 1.0))
    depth_only = chain.solve_contact(alone)
    assert depth_only is not None
    force["depth_alone_n"] = float(depth_only.total[2])
    return row, force


def iterated(chain: SensorChain, measured: Measurement) -> dict[str, Any]:
    """Forces by iteration to the equilibrium, given up after a time limit."""

    def stop(*_: object) -> None:
        raise TimeoutError

    assert measured.displacement is not None
    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
    began, total = time.process_time(), None
    try:
        total = chain.model.smooth_forces(
            measured.displacement, chain.options.noise_mm, measured.in_contact, free_plane=True
        ).total.tolist()
    except (TimeoutError, ConvergenceError) as error:
        print(f"iteration: {error or 'time limit'}", file=sys.stderr)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    return {"iterated_s": time.process_time() - began, "iterated_n": total}


def calibrated() -> Calibration:
    """Calibrate with eight presses of a ball whose contacts are known."""
    reference, rng = still(0), np.random.default_rng(1)
    look = MarkerAppearance(SENSOR.markers.diameter_mm / SENSOR.mm_per_px[0])
    touches = []
    for number in range(8):
        middle, edge = rng.uniform((60, 50), (260, 190)), rng.uniform(16.0, 24.0)
        image = render(SENSOR, ball_face(tuple(middle), edge), seed=number + 1)
        change = image_change(image, reference, look)
        known = ~marker_pixels(image, reference, look)
        touches.append(BallPress(f"press {number}", change, known, Circle(tuple(middle), edge)))
    slope_map, _ = fit_map(
        touches, Ball(BALL_MM, SENSOR.mm_per_px), FitOptions("mlp_colour", rounds=0)
    )
    return Calibration(slope_map, reference, SENSOR.mm_per_px, look)


def still_face() -> GelSurface:
    """The face without contact."""
    return GelSurface(np.zeros(SENSOR.shape), SENSOR.to_px(SENSOR.markers.positions_mm))


def still(seed: int) -> np.ndarray:
    """The image without contact."""
    return render(SENSOR, still_face(), seed=seed)


def ball_face(middle_px: tuple[float, float], edge_px: float) -> GelSurface:
    """The face under a ball as far as its contact, and a rim that decays beyond."""
    pixel = SENSOR.mm_per_px[0]
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - middle_px[0], rows - middle_px[1]) * pixel
    edge = edge_px * pixel
    rim = 0.35 * edge / np.sqrt(BALL_MM**2 - edge**2)
    ball = np.sqrt(BALL_MM**2 - edge**2) - np.sqrt(np.maximum(BALL_MM**2 - away**2, 0.0)) - rim
    height = np.where(away < edge, ball, -rim * np.exp(-(away - edge) / 0.35))
    return GelSurface(height, still_face().markers_px)


def pressed(gel: GelModel, depth_mm: float) -> GelContact:
    """Press the ball into the gel without slip, and drag it along x by a seventh of the depth."""
    away = np.linalg.norm(gel.points[:, :2] - CENTER, axis=1)
    down = np.sqrt(np.maximum(BALL_MM**2 - away**2, 0.0)) - BALL_MM + depth_mm
    moved = np.column_stack([np.full_like(down, depth_mm / 7), np.zeros_like(down), -down])
    moved[down <= 0.0] = np.nan
    return gel.forces(moved)


def format_tables(result: dict[str, Any]) -> list[str]:
    """The tables."""
    lines = [
        "| stage | frames/s (processor) | processor, ms | wall, ms | relative time of others |",
        "|---|---|---|---|---|",
    ]
    for row in result["stages"]:
        other = "iteration" if "forces" in row["stage"] else "gs_sdk"
        ratio = f"{other}: {row['ratio']:.3g}" if "ratio" in row else "-"
        lines.append(
            f"| {row['stage']} | {1 / row['processor_s']:.3g} | {1e3 * row['processor_s']:.3g} |"
            f" {1e3 * row['wall_s']:.3g} | {ratio} |"
        )
    lines += [
        "",
        f"The compliance of the mesh took {result['prepared_s']:.2g} s, once for a mesh.",
        "" if result["peer"] else "gs_sdk was not given (--peer); it is not on the package index.",
        "| deformation | simulated x, z | forces x, z | deviation z | iterated x, z |"
        " depth alone z |",
        "|---|---|---|---|---|---|",
    ]
    for f in result["forces"]:
        (x, _, z), (fx, _, fz) = f["simulated_n"], f["force_n"]
        slow = "-"
        if f.get("iterated_n") is not None:
            slow = f"{f['iterated_n'][0]:.4f}, {f['iterated_n'][2]:.4f} ({f['iterated_s']:.1f} s)"
        elif "iterated_s" in f:
            slow = f"none in {f['iterated_s']:.0f} s"
        lines.append(
            f"| {f['deformation']}, {f['depth_mm']:g} mm | {x:.4f}, {z:.4f} N | {fx:.4f},"
            f" {fz:.4f} N | {f['deviation_n'][2]:.4f} | {slow} | {f['depth_alone_n']:.4f} N |"
        )
    return lines


if __name__ == "__main__":
    main()
