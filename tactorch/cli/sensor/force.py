r"""`tactorch sensor force`: force on the gel in each frame: resultant and distribution.

    tactorch sensor force sensor=gelsight_markers calibration=calib.npz frames=press.avi \
      reference=still.png
    tactorch sensor force ... element=tet4                          fast: forces too high

The run folder gets forces.csv (of each frame, N, on the gel: z is out of the sensor, so a
press is negative) and .npz (of each node), summary.json and .txt, over_time.png,
force-NUMBER.png and force.mp4.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tactorch.cli.progress import progress
from tactorch.cli.sensor import film
from tactorch.cli.sensor.inputs import calibrated, reference_of
from tactorch.cli.sensor.options import ForceSettings
from tactorch.cli.sensor.sequence import (
    FrameSequence,
    caption_of,
    faults_of,
    faults_told,
    rate_of,
    times_of,
    without_image,
)
from tactorch.cli.sensor.tables import write_arrays, write_table
from tactorch.cli.settings import log, run_folder
from tactorch.errors import ConvergenceError
from tactorch.sensor.chain import ChainOptions, Measurement, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.gel import GelModel
from tactorch.viz.sensor_frames import ForceView, colour_limit, node_areas
from tactorch.viz.session import plot_over_time

_STEM = "force"
_TABLE, _ARRAYS = "forces.csv", "forces.npz"
_HEADER = (
    "frame", "time_s", "force_x_n", "force_y_n", "force_z_n", "contact_mm2", "depth_mm", "fault",
)  # fmt: skip
_LEAST_MPA = 1e-4  # upper end of the colours where nothing is pressed


class Felt(NamedTuple):
    """What is told of a frame.

    Attributes:
        frame: Without its image.
        forces: On the gel at the nodes of its face, N; NaN where they are not known.
        displacement: Of these nodes, mm; NaN likewise, 0 without contact.
        touched: Nodes that are touched.
        depth_mm: Of the deepest point; NaN where there is no image.
    """

    frame: Frame
    forces: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    touched: np.ndarray
    depth_mm: float


def run(cfg: ForceSettings) -> Path:
    """Tell forces; returns the path of the table."""
    place = run_folder()
    film.clear(place, _STEM, (_TABLE, _ARRAYS))
    options = ChainOptions(cfg.noise_mm, cfg.around_mm, cfg.min_depth_mm, cfg.steep)
    sensor, calibration = calibrated(cfg)
    reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference)
    model = GelModel(sensor.gel, cfg.edge_mm, cfg.layers, cfg.element)
    chain = SensorChain(sensor, calibration, reference, model, options)
    found = []
    with progress("finding forces", "frames") as tell:
        for frame in frames:
            found.append(_felt(chain, frame))
            tell(len(found), frames.total)
    triangles = face_triangles(model)
    _write(place, model.points, triangles, found)
    _draw(place, cfg, chain, triangles, frames, found)
    log.info("forces: %s", place / _TABLE)
    return place / _TABLE


def face_triangles(model: GelModel) -> Int[np.ndarray, "t 3"]:
    """Return the triangles of the gel's outer face, by the numbers of its nodes there."""
    number = np.full(model.gel_mesh.mesh.n_points, -1)
    number[model.gel_mesh.face] = np.arange(len(model.gel_mesh.face))
    all_triangles = number[model.gel_mesh.mesh.surface.triangles]
    return all_triangles[(all_triangles >= 0).all(axis=1)]


def _felt(chain: SensorChain, frame: Frame) -> Felt:
    """Tell the forces of a frame; a gel that would collapse is a fault of the frame."""
    shape = chain.model.points.shape
    try:
        seen: Measurement | None = chain.measure(frame)
        fault = ""
    except ConvergenceError as error:
        seen, fault = None, f"no forces found: {error}"
    depth = float("nan")
    if seen is not None and seen.height is not None:
        depth = seen.height.depth_mm
    if seen is not None and seen.contact is not None:
        contact = seen.contact
        return Felt(
            without_image(frame), contact.forces, contact.displacement, seen.in_contact, depth
        )
    free = np.full(shape, 0.0 if seen is not None and seen.height is not None else np.nan)
    touched = np.zeros(shape[0], dtype=bool)
    return Felt(without_image(frame, fault), free, free, touched, depth)


def _write(
    place: Path,
    points: Float[np.ndarray, "k 3"],
    triangles: Int[np.ndarray, "t 3"],
    found: Sequence[Felt],
) -> None:
    area = node_areas(points, triangles)
    known = [one.frame for one in found]
    totals = np.stack([one.forces.sum(axis=0) for one in found])
    contacts = [
        float(area[one.touched].sum()) if np.isfinite(total).all() else float("nan")
        for one, total in zip(found, totals, strict=True)
    ]
    rows = [
        (one.frame.index, one.frame.time_s, *map(float, total), contact, one.depth_mm,
         one.frame.fault)
        for one, total, contact in zip(found, totals, contacts, strict=True)
    ]  # fmt: skip
    write_table(place / _TABLE, _HEADER, rows)
    write_arrays(
        place / _ARRAYS,
        points_mm=points,
        triangles=triangles,
        forces_n=np.stack([one.forces for one in found]),
        displacement_mm=np.stack([one.displacement for one in found]),
        touched=np.stack([one.touched for one in found]),
        time_s=times_of(known),
        fault=np.array([frame.fault for frame in known]),
    )
    pressed = [one for one in found if one.touched.any()]
    size = np.linalg.norm(totals, axis=1)
    told = np.isfinite(size)
    most = int(np.nanargmax(size)) if told.any() else 0
    values: dict[str, Any] = {
        "frames": len(found),
        "faulty": faults_of(known),
        "in_contact": len(pressed),
        "largest": {"frame": most, "force_on_gel_n": [float(v) for v in totals[most]]},
    }
    x, y, z = totals[most]
    lines = [
        f"{len(pressed)} of {len(found)} frames are in contact. The largest force on the gel is in"
        f" frame {most}: x {x:+.3f}, y {y:+.3f}, z {z:+.3f} N.",
        *faults_told(known),
    ]
    film.write_summary(place, values, lines)


def _draw(
    place: Path,
    cfg: ForceSettings,
    chain: SensorChain,
    triangles: Int[np.ndarray, "t 3"],
    frames: FrameSequence,
    found: Sequence[Felt],
) -> None:
    points = chain.model.points
    traction = np.stack([one.forces for one in found]) / node_areas(points, triangles)[:, None]
    tops = (-traction[..., 2], np.linalg.norm(traction[..., :2], axis=-1))
    pressure, shear = (colour_limit(top, _LEAST_MPA) for top in tops)
    view = ForceView(chain.sensor, points, triangles, (pressure, shear))
    totals = np.stack([one.forces.sum(axis=0) for one in found])

    def show(frame: Frame) -> None:
        one, (x, y, z) = found[frame.index], totals[frame.index]
        told = f"x {x:+.2f}, y {y:+.2f}, z {z:+.2f} N" if np.isfinite(z) else "not known"
        caption = caption_of(one.frame, len(found), told)
        view.show(frame.image, one.forces if np.isfinite(z) else None, caption)

    known = [one.frame for one in found]
    film.draw(place, _STEM, view, frames, show, cfg, known, rate_of(known))
    plot_over_time(
        {"force on the gel, N": {name: totals[:, k] for k, name in enumerate("xyz")}},
        times_of(known),
        [frame.index for frame in known if frame.fault],
        place / film.OVER_TIME,
    )
