"""From camera images to a map of Young's modulus, without inverse crime (Section VI).

    python benchmarks/sensor_chain.py [--cell 0.5] [--element tet4] [--keep FOLDER] [--out FOLDER]

A cube of 10 mm with a stiff ball is pressed on three sides, to two depths each, by a gel of 16 mm
that is wider than it, both in one finite element simulation that shares the nodes where they touch
(contact without slip). The gel's face is rendered as its camera would see it. The further input is
images, poses and the descriptions of sensor and object only, by the commands of tactorch:

    tactorch sensor calibrate   from drawn presses of a ball
    tactorch sensor record      markers, depth, forces on a gel mesh twice as coarse, presses on a
                                cube mesh of another size
    tactorch invert

The error of each stage is relative to the simulation, whose linear elements are about 5 % too stiff
(10 % on cells of 1 mm); --element tet10 uses quadratic elements. The last line printed is one JSON
object.
"""

import argparse
import csv
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from machine import OtherWork, write_results
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator
from scipy.spatial.transform import Rotation

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.inverse import Reconstruction
from tactorch.mesh import TetMesh, box_mesh
from tactorch.metrics import scores
from tactorch.recording import Press, Recording
from tactorch.sensor.calibration import Calibration, load_calibration
from tactorch.sensor.chain import ChainOptions, SensorChain
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.sensor.frames import Image, read_frames
from tactorch.sensor.gel import GelMesh, GelModel
from tactorch.sensor.markers import marker_displacements
from tactorch.sensor.render import GelSurface, build_surface, render

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "opencv-python-headless", "pypardiso", "mkl")
SIDE, POISSON = 10.0, 0.45
DEPTHS = (0.5, 1.0)  # mm, to which the window is moved from first touch
# A wide, flat contact has small slopes; without contact they are below a third of this.
MIN_SLOPE = 0.03
APART = 0.4  # mm, of gel and cube before and after
BALL_MM, BALL_MPA, SOFT_MPA = (6.0, 4.4, 6.6), 1.0, 0.2
GEL = GelLayer(4.0, 0.12, POISSON, size_mm=(16.0, 16.0))
SENSOR = SensorDescription(
    "simulated", (320, 320), (0.05, 0.05), GEL, MarkerGrid(13, 13, (1.2, 1.2), 0.45),
    frame_rate_hz=10.0,
)  # fmt: skip
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
        depth: How far the window was moved from first touch, mm.
        points: Nodes of the gel's face at rest, in the sensor's frame.
        moved: Their displacement against the gel's window, in the sensor's frame.
        force: Of the cube on the gel, N, in the sensor's frame.
        cube: Displacement over the cube's grid, (n, n, n, 3).
    """

    depth: float
    points: np.ndarray
    moved: np.ndarray
    force: np.ndarray
    cube: np.ndarray


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chain and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cell", type=float, default=0.5, help="of the simulation, mm")
    parser.add_argument("--element", default="tet4", help="of the simulation; tet4 or tet10")
    parser.add_argument("--keep", type=Path, help="folder for images and runs")
    parser.add_argument("--out", type=Path, help="folder for sensor_chain.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    with TemporaryDirectory() as temporary:
        place = options.keep or Path(temporary)
        scenes = {
            name: simulated(turn, options.cell, element=options.element)
            for name, turn in SIDES.items()
        }
        draw_session(place, scenes)
        quality = calibrated(place)
        presses = recorded(place)
        chain = Stages(place)
        rows = [
            {"side": name, "depth_mm": scene.depth, **chain.errors(scene),
             **on_object(presses[(name, scene.depth)], scene, turn)}
            for name, turn in SIDES.items()
            for scene in scenes[name]
        ]  # fmt: skip
        located = inverted(place)
    result = {"calibration": quality, "presses": rows, "map": located}
    lines = format_tables(result)
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write_results(options.out, "sensor_chain", lines, result, PACKAGES)
    print(json.dumps(result))


def simulated(
    turn: np.ndarray, cell: float, depths: Sequence[float] = DEPTHS, element: str = "tet4"
) -> list[Scene]:
    """Press the gel on the cube, rotated."""
    cube = box_mesh(SIDE, round(SIDE / cell))
    gel = GelMesh(GEL, cell, max(3, round(2.5 / cell)))
    first = looking_down(SIDE)
    above = gel.mesh.points @ first[:3, :3].T + first[:3, 3]
    both, number = glued(cube, gel.mesh, above, gel.face)
    youngs = np.full(both.n_tets, SOFT_MPA)
    youngs[cube.n_tets :] = float(GEL.youngs_mpa)
    center = turn @ (BALL_MM - MIDDLE) + MIDDLE
    inside = np.linalg.norm(cube.centroids - center, axis=1) < 2.0
    youngs[: cube.n_tets][inside] = BALL_MPA
    window, n = number[gel.window], round(SIDE / cell) + 1
    fixed = np.zeros(both.points.shape, dtype=bool)
    fixed[both.points[:, 2] < 1e-9] = True
    fixed[window] = True
    body = SoftBody(both, make_material("neo_hookean", POISSON), element=element)
    places = body.discretisation.positions
    face = face_nodes(body, number[gel.face])
    points = (places[face] - first[:3, 3]) @ first[:3, :3]
    heights = places[:, 2]
    held_up = heights > heights.max() - 1e-6
    nothing, u, scenes = np.zeros(both.points.shape), None, []
    for depth in depths:
        prescribed = np.zeros(both.points.shape)
        prescribed[window] = (0.0, 0.0, -depth)
        held = Supports(fixed, prescribed)
        found = body.equilibrate(youngs, nothing, held, start=u).require()
        u = found.displacement
        # What the window does to the gel, the cube does the other way round.
        force = -body.assembly.internal_force(found.response, youngs)[held_up].sum(axis=0)
        moved = (u[face] + (0.0, 0.0, depth)) @ first[:3, :3]
        on_grid = u[: cube.n_points].reshape(n, n, n, 3)
        scenes.append(Scene(depth, points, moved, force @ first[:3, :3], on_grid))
    return scenes


def face_nodes(body: SoftBody, vertices: np.ndarray) -> np.ndarray:
    """Nodes on the gel's face, midside nodes included; one at each place."""
    if not body.discretisation.element.quadratic:
        return vertices
    on = np.zeros(body.n_nodes, dtype=bool)
    on[vertices] = True
    midsides = on[body.discretisation.edges].all(axis=1)
    on[len(on) - len(midsides) :] = midsides
    found = np.flatnonzero(on)
    places = np.round(body.discretisation.positions[found], 5)
    return found[np.sort(np.unique(places, axis=0, return_index=True)[1])]


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


