r"""`tactorch sensor force`: force on the gel in each frame: resultant and distribution.

    tactorch sensor force sensor=gelsight_markers calibration=calib.npz frames=press.avi \
      reference=still.png
    tactorch sensor force ... element=tet4                          fast: forces too high

The run folder gets forces.csv (of each frame, N, on the gel: z is out of the sensor, so a
press is negative) and .npz (of each node), summary.json and .txt, over_time.png,
force-NUMBER.png and force.mp4.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.console import log
from tactorch.cli.sensor.frames import RunFiles, caption, without_image, write_table
from tactorch.cli.sensor.inputs import build_chain
from tactorch.cli.sensor.options import ForceSettings
from tactorch.errors import ConvergenceError
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.frames import Frame
from tactorch.viz.sensor_frames import ForceView, colour_limit

_TABLE, _ARRAYS = "forces.csv", "forces.npz"
_HEADER = (
    "frame", "time_s", "force_x_n", "force_y_n", "force_z_n", "contact_mm2", "depth_mm", "fault",
)  # fmt: skip
_MIN_LIMIT_MPA = 1e-4  # of the color scale, for frames without contact

Vectors = Float[np.ndarray, "k 3"]


def run(cfg: ForceSettings) -> Path:
    """Compute forces; returns the path of the table."""
    files = RunFiles("force", _TABLE, _ARRAYS)
    frames, chain = build_chain(cfg)
    results = frames.process("finding forces", lambda frame: _frame_forces(chain, frame))
    measured, *arrays, depths = map(list, zip(*results, strict=True))
    forces, displacement, in_contact = map(np.stack, arrays)
    _write(files, chain, measured, forces, displacement, in_contact, depths)
    points, triangles = chain.model.points, chain.model.gel_mesh.face_triangles
    traction = forces / chain.model.gel_mesh.face_areas[:, None]
    components = (-traction[..., 2], np.linalg.norm(traction[..., :2], axis=-1))
    pressure, shear = (colour_limit(component, _MIN_LIMIT_MPA) for component in components)
    view = ForceView(chain.sensor, points, triangles, (pressure, shear))
    totals = forces.sum(axis=1)

    def show(frame: Frame) -> None:
        x, y, z = totals[frame.index]
        is_known = np.isfinite(z)
        text = f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} N" if is_known else "not known"
        text = caption(measured[frame.index], len(measured), text)
        view.show(frame.image, forces[frame.index] if is_known else None, text)

    series = {"force on the gel, N": {name: totals[:, k] for k, name in enumerate("xyz")}}
    files.draw(view.figure, frames, show, cfg, measured, series)
    log.info("forces: %s", files.folder / _TABLE)
    return files.folder / _TABLE


def _frame_forces(
    chain: SensorChain, frame: Frame
) -> tuple[Frame, Vectors, Vectors, Bool[np.ndarray, " k"], float]:
    """Frame, forces and displacements of the nodes (NaN if unknown), nodes in contact, and depth.

    A gel model that does not converge is a fault of the frame.
    """
    shape, stored, nan = chain.model.points.shape, without_image(frame), float("nan")
    none = np.zeros(shape[0], dtype=bool)
    try:
        measurement = chain.measure(frame)
    except ConvergenceError as error:
        unknown = np.full(shape, nan)
        return without_image(frame, f"no forces found: {error}"), unknown, unknown, none, nan
    contact, depth = measurement.contact, measurement.depth_mm
    if contact is None:
        free = np.full(shape, nan if frame.image is None else 0.0)
        return stored, free, free, none, depth
    return stored, contact.forces, contact.displacement, measurement.in_contact, depth


def _write(
    files: RunFiles,
    chain: SensorChain,
    frames: list[Frame],
    forces: Float[np.ndarray, "f k 3"],
    displacement: Float[np.ndarray, "f k 3"],
    in_contact: Bool[np.ndarray, "f k"],
    depths: list[float],
) -> None:
    points, triangles = chain.model.points, chain.model.gel_mesh.face_triangles
    totals = forces.sum(axis=1)
    known = np.isfinite(totals).all(axis=1)
    areas = np.where(known, in_contact @ chain.model.gel_mesh.face_areas, np.nan)
    columns = zip(frames, totals.tolist(), areas.tolist(), depths, strict=True)
    rows = [(f.index, f.time_s, *total, area, depth, f.fault) for f, total, area, depth in columns]
    write_table(files.folder / _TABLE, _HEADER, rows)
    files.write_frame_arrays(
        _ARRAYS,
        frames,
        points_mm=points,
        triangles=triangles,
        forces_n=forces,
        displacement_mm=displacement,
        touched=in_contact,
    )
    pressed = int(in_contact.any(axis=1).sum())
    largest = int(np.nanargmax(np.linalg.norm(totals, axis=1))) if known.any() else 0
    x, y, z = totals[largest].tolist()
    files.write_frame_summary(
        frames,
        {"in_contact": pressed, "largest": {"frame": largest, "force_on_gel_n": [x, y, z]}},
        f"{pressed} of {len(frames)} frames are in contact. The largest force on the gel is in"
        f" frame {largest}: x {x:+.3f}, y {y:+.3f}, z {z:+.3f} N.",
    )
