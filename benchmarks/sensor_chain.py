"""From camera images alone to a map of Young's modulus, without inverse crime (Section VI).

    python benchmarks/sensor_chain.py [--cell 0.5] [--out FOLDER]

A cube of 10 mm with a stiff ball is pressed on three sides by a gel of 16 mm that is wider than it,
both in one finite element simulation that shares the nodes where they touch (contact without slip).
The gel's face is drawn as its camera would see it. From there on nothing but images, poses and what
is known of sensor and object goes in: calibration with drawn presses of a ball, markers, depth,
contact forces on a gel mesh twice as coarse, a press on a cube mesh of another size, inversion.
What each stage gets wrong is told against the simulation. The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, describe_machine
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.inverse import Settings, invert
from tactorch.mesh import TetMesh, box_mesh
from tactorch.metrics import scores
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sensor.calibration import (
    Ball,
    Calibration,
    FitOptions,
    Quality,
    Touch,
    change,
    find_circle,
    fit_circle,
    fit_map,
    hidden,
    judge,
)
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import press_of
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.frames import Frame
from tactorch.sensor.gel import GelModel, gel_mesh
from tactorch.sensor.image import Image
from tactorch.sensor.markers import MarkerLook, displacement_mm
from tactorch.sensor.render import Face, face_of, render

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "opencv-python-headless", "pypardiso", "mkl")
SIDE, DEPTH, POISSON = 10.0, 1.0, 0.45
BALL_MM, BALL_MPA, SOFT_MPA = (6.0, 4.4, 6.6), 1.0, 0.2
GEL = GelLayer(4.0, 0.12, POISSON, size_mm=(16.0, 16.0))
SENSOR = SensorDescription(
    "simulated", (320, 320), (0.05, 0.05), GEL, MarkerGrid(13, 13, (1.2, 1.2), 0.45)
)  # fmt: skip
LOOK = MarkerLook(9.0)
# Turns of the cube that bring a side up.
SIDES = {
    "z+": np.eye(3),
    "x+": np.array([(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]),
    "y+": np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]),
}
MIDDLE = np.full(3, SIDE / 2)


@dataclass(frozen=True, eq=False)
class Scene:
    """Gel and cube in equilibrium, the cube with the pressed side up.

    Attributes:
        points: Nodes of the gel's face at rest, in the sensor's frame.
        moved: Their displacement against the gel's window, in the sensor's frame.
        force: Of the cube on the gel, N, in the sensor's frame.
        cube: Displacement over the cube's grid, (n, n, n, 3).
    """

    points: np.ndarray
    moved: np.ndarray
    force: np.ndarray
    cube: np.ndarray


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chain and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cell", type=float, default=0.5, help="of the simulation, mm")
    parser.add_argument("--out", type=Path, help="folder for sensor_chain.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    calibration, quality = calibrated()
    rows, presses = [], []
    for number, (name, turn) in enumerate(SIDES.items()):
        scene = simulated(turn, options.cell)
        press, figures = seen(name, turn, scene, calibration, seed=number)
        presses.append(press)
        rows.append({"side": name, **figures})
    located = inverted(presses)
    result = {"calibration": vars(quality), "sides": rows, "map": located}
    lines = told(result)
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write(options.out, lines, result)
    print(json.dumps(result))


def simulated(turn: np.ndarray, cell: float) -> Scene:
    """Press the gel on the cube, turned."""
    cube = box_mesh(SIDE, round(SIDE / cell))
    gel = gel_mesh(GEL, cell, max(3, round(2.5 / cell)))
    first = looking_down(SIDE)
    above = gel.mesh.points @ first[:3, :3].T + first[:3, 3]
    both, number = glued(cube, gel.mesh, above, gel.face)
    youngs = np.full(both.n_tets, SOFT_MPA)
    youngs[cube.n_tets :] = float(GEL.youngs_mpa)
    center = turn @ (BALL_MM - MIDDLE) + MIDDLE
    inside = np.linalg.norm(cube.centroids - center, axis=1) < 2.0
    youngs[: cube.n_tets][inside] = BALL_MPA
    fixed, prescribed = np.zeros(both.points.shape, dtype=bool), np.zeros(both.points.shape)
    fixed[both.points[:, 2] < 1e-9] = True
    window = number[gel.window]
    fixed[window], prescribed[window] = True, (0.0, 0.0, -DEPTH)
    body = SoftBody(both, make_material("neo_hookean", POISSON))
    nothing = np.zeros(both.points.shape)
    found = body.equilibrate(youngs, nothing, Supports(fixed, prescribed)).require()
    u = found.displacement
    # What the window does to the gel, the cube does the other way round.
    force = -body.assembly.internal_force(found.response, youngs)[window].sum(axis=0)
    force = force @ first[:3, :3]
    moved = (u[number[gel.face]] + (0.0, 0.0, DEPTH)) @ first[:3, :3]
    n = round(SIDE / cell) + 1
    return Scene(gel.face_points, moved, force, u[: cube.n_points].reshape(n, n, n, 3))


def glued(
    cube: TetMesh, gel: TetMesh, above: np.ndarray, face: np.ndarray
) -> tuple[TetMesh, np.ndarray]:
    """Make one mesh that shares the nodes where the gel's face meets the cube's top."""
    top = np.flatnonzero(cube.points[:, 2] > SIDE - 1e-6)
    twin = {tuple(np.round(cube.points[i], 5)): i for i in top}
    number = np.full(len(above), -1)
    for i in face:
        number[i] = twin.get(tuple(np.round(above[i], 5)), -1)
    own = number < 0
    if own.all():
        raise SystemExit("gel and cube share no node; give a --cell that divides 1 mm.")
    number[own] = cube.n_points + np.arange(int(own.sum()))
    points = np.concatenate([cube.points, above[own]])
    return TetMesh.create(points, np.concatenate([cube.tets, number[gel.tets]])), number


def looking_down(z_mm: float) -> np.ndarray:
    """Pose of a sensor over the cube's middle: x along y, y along x, z down."""
    pose = np.eye(4)
    pose[:3, :3] = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
    pose[:3, 3] = (SIDE / 2, SIDE / 2, z_mm)
    return pose


