r"""`tactorch sensor force`: force on the gel in each frame: resultant and distribution.

    tactorch sensor force sensor=gelsight_markers calibration=calib.npz frames=press.avi \
      reference=still.png
    tactorch sensor force ... element=tet4                          fast: forces too high

The run folder gets forces.csv (of each frame, N, on the gel: z is out of the sensor, so a
press is negative) and .npz (of each node), summary.json and .txt, over_time.png,
force-NUMBER.png and force.mp4.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.console import log
from tactorch.cli.sensor.frames import (
    FrameSequence,
    RunFiles,
    caption,
    frame_times,
    without_image,
)
from tactorch.cli.sensor.inputs import build_chain, load_calibrated, load_reference
from tactorch.cli.sensor.options import ForceSettings
from tactorch.errors import ConvergenceError
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.frames import Frame
from tactorch.viz.sensor_frames import ForceView, colour_limit, node_areas

_TABLE, _ARRAYS = "forces.csv", "forces.npz"
_HEADER = (
    "frame", "time_s", "force_x_n", "force_y_n", "force_z_n", "contact_mm2", "depth_mm", "fault",
)  # fmt: skip
_MIN_LIMIT_MPA = 1e-4  # of the color scale, for frames without contact


class _FrameForces(NamedTuple):
    """Forces in a frame; NaN where unknown.

    Attributes:
        frame: Frame without its image.
        forces: Forces on the gel at the nodes of its face, N.
        displacement: Displacements of the nodes, mm; 0 without contact.
        in_contact: Nodes in contact.
        depth_mm: Depth of the deepest point.
    """

    frame: Frame
    forces: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    in_contact: Bool[np.ndarray, " k"]
    depth_mm: float

    @property
    def total(self) -> Float[np.ndarray, "3"]:
        return self.forces.sum(axis=0)


def run(cfg: ForceSettings) -> Path:
    """Compute forces; returns the path of the table."""
    files = RunFiles.prepare("force", _TABLE, _ARRAYS)
    sensor, calibration = load_calibrated(cfg)
    reference = load_reference(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference)
    chain = build_chain(cfg, sensor, calibration, reference)
    results = frames.process("finding forces", lambda frame: _frame_forces(chain, frame))
    _write(files, chain, results)
    _draw(files, cfg, chain, frames, results)
    log.info("forces: %s", files.folder / _TABLE)
    return files.folder / _TABLE


def _frame_forces(chain: SensorChain, frame: Frame) -> _FrameForces:
    """Compute the forces in a frame; a gel model that does not converge is a fault of the frame."""
    shape = chain.model.points.shape
    none = np.zeros(shape[0], dtype=bool)
    try:
        measurement = chain.measure(frame)
    except ConvergenceError as error:
        unknown = np.full(shape, np.nan)
        faulty = without_image(frame, f"no forces found: {error}")
        return _FrameForces(faulty, unknown, unknown, none, float("nan"))
    stored, contact, height = without_image(frame), measurement.contact, measurement.height
    depth = float("nan") if height is None else height.depth_mm
    if contact is None:
        free = np.full(shape, np.nan if height is None else 0.0)
        return _FrameForces(stored, free, free, none, depth)
    return _FrameForces(stored, contact.forces, contact.displacement, measurement.in_contact, depth)


def _write(files: RunFiles, chain: SensorChain, results: list[_FrameForces]) -> None:
    points, triangles = chain.model.points, chain.model.gel_mesh.face_triangles
    area = node_areas(points, triangles)
    frames = [result.frame for result in results]
    totals = np.stack([result.total for result in results])
    known = np.isfinite(totals).all(axis=1)
    contacts = [float(area[result.in_contact].sum()) for result in results]
    rows = [
        (result.frame.index, result.frame.time_s, *map(float, result.total),
         contact if valid else None, result.depth_mm, result.frame.fault)
        for result, contact, valid in zip(results, contacts, known, strict=True)
    ]  # fmt: skip
    files.write_table(_TABLE, _HEADER, rows)
    files.write_arrays(
        _ARRAYS,
        points_mm=points,
        triangles=triangles,
        forces_n=np.stack([result.forces for result in results]),
        displacement_mm=np.stack([result.displacement for result in results]),
        touched=np.stack([result.in_contact for result in results]),
        time_s=frame_times(frames),
        fault=np.array([frame.fault for frame in frames]),
    )
    pressed = sum(bool(result.in_contact.any()) for result in results)
    size = np.linalg.norm(totals, axis=1)
    largest = int(np.nanargmax(size)) if known.any() else 0
    x, y, z = (float(v) for v in totals[largest])
    files.write_frame_summary(
        frames,
        {"in_contact": pressed, "largest": {"frame": largest, "force_on_gel_n": [x, y, z]}},
        [
            f"{pressed} of {len(results)} frames are in contact. The largest force on the gel is in"
            f" frame {largest}: x {x:+.3f}, y {y:+.3f}, z {z:+.3f} N."
        ],
    )


def _draw(
    files: RunFiles,
    cfg: ForceSettings,
    chain: SensorChain,
    frames: FrameSequence,
    results: list[_FrameForces],
) -> None:
    points, triangles = chain.model.points, chain.model.gel_mesh.face_triangles
    traction = np.stack([result.forces for result in results])
    traction = traction / node_areas(points, triangles)[:, None]
    components = (-traction[..., 2], np.linalg.norm(traction[..., :2], axis=-1))
    pressure, shear = (colour_limit(component, _MIN_LIMIT_MPA) for component in components)
    view = ForceView(chain.sensor, points, triangles, (pressure, shear))
    totals = np.stack([result.total for result in results])

    def show(frame: Frame) -> None:
        result, (x, y, z) = results[frame.index], totals[frame.index]
        text = f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} N" if np.isfinite(z) else "not known"
        forces = result.forces if np.isfinite(z) else None
        view.show(frame.image, forces, caption(result.frame, len(results), text))

    series = {"force on the gel, N": {name: totals[:, k] for k, name in enumerate("xyz")}}
    measured = [result.frame for result in results]
    files.draw(view, frames, show, cfg, measured, series)
