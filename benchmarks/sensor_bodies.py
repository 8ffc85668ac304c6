"""A small gel pressed on places of a large, curved body with an inclusion, without inverse crime.

    python benchmarks/sensor_bodies.py [--session NAME...] [--keep FOLDER] [--out FOLDER]

A gel of 20 x 15 mm is pressed on four places of a body of 60 mm, to two depths each; at the first
depth the contact ends within the gel. A ball of five times the modulus is below one side of the
places. Images are drawn as in `sensor_chain.py`. The further input is these, the poses, and the
descriptions of sensor and object, by the commands of tactorch:

    tactorch mesh               tetrahedra inside the surface
    tactorch sensor calibrate   from drawn presses of a ball
    tactorch sensor record      markers, depth, forces, presses on the mesh
    tactorch invert             inclusions

Presses are equilibria of gel and body (`tactorch.touch`) of quadratic elements. The mesh of the
body follows the inclusion and is refined under each place, with nodes on the surfaces themselves,
and the contact is that of the shape. The penalty of the contact, which changes markers by
0.2 um, is that of the inversion. The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from machine import OtherWork, write_results
from sensor_chain import (
    APART,
    MIN_SLOPE,
    PACKAGES,
    POISSON,
    SENSOR,
    calibrated,
    draw_calibration,
    found_table,
    inverted,
    photographed,
    save_image,
    still,
    tactorch,
    write_poses,
)
from sensor_truth import Ball
from true_meshes import make_truth_mesh

from tactorch.mesh import BodyFile, Cylinder, Ellipsoid, Hemisphere, Shape, Sphere
from tactorch.mesh.io import write_surface
from tactorch.mesh.surfaces import marching_cubes
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.sensor.description import GelLayer, MarkerGrid
from tactorch.sensor.render import build_surface
from tactorch.touch.options import TouchOptions
from tactorch.touch.scene import GelPress, TouchScene

Vector = tuple[float, float, float]
# Edge lengths of the body, mm: far away, under the gel, and at the ball; and their growth with the
# distance from both. With 0.95 mm under the gel, and 0.9 mm and 5 layers in it, markers of the
# hemisphere differ by 0.3 um; with 1.3, and 1.2 and 4, by 0.7 um.
COARSE, UNDER_GEL, AT_BALL, GROWTH = 4.5, 0.7, 1.4, 0.35
GEL_EDGE, GEL_LAYERS = 0.7, 6  # of the gel's cells, mm, and their number through it
SMALL = replace(
    SENSOR, name="small", image_size_px=(400, 300), raw_size_px=(480, 370),
    gel=GelLayer(4.0, 0.12, POISSON, size_mm=(20.0, 15.0)),
    markers=MarkerGrid(16, 12, (1.2, 1.2), 0.45), intrinsics_px=(620.0, 620.0, 239.0, 183.0),
    warp_corners_px=((42.0, 31.0), (437.0, 34.0), (434.0, 331.0), (39.0, 328.0)),
)  # fmt: skip


@dataclass(frozen=True)
class Place:
    """A place on a body: a point of its surface, mm, and the inward direction there."""

    point_mm: Vector
    inward: Vector

    def pose(self) -> np.ndarray:
        """Pose of the sensor with its origin there, its long side upright where it can be."""
        inward = np.array(self.inward) / np.linalg.norm(self.inward)
        up = np.array([0.0, 0.0, 1.0]) if abs(inward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        along = up - (up @ inward) * inward
        along /= np.linalg.norm(along)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([along, np.cross(inward, along), inward])
        pose[:3, 3] = self.point_mm
        return pose


@dataclass(frozen=True)
class BodySession:
    """Body, ball and places of a session.

    Attributes:
        body: The body; None for the one of `draw_irregular`.
        ball: Inclusion.
        directions: Of the places from `middle_mm`, outward.
        middle_mm: Point inside the body.
        youngs_mpa: Young's modulus around the ball, MPa.
        depths_mm: How far the window is moved from first touch.
        seed: Of the noise of the camera.
    """

    body: Shape | None
    ball: Ball
    directions: tuple[Vector, ...]
    middle_mm: Vector
    youngs_mpa: float = 0.06
    depths_mm: tuple[float, float] = (0.8, 1.6)
    seed: int = 10


def around(*degrees: tuple[float, float]) -> tuple[Vector, ...]:
    """Directions of given azimuth and elevation, degrees."""
    angles = np.deg2rad(degrees)
    flat = np.cos(angles[:, 1])
    rows = np.column_stack(
        [flat * np.cos(angles[:, 0]), flat * np.sin(angles[:, 0]), np.sin(angles[:, 1])]
    )
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


SESSIONS = {
    "cylinder": BodySession(
        Cylinder((0.0, 0.0, 25.0), 30.0, 50.0), Ball((19.9, 2.1, 27.0), 5.0, 0.3),
        around((-18.0, 12.0), (18.0, 12.0), (-18.0, -10.0), (18.0, -10.0)), (0.0, 0.0, 25.0),
    ),
    "hemisphere": BodySession(
        Hemisphere((0.0, 0.0, 0.0), 30.0), Ball((3.0, 2.0, 20.5), 5.0, 0.3),
        around((20.0, 72.0), (140.0, 72.0), (260.0, 72.0), (20.0, 50.0)), (0.0, 0.0, 0.0),
        seed=11,
    ),
    "irregular": BodySession(
        None, Ball((6.0, 5.0, 16.0), 5.0, 0.3),
        around((10.0, 75.0), (130.0, 70.0), (250.0, 70.0), (30.0, 50.0)), (6.0, 4.0, 0.0),
        seed=12,
    ),
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the sessions and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--session", nargs="+", default=["all"], choices=[*SESSIONS, "all"])
    parser.add_argument(
        "--keep", type=Path, help="folder for images and runs; images that it has are not drawn"
    )
    parser.add_argument("--out", type=Path, help="folder for sensor_bodies.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    names = list(SESSIONS) if "all" in options.session else options.session
    with TemporaryDirectory() as temporary:
        place = options.keep or Path(temporary)
        results = {name: run(SESSIONS[name], place / name) for name in names}
    off = [f"{name}: forces are off by {_worst(one):.1%} or less." for name, one in results.items()]
    lines = [*off, "", *found_table(results)]
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write_results(options.out, "sensor_bodies", lines, results, PACKAGES)
    print(json.dumps(results))


def run(session: BodySession, place: Path) -> dict[str, Any]:
    """Simulate a session, run the commands, and return the errors."""
    truth = place / "truth.json"
    if not truth.is_file():
        place.mkdir(parents=True, exist_ok=True)
        body = make_body(session, place)
        contacts = [
            press_body(session, body, at)
            for at in places_on(body, session.middle_mm, session.directions)
        ]
        draw_bodies(place, session, contacts)
        forces = [float(-press.gel_forces[:, 2].sum()) for one in contacts for press in one]
        truth.write_text(json.dumps({"forces_n": forces}))
    quality = calibrated(place)
    tactorch(
        "mesh", f"surface={place}/body.stl", "edge_length_mm=4", f"out={place}/body.vtu",
        f"run_dir={place}/mesh",
    )  # fmt: skip
    tactorch(
        "sensor", "record", f"sensor={place}/sensor.yaml", f"calibration={place}/calib.npz",
        f"frames={place}/frames", f"poses={place}/poses.csv", f"reference={place}/still.png",
        "object=mesh", f"object.path={place}/body.vtu", "held_side=z-",
        f"steps={len(session.depths_mm)}", f"min_slope={MIN_SLOPE}", f"out={place}/recording.h5",
        f"run_dir={place}/record",
    )  # fmt: skip
    presses, forces = Recording.load(place / "recording.h5").presses, json.loads(truth.read_text())
    if len(presses) != len(forces["forces_n"]):
        raise SystemExit(f"{len(presses)} presses were recorded, not {len(forces['forces_n'])}.")
    return {
        "calibration": quality,
        "forces_n": [float(press.total_force @ press.direction) for press in presses],
        "true_forces_n": forces["forces_n"],
        "map": inverted(place, session),
        "by_forces": inverted(place, session, gels=False),
    }  # fmt: skip


def _worst(result: dict[str, Any]) -> float:
    ratios = np.array(result["forces_n"]) / result["true_forces_n"]
    return float(np.abs(ratios - 1.0).max())


def make_body(session: BodySession, place: Path) -> Shape:
    """Write the surface of the body, and return its shape."""
    path = place / "body.stl"
    if session.body is not None:
        write_surface(path, *session.body.surface(160))
        return session.body
    write_surface(path, *irregular_surface())
    return BodyFile(str(path))


def irregular_surface() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (mm) and triangles of two ellipsoids that merge, on a flat base."""
    parts = (
        Ellipsoid((0.0, 0.0, 0.0), (31.0, 25.0, 22.0)),
        Ellipsoid((8.0, 5.0, 4.0), (21.0, 19.0, 21.0)),
    )

    def signed(points: np.ndarray) -> np.ndarray:
        distances = np.stack([part.signed_distance(points) for part in parts])
        smooth = -3.0 * np.log(np.exp(-distances / 3.0).sum(axis=0))
        return np.asarray(np.maximum(smooth, -points[:, 2]))

    box = np.array([(-33.0, -27.0, 0.0), (33.0, 27.0, 28.0)])
    return marching_cubes(signed, box, "irregular body")