def draw_session(place: Path, scenes: dict[str, list[Scene]]) -> None:
    """Write what a user has: description, presses of a ball, frames of the session, poses."""
    for name in ("balls", "frames"):
        (place / name).mkdir(parents=True, exist_ok=True)
    save_sensor(SENSOR, place / "sensor.yaml")
    save_image(still(1000), place / "still.png")
    rng = np.random.default_rng(3)
    for i in range(14):
        image = ball_image(rng.uniform(70, 250, 2), float(rng.uniform(32, 44)), i)
        save_image(image, place / "balls" / f"{i:02d}.png")
    rows: list[list[float]] = []
    for name, turn in SIDES.items():
        for scene in (None, None, *scenes[name], None):
            number = len(rows)
            image = still(number) if scene is None else drawn(scene, number)
            save_image(image, place / "frames" / f"{number:03d}.png")
            rows.append([number / 10.0, *pose_row(turn, -APART if scene is None else scene.depth)])
    with open(place / "poses.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"])
        table.writerows([f"{value:.9g}" for value in row] for row in rows)


def pose_row(turn: np.ndarray, depth: float) -> list[float]:
    """Place and quaternion of the sensor in the cube's frame."""
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, MIDDLE - turn.T @ MIDDLE
    pose = back @ looking_down(SIDE - depth)
    return [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)]


def save_image(image: Image, path: Path) -> None:
    """Write an RGB image."""
    cv2.imwrite(str(path), image[..., ::-1])


def drawn(scene: Scene, seed: int) -> Image:
    """Draw what the camera sees of a press."""
    return render(SENSOR, build_surface(SENSOR, scene.points, scene.moved), seed=seed)


def still(seed: int) -> Image:
    """Draw the gel without contact."""
    flat = GelSurface(np.zeros(SENSOR.shape), SENSOR.to_px(SENSOR.markers.positions_mm))
    return render(SENSOR, flat, seed=seed)


def tactorch(*arguments: str) -> None:
    """Run a command as a user does."""
    done = subprocess.run(
        [sys.executable, "-m", "tactorch", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"tactorch {' '.join(arguments)}:\n{done.stdout}\n{done.stderr}")


def calibrated(place: Path) -> dict[str, Any]:
    """Calibrate with the presses of the ball, three of them held out."""
    tactorch(
        "sensor", "calibrate", f"sensor={place}/sensor.yaml", f"images={place}/balls",
        f"reference={place}/still.png", "ball_radius_mm=3", "map=mlp", "rounds=3", "held_out=3",
        f"out={place}/calib.npz", f"run_dir={place}/calibrate",
    )  # fmt: skip
    quality = json.loads((place / "calibrate" / "quality.json").read_text())["quality"]
    assert isinstance(quality, dict)
    return quality


def recorded(place: Path) -> dict[tuple[str, float], Press]:
    """Record the session; presses by side and depth, in the order in which they were drawn."""
    tactorch(
        "sensor", "record", f"sensor={place}/sensor.yaml", f"calibration={place}/calib.npz",
        f"frames={place}/frames", f"poses={place}/poses.csv", f"reference={place}/still.png",
        f"object.size_mm=[{SIDE},{SIDE},{SIDE}]", "object.edge_mm=1.25",
        f"steps={len(DEPTHS)}", f"min_slope={MIN_SLOPE}", f"out={place}/recording.h5",
        f"run_dir={place}/record",
    )  # fmt: skip
    presses = Recording.load(place / "recording.h5").presses
    wanted = [(name, depth) for name in SIDES for depth in DEPTHS]
    if len(presses) != len(wanted):
        raise SystemExit(f"{len(presses)} presses were recorded, not {len(wanted)}.")
    return dict(zip(wanted, presses, strict=True))


def ball_image(center: np.ndarray, contact_px: float, seed: int) -> Image:
    """Draw a press of the ball; beyond its contact the gel rises back."""
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - center[0], rows - center[1]) * 0.05
    edge = contact_px * 0.05
    rim = 0.35 * edge / np.sqrt(9.0 - edge**2)
    inner = np.sqrt(9.0 - edge**2) - np.sqrt(np.maximum(9.0 - away**2, 0.0)) - rim
    height = np.where(away < edge, inner, -rim * np.exp(-(away - edge) / 0.35))
    return render(SENSOR, GelSurface(height, SENSOR.to_px(SENSOR.markers.positions_mm)), seed=seed)


