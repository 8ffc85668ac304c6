r"""`tactorch sensor record`: frames and poses of a session into a recording, to invert.

    tactorch sensor record sensor=finger calibration=calib.npz frames=session.mp4 \
      poses=poses.csv reference=still.png object.size_mm=[20,20,15]
    tactorch sensor record ... object=mesh object.path=liver.vtu held_side=z-
    tactorch sensor record ... object=virtual_cube object.side_mm=12
    tactorch invert recording=outputs/sensor-record/RUN/recording.h5

From a camera, with poses that a robot appends to a table, and the map at the same time:

    tactorch sensor record ... frames=0 poses=poses.csv as_they_end=true out=session.h5
    tactorch live recording=session.h5

The run folder gets recording.h5, session.csv (each frame), summary.json and .txt,
over_time.png (depth, contacts, frames kept) and presses.png (the contacts, on the object).
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np

from tactorch.cli.progress import ProgressCallback, progress
from tactorch.cli.sensor import film
from tactorch.cli.sensor.growing import grow
from tactorch.cli.sensor.inputs import calibrated, reference_of
from tactorch.cli.sensor.options import RecordSettings
from tactorch.cli.sensor.sequence import FrameSequence
from tactorch.cli.sensor.tables import write_table
from tactorch.cli.settings import log, material_spec, run_folder
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.files import require_file
from tactorch.mesh import TetMesh
from tactorch.sensor.chain import ChainOptions, SensorChain
from tactorch.sensor.contact import ContactOptions
from tactorch.sensor.gel import GelModel
from tactorch.sensor.poses import Poses, read_poses
from tactorch.sensor.recorder import (
    Fixture,
    RecordOptions,
    SessionRecording,
    VirtualCube,
    record,
    record_streaming,
)
from tactorch.viz.session import plot_presses, plot_session

_TABLE, _PRESSES, _RECORDING = "session.csv", "presses.png", "recording.h5"
_STEM = "record"
_HEADER = ("frame", "time_s", "depth_mm", "contact", "kept", "fault")
_LABELS = {"frames": "following the gel", "presses": "finding forces"}


def run(cfg: RecordSettings) -> Path:
    """Record a session; returns the recording's path."""
    place = run_folder()
    film.clear(place, _STEM, (_TABLE, _PRESSES))
    out = place / _RECORDING if cfg.out is None else cfg.out
    target, options, material = object_of(cfg), options_of(cfg), material_spec(cfg.material)
    sensor, calibration = calibrated(cfg)
    reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference, once=cfg.as_they_end)
    model = GelModel(sensor.gel, cfg.edge_mm, cfg.layers, cfg.element)
    limits = ChainOptions(cfg.noise_mm, cfg.around_mm, cfg.min_depth_mm, cfg.steep)
    chain = SensorChain(sensor, calibration, reference, model, limits)
    facts = {"settings": to_mapping(cfg), "calibration": calibration.facts}
    poses = poses_of(cfg, frames)
    if cfg.as_they_end:
        return grow(
            record_streaming(
                frames, chain, poses, target, material, options, provenance=facts
            ), out,
        )  # fmt: skip
    if frames.is_camera:
        require_file(str(cfg.poses), "table of poses")  # to which the robot adds meanwhile
    else:
        poses()  # what is wrong with them is told at once
    with _Stages(frames) as tell:
        found = record(
            frames, chain, poses, target, material, options, provenance=facts, progress=tell
        )
    found.recording.save(out)
    _write(place, found)
    if cfg.plots:
        plot_session(found, place / film.OVER_TIME)
        plot_presses(found.recording, place / _PRESSES)
    log.info("recording: %s", out)
    return out


def poses_of(cfg: RecordSettings, frames: FrameSequence) -> Callable[[], Poses]:
    """Return what reads the poses, on the frames' clock.

    Raises:
        ConfigError: Their clock is unknown, or that of no camera.
    """
    if cfg.poses_clock == "unix" and not frames.is_camera:
        raise ConfigError(
            f"poses_clock=unix, but frames={cfg.frames} is no camera: when its frames were taken is"
            " known since the first one alone; count the poses' time_s from there, too."
        )

    def read() -> Poses:
        found = read_poses(str(cfg.poses), growing=cfg.as_they_end)
        return (
            found if cfg.poses_clock == "frames" else found.relative_to(frames.zero_unix_s or 0.0)
        )

    return read


class _Stages:
    """Progress of one stage after the other; a terminal shows one bar at a time."""

    def __init__(self, frames: FrameSequence) -> None:
        self._frames, self._stack = frames, ExitStack()
        self._stage, self._tell = "", cast(ProgressCallback | None, None)

    def __enter__(self) -> "_Stages":
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        if stage != self._stage or self._tell is None:
            self._stack.close()
            self._stage = stage
            self._tell = self._stack.enter_context(progress(_LABELS[stage], stage))
        self._tell(done, total or self._frames.total)


def object_of(cfg: RecordSettings) -> TetMesh | VirtualCube:
    """Return the mesh of the object at rest, or a virtual cube.

    Raises:
        ConfigError: A value cannot be used.
        FileError: The mesh cannot be read.
    """
    target = cfg.object
    return target if isinstance(target, VirtualCube) else target.mesh()


def options_of(cfg: RecordSettings) -> RecordOptions:
    """Return how frames become presses.

    Raises:
        ConfigError: A value cannot be used.
    """
    virtual = isinstance(cfg.object, VirtualCube)
    untouched = ("sensor" if virtual else "unseen") if cfg.untouched == "auto" else cfg.untouched
    fixture = Fixture(cfg.held_side, cfg.held_by, cfg.spring_n_per_mm)
    contact = ContactOptions(cfg.reach_mm, cast(Any, untouched))
    return RecordOptions(cfg.steps, cfg.min_frames, cfg.first_touch, None, fixture, contact)


def _write(place: Path, found: SessionRecording) -> None:
    kept = {row["frame"] for row in found.presses}
    rows = [
        (one.name, one.time_s, one.depth_mm, None if number is None else number + 1,
         int(one.name in kept), one.fault or found.skipped.get(one.name, ""))
        for one, number in zip(found.frames, found.contact_numbers(), strict=True)
    ]  # fmt: skip
    write_table(place / _TABLE, _HEADER, rows)
    forces = [float(np.linalg.norm(row["force_n"])) for row in found.presses]
    values: dict[str, Any] = {
        "frames": len(found.frames),
        "contacts": len(found.contacts),
        "presses": found.presses,
        "faulty": found.faults,
        "skipped": found.skipped,
        "noise_mm": found.recording.presses[0].noise_mm,
    }
    lines = [
        f"{len(found.presses)} presses of {len(found.contacts)} contacts in"
        f" {len(found.frames)} frames; forces up to {max(forces):.3g} N.",
        *(f"  {name}: {fault}" for name, fault in found.faults.items()),
        *(f"  {name} became no press: {why}" for name, why in found.skipped.items()),
        "",
        found.recording.summary(),
    ]
    film.write_summary(place, values, lines)