def places_on(body: Shape, middle_mm: Vector, directions: Sequence[Vector]) -> list[Place]:
    """Return where rays from a point leave a body, with the normal there."""
    found = []
    for direction in np.array(directions):
        low, high = 0.0, 80.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            inside = body.contains((np.array(middle_mm) + middle * direction)[None])[0]
            low, high = (middle, high) if inside else (low, middle)
        point = np.array(middle_mm) + low * direction
        steps = np.concatenate([np.eye(3), -np.eye(3)])
        distances = body.signed_distance(point + steps)
        outward = distances[:3] - distances[3:]
        outward /= np.linalg.norm(outward)
        found.append(Place(tuple(point.tolist()), tuple((-outward).tolist())))
    return found


def press_body(session: BodySession, body: Shape, place: Place) -> list[GelPress]:
    """Press the gel on a place of a body that is held at its base, to each depth."""
    ball, pose = session.ball, place.pose()
    inclusion = Sphere(ball.center_mm, ball.radius_mm)
    phantom = Phantom(body, ((inclusion, ball.youngs_mpa),), session.youngs_mpa)
    inverse, half = np.linalg.inv(pose), np.array(SMALL.gel.half_size_mm)

    def sizing(at: np.ndarray) -> np.ndarray:
        local = at @ inverse[:3, :3].T + inverse[:3, 3]
        beside = np.maximum(np.abs(local[:, :2]) - half, 0.0)
        apart = np.sqrt((beside**2).sum(axis=1) + local[:, 2] ** 2)
        longest = np.minimum(UNDER_GEL + GROWTH * apart, COARSE)
        near = np.abs(inclusion.signed_distance(at))
        return np.asarray(1.75 * np.minimum(longest, AT_BALL + GROWTH * near))

    mesh = make_truth_mesh(phantom, COARSE, sizing).mesh
    options = TouchOptions(gel_edge_mm=GEL_EDGE, gel_layers=GEL_LAYERS, held=0.0)
    scene = TouchScene(phantom, mesh, MaterialSpec("neo_hookean", POISSON), SMALL, options)
    return scene.press(pose, [np.array([0.0, 0.0, depth]) for depth in session.depths_mm])


def draw_bodies(place: Path, session: BodySession, contacts: Sequence[Sequence[GelPress]]) -> None:
    """Write what a user has: description, presses of a ball, frames of the session, poses."""
    first = 10_000 * session.seed
    draw_calibration(place, first, SMALL)
    poses = list[np.ndarray]()
    for presses in contacts:
        for press in (None, None, *presses, None):
            number = len(poses)
            if press is None:
                image, pose = still(first + number, SMALL), presses[0].first_pose.copy()
                pose[:3, 3] -= APART * pose[:3, 2]
            else:
                face = build_surface(SMALL, press.gel_points, press.gel_displacement)
                image, pose = photographed(face, first + number, SMALL), press.pose
            save_image(image, place / "frames" / f"{number:03d}.png")
            poses.append(pose)
    write_poses(place, poses)


if __name__ == "__main__":
    main()