class Stages:
    """Results and errors of each stage for a frame."""

    def __init__(self, place: Path) -> None:
        self.calibration: Calibration = load_calibration(place / "calib.npz")
        self.model = GelModel(GEL)
        reference = self.calibration.reference
        self.chain = SensorChain(
            SENSOR, self.calibration, reference, self.model, ChainOptions(min_slope=MIN_SLOPE)
        )
        self.frames = {
            (name, depth): frame
            for (name, depth), frame in zip(
                [(n, d) for n in SIDES for d in (None, None, *DEPTHS, 0.0)],
                read_frames(place / "frames", SENSOR, reference),
                strict=True,
            )
            if depth
        }
        self._left = list(self.frames.values())

    def errors(self, scene: Scene) -> dict[str, float]:
        """Take the next press and compare it with its simulation."""
        frame = self._left.pop(0)
        found = self.chain.measure(frame)
        assert frame.image is not None
        assert found.contact is not None
        assert found.height is not None
        face = build_surface(SENSOR, scene.points, scene.moved)
        at = self.chain.tracker.reference_px
        _, told_mm = marker_displacements(SENSOR, at, found.markers_px)
        true_mm = _between(scene.points, scene.moved, SENSOR.to_mm(at))
        gel_true = _between(scene.points, scene.moved, self.model.points[:, :2])
        slope_true = np.stack(np.gradient(face.height_mm, 0.05)[::-1], axis=-1)
        free = found.height.zero_mean_mm - face.height_mm
        return {
            "slope_rms": _rms(self.calibration.slopes(frame.image) - slope_true),
            "depth_rms_mm": _rms(free - free.mean()),
            "marker_rms_mm": _rms((told_mm - true_mm)[:, :2]),
            "gel_rms_mm": _rms(found.contact.displacement - gel_true),
            "gel_size_mm": _rms(gel_true),
            "force_n": float(found.contact.total[2]),
            "true_force_n": float(scene.force[2]),
        }


def on_object(press: Press, scene: Scene, turn: np.ndarray) -> dict[str, float]:
    """Return the errors of a recorded press on the cube, relative to the simulation."""
    truth = cube_moved(scene, turn, inversion_mesh().points)
    on = press.observed.all(axis=1)
    return {
        "press_force_n": float(press.total_force @ press.direction),
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
    rotate_vectors = np.clip((points - MIDDLE) @ turn.T + MIDDLE, 0.0, SIDE)
    return RegularGridInterpolator((axis, axis, axis), scene.cube)(rotate_vectors) @ turn


def inversion_mesh() -> TetMesh:
    """Another mesh than the simulation's: that of `object.edge_mm=1.25`."""
    return box_mesh(SIDE, 8, tets_per_cell=5)


def inverted(place: Path) -> dict[str, float]:
    """Invert and locate the ball: the weighted centre of the moduli above half of the contrast."""
    tactorch("invert", f"recording={place}/recording.h5", f"run_dir={place}/invert", "find=false")
    found = Reconstruction.load(place / "invert" / "reconstruction.h5")
    mesh = found.mesh
    inside = np.linalg.norm(mesh.centroids - BALL_MM, axis=1) < 2.0
    truth = np.where(inside, BALL_MPA, SOFT_MPA)
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


def format_tables(result: dict[str, Any]) -> list[str]:
    """Return the tables as Markdown."""
    q, m = result["calibration"], result["map"]
    lines = [
        "| side | pressed by | slopes, rms | depth | markers | gel | force | object |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in result["presses"]:
        lines.append(
            f"| {one['side']} | {one['depth_mm']:g} mm | {one['slope_rms']:.4f} |"
            f" {one['depth_rms_mm']:.4f} mm |"
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


if __name__ == "__main__":
    main()