def still(seed: int) -> Image:
    """Draw the gel without contact."""
    flat = Face(np.zeros(SENSOR.shape), SENSOR.to_px(SENSOR.markers.places_mm))
    return render(SENSOR, flat, seed=seed)


def calibrated(count: int = 14, held_out: int = 3) -> tuple[Calibration, Quality]:
    """Calibrate with drawn presses of a ball, their circles found; judge on some held out."""
    rng, reference = np.random.default_rng(3), still(1000)
    ball = Ball(3.0, (0.05, 0.05))
    touches = []
    for i in range(count):
        image = ball_image(rng.uniform(70, 250, 2), float(rng.uniform(32, 44)), i)
        changed = change(image, reference, LOOK)
        known = ~hidden(image, reference, LOOK)
        touches.append(Touch(f"ball {i}", changed, known, find_circle(changed, ball)))
    found, _ = fit_map(touches[:-held_out], ball, FitOptions(rounds=3))
    new = touches[-held_out:]
    circles = [fit_circle(touch, found, ball, touch.circle) for touch in new]
    return Calibration(found, reference, ball.mm_per_px, LOOK), judge(found, new, circles, ball)


def ball_image(center: np.ndarray, contact_px: float, seed: int) -> Image:
    """Draw a press of the ball; beyond its contact the gel rises back."""
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - center[0], rows - center[1]) * 0.05
    edge = contact_px * 0.05
    rim = 0.35 * edge / np.sqrt(9.0 - edge**2)
    inner = np.sqrt(9.0 - edge**2) - np.sqrt(np.maximum(9.0 - away**2, 0.0)) - rim
    height = np.where(away < edge, inner, -rim * np.exp(-(away - edge) / 0.35))
    return render(SENSOR, Face(height, SENSOR.to_px(SENSOR.markers.places_mm)), seed=seed)


