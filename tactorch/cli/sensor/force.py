r"""`tactorch sensor force`: force on the gel in each frame: resultant and distribution.

    tactorch sensor force sensor=gelsight_markers calibration=calib.npz frames=press.avi \
      reference=still.png
    tactorch sensor force ... deformation=small                     fast: linear gel

The run folder gets forces.csv (of each frame, N, on the gel: z is out of the sensor, so a
press is negative) and .npz (of each node), summary.json and .txt, over_time.png,
force-NUMBER.png and force.mp4.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.console import log
from tactorch.cli.sensor.frames import RunFiles, caption, without_image
from tactorch.cli.sensor.inputs import build_chain
from tactorch.cli.sensor.options import ForceSettings
from tactorch.errors import ConvergenceError
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.frames import Frame
from tactorch.viz.sensor_frames import ForceView, colour_limit

_TABLE, _ARRAYS = "forces.csv", "forces.npz"
_MIN_LIMIT_MPA = 1e-4  # of the color scale, for frames without contact

_WITHOUT_MARKERS = (
    "The sensor has no markers: forces along x and y are unknown, and those along z are of a"
    " contact without friction."
)

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
    traction = np.nan_to_num(forces / chain.model.gel_mesh.face_areas[:, None])
    components = (-traction[..., 2], np.linalg.norm(traction[..., :2], axis=-1))
    pressure, shear = (colour_limit(component, _MIN_LIMIT_MPA) for component in components)
    view = ForceView(chain.sensor, points, triangles, (pressure, shear))
    totals = forces.sum(axis=1)

    def show(frame: Frame) -> None:
        is_known = bool(np.isfinite(totals[frame.index, 2]))
        text = f"{_in_words(totals[frame.index], 2)} N" if is_known else "not known"
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

    A frame whose forces cannot be those of a contact is faulty.
    """
    shape, nan = chain.model.points.shape, float("nan")
    none = np.zeros(shape[0], dtype=bool)
    try:
        measurement = chain.measure(frame)
    except ConvergenceError as error:
        unknown = np.full(shape, nan)
        return without_image(frame, f"no forces found: {error}"), unknown, unknown, none, nan
    contact, depth = measurement.contact, measurement.depth_mm
    stored = without_image(measurement.frame)
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
    known = np.isfinite(totals[:, 2])
    areas = np.where(known, in_contact @ chain.model.gel_mesh.face_areas, np.nan)
    components = {f"force_{axis}_n": totals[:, k] for k, axis in enumerate("xyz")}
    files.write_frame_table(_TABLE, frames, **components, contact_mm2=areas, depth_mm=depths)
    nodes = {"forces_n": forces, "displacement_mm": displacement, "touched": in_contact}
    files.write_frame_arrays(_ARRAYS, frames, points_mm=points, triangles=triangles, **nodes)
    pressed = int(in_contact.any(axis=1).sum())
    sizes = np.where(known, np.linalg.norm(np.nan_to_num(totals), axis=1), -1.0)
    largest = int(np.argmax(sizes))
    found = {"frame": largest, "image": frames[largest].name}
    values = {
        "in_contact": pressed,
        "tangential_known": chain.tracker is not None,
        "largest": {**found, "force_on_gel_n": totals[largest].tolist()},
    }
    lines = [
        f"{pressed} of {len(frames)} frames are in contact. The largest force on the gel is in"
        f" frame {largest} ({frames[largest].name}): {_in_words(totals[largest], 3)} N.",
    ]
    if chain.tracker is None:
        lines.append(_WITHOUT_MARKERS)
    files.write_frame_summary(frames, values, *lines)


def _in_words(force: Float[np.ndarray, "3"], digits: int) -> str:
    """Components of a force, N; those that are not known are said to be unknown."""
    parts = zip("xyz", force.tolist(), strict=True)
    return ", ".join(
        f"{axis} {value:+.{digits}f}" if np.isfinite(value) else f"{axis} unknown"
        for axis, value in parts
    )