def seen(
    name: str, turn: np.ndarray, scene: Scene, calibration: Calibration, seed: int
) -> tuple[Press, dict[str, float]]:
    """Go from the image of a press to a press on the cube; tell what each stage got wrong."""
    face = face_of(SENSOR, scene.points, scene.moved)
    image = render(SENSOR, face, seed=seed)
    model = GelModel(GEL, 1.0, 4, "tet4")
    chain = SensorChain(SENSOR, calibration, calibration.reference, model)
    found = chain.see(Frame(0, name, image, 0.0))
    assert found.contact is not None
    assert found.height is not None
    mesh = inversion_mesh()
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, MIDDLE - turn.T @ MIDDLE
    down = (mesh.points - MIDDLE) @ turn.T
    held = np.repeat(np.isclose(down[:, 2], -SIDE / 2)[:, None], 3, axis=1)
    press = press_of(
        found.contact, back @ looking_down(SIDE - DEPTH), back @ looking_down(SIDE), mesh,
        found.touched, fixed=held, noise_mm=0.01, name=name,
    )  # fmt: skip
    truth = cube_moved(scene, turn, mesh.points)
    on = press.observed.all(axis=1)
    at = chain.tracker.begin
    _, told_mm = displacement_mm(SENSOR, at, found.markers_px)
    true_mm = _between(scene.points, scene.moved, SENSOR.to_mm(at))
    gel_true = _between(scene.points, scene.moved, model.points[:, :2])
    slope_true = np.stack(np.gradient(face.height_mm, 0.05)[::-1], axis=-1)
    free = found.height.free_mm - face.height_mm
    return press, {
        "slope_rms": _rms(calibration.slopes(image) - slope_true),
        "depth_rms_mm": _rms(free - free.mean()),
        "marker_rms_mm": _rms((told_mm - true_mm)[:, :2]),
        "gel_rms_mm": _rms(found.contact.displacement - gel_true),
        "gel_size_mm": _rms(gel_true),
        "force_n": float(found.contact.total[2]),
        "true_force_n": float(scene.force[2]),
        "object_rms_mm": _rms((press.displacement - truth)[on]),
        "object_size_mm": _rms(truth[on]),
        "observed_nodes": int(on.sum()),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _between(points: np.ndarray, values: np.ndarray, places: np.ndarray) -> np.ndarray:
    return LinearNDInterpolator(points[:, :2], values)(places)


def cube_moved(scene: Scene, turn: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The simulation's displacement at points of the cube, as it lies."""
    axis = np.linspace(0.0, SIDE, len(scene.cube))
    turned = np.clip((points - MIDDLE) @ turn.T + MIDDLE, 0.0, SIDE)
    return RegularGridInterpolator((axis, axis, axis), scene.cube)(turned) @ turn


def inversion_mesh() -> TetMesh:
    """Another mesh than the simulation's."""
    return box_mesh(SIDE, 8)


def inverted(presses: list[Press]) -> dict[str, float]:
    """Invert, and tell where the ball is: the centre of what is stiffer than half way."""
    mesh = inversion_mesh()
    inside = np.linalg.norm(mesh.centroids - BALL_MM, axis=1) < 2.0
    truth = np.where(inside, BALL_MPA, SOFT_MPA)
    recording = Recording(mesh, tuple(presses), MaterialSpec("neo_hookean", POISSON), truth)
    found = invert(recording, Settings(), show_progress=False)
    soft = float(np.median(found.youngs))
    over = np.maximum(found.youngs - 0.5 * (soft + found.youngs.max()), 0.0) * mesh.volumes
    off = over @ mesh.centroids / over.sum() - BALL_MM
    figures = scores(mesh, found.youngs, truth)
    return {
        "off_mm": float(np.linalg.norm(off)),
        "off_x_mm": float(off[0]),
        "off_y_mm": float(off[1]),
        "off_z_mm": float(off[2]),
        "soft_mpa": soft,
        "hardest_mpa": float(found.youngs.max()),
        "pearson": float(figures["pearson"]),
        "ssim": float(figures["ssim"]),
        "chi2": float(found.history[-1]["chi2"]),
    }


def told(result: dict[str, Any]) -> list[str]:
    """The tables."""
    q, m = result["calibration"], result["map"]
    lines = [
        "| side | slopes, rms | depth | markers | gel | force | object |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in result["sides"]:
        lines.append(
            f"| {one['side']} | {one['slope_rms']:.4f} | {one['depth_rms_mm']:.4f} mm |"
            f" {one['marker_rms_mm']:.4f} mm | {one['gel_rms_mm']:.4f} of"
            f" {one['gel_size_mm']:.3f} mm | {one['force_n']:.3f} of {one['true_force_n']:.3f} N |"
            f" {one['object_rms_mm']:.4f} of {one['object_size_mm']:.3f} mm |"
        )
    return [
        f"Calibration, held out: slopes R^2 {q['r2'][0]:.4f} / {q['r2'][1]:.4f}, mean error"
        f" {q['mae'][0]:.4f} / {q['mae'][1]:.4f}; the ball's depth {q['depth_rms_mm']:.4f} mm rms.",
        "",
        *lines,
        "",
        f"The ball is found {m['off_mm']:.2f} mm from where it is (x {m['off_x_mm']:+.2f}, y"
        f" {m['off_y_mm']:+.2f}, z {m['off_z_mm']:+.2f}); the map has {m['soft_mpa']:.3f} MPa"
        f" around it (true {SOFT_MPA}) and {m['hardest_mpa']:.2f} MPa at most (true {BALL_MPA}), r"
        f" {m['pearson']:.3f}, SSIM {m['ssim']:.3f}.",
    ]


def write(folder: Path, lines: list[str], result: dict[str, Any]) -> None:
    """Write table, figures and machine."""
    folder.mkdir(parents=True, exist_ok=True)
    machine = describe_machine(PACKAGES)
    (folder / "sensor_chain.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    content = json.dumps({**result, "machine": machine}, indent=1)
    (folder / "sensor_chain.json").write_text(content + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
