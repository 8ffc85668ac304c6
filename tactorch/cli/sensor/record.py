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

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import numpy as np

from tactorch.cli.console import ProgressCallback, log, progress
from tactorch.cli.sensor.frames import OVER_TIME, FrameSequence, RunFiles
from tactorch.cli.sensor.inputs import build_chain, load_calibrated, load_reference
from tactorch.cli.sensor.options import RecordSettings
from tactorch.cli.settings import material_spec
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.files import require_file
from tactorch.recording import Recording, append_press, compact
from tactorch.sensor.contact import ContactOptions
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
_HEADER = ("frame", "time_s", "depth_mm", "contact", "kept", "fault")
_LABELS = {"frames": "following the gel", "presses": "finding forces"}


def run(cfg: RecordSettings) -> Path:
    """Record a session; returns the recording's path."""
    files = RunFiles.prepare("record", _TABLE, _PRESSES)
    out = files.folder / _RECORDING if cfg.out is None else cfg.out
    target = cfg.object if isinstance(cfg.object, VirtualCube) else cfg.object.mesh()
    options, material = _record_options(cfg), material_spec(cfg.material)
    sensor, calibration = load_calibrated(cfg)
    reference = load_reference(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference, once=cfg.as_they_end)
    chain = build_chain(cfg, sensor, calibration, reference)
    facts = {"settings": to_mapping(cfg), "calibration": calibration.facts}
    poses = _pose_reader(cfg, frames)
    if cfg.as_they_end:
        contacts = record_streaming(
            frames, chain, poses, target, material, options, provenance=facts
        )
        return _append_contacts(contacts, out)
    if frames.is_camera:
        require_file(str(cfg.poses), "table of poses")  # a robot still appends to it
    else:
        poses()  # errors of the table are reported at once
    with _Stages(frames) as report:
        session = record(
            frames, chain, poses, target, material, options, provenance=facts, progress=report
        )
    session.recording.save(out)
    _write(files, session)
    if cfg.plots:
        plot_session(session, files.folder / OVER_TIME)
        plot_presses(session.recording, files.folder / _PRESSES)
    log.info("recording: %s", out)
    return out


def _pose_reader(cfg: RecordSettings, frames: FrameSequence) -> Callable[[], Poses]:
    """Return a function that reads the poses on the frames' clock."""
    unix = cfg.poses_clock == "unix"
    if unix and not frames.is_camera:
        raise ConfigError(
            f"poses_clock=unix, but frames={cfg.frames} is no camera: the times of its frames are"
            " relative to the first; give time_s of the poses relative to it, too."
        )

    def read() -> Poses:
        poses = read_poses(str(cfg.poses), growing=cfg.as_they_end)
        return poses.relative_to(frames.zero_unix_s or 0.0) if unix else poses

    return read


class _Stages:
    """Progress of consecutive stages; a terminal shows one bar at a time."""

    def __init__(self, frames: FrameSequence) -> None:
        self._frames, self._stack = frames, ExitStack()
        self._stage, self._report = "", cast(ProgressCallback | None, None)

    def __enter__(self) -> "_Stages":
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        if stage != self._stage or self._report is None:
            self._stack.close()
            self._stage = stage
            self._report = self._stack.enter_context(progress(_LABELS[stage], stage))
        self._report(done, total or self._frames.total)


def _record_options(cfg: RecordSettings) -> RecordOptions:
    virtual = isinstance(cfg.object, VirtualCube)
    untouched = ("sensor" if virtual else "unseen") if cfg.untouched == "auto" else cfg.untouched
    fixture = Fixture(cfg.held_side, cfg.held_by, cfg.spring_n_per_mm)
    contact = ContactOptions(cfg.reach_mm, cast(Any, untouched))
    return RecordOptions(cfg.steps, cfg.min_frames, cfg.first_contact, None, fixture, contact)


def _append_contacts(contacts: Iterable[Recording], out: Path) -> Path:
    """Append the presses of contacts to a recording until the frames end, or Ctrl-C.

    Raises:
        ConfigError: The recording exists, or there is no press.
    """
    if out.exists():
        raise ConfigError(f"out={out} is there already; choose another, or move it away.")
    count = 0
    try:
        for contact in contacts:
            for index, press in enumerate(contact.presses):
                if count:
                    append_press(out, press)
                else:
                    contact.select([index]).save(out)
                count += 1
            strongest = max(float(np.linalg.norm(p.total_force)) for p in contact.presses)
            log.info(
                "%s: %d presses up to %.3g N; %d in '%s'",
                contact.presses[0].name.partition(",")[0], len(contact.presses), strongest, count,
                out,
            )  # fmt: skip
    except KeyboardInterrupt:
        log.info("ended by Ctrl-C")
    if not count:
        raise ConfigError(
            "no contact became presses; see the warnings, or look at the frames with tactorch"
            " sensor track."
        )
    compact(out)
    log.info("recording: %s", out)
    return out


def _write(files: RunFiles, session: SessionRecording) -> None:
    kept, summaries = {row["frame"] for row in session.presses}, session.frames
    rows = [
        (frame.name, frame.time_s, frame.depth_mm, None if number is None else number + 1,
         int(frame.name in kept), frame.fault or session.skipped.get(frame.name, ""))
        for frame, number in zip(summaries, session.contact_numbers(), strict=True)
    ]  # fmt: skip
    files.write_table(_TABLE, _HEADER, rows)
    strongest = max(float(np.linalg.norm(row["force_n"])) for row in session.presses)
    values: dict[str, Any] = {
        "frames": len(summaries),
        "contacts": len(session.contacts),
        "presses": session.presses,
        "faulty": session.faults,
        "skipped": session.skipped,
        "noise_mm": session.recording.presses[0].noise_mm,
    }
    lines = [
        f"{len(session.presses)} presses of {len(session.contacts)} contacts in"
        f" {len(summaries)} frames; forces up to {strongest:.3g} N.",
        *(f"  {name}: {fault}" for name, fault in session.faults.items()),
        *(f"  {name} became no press: {reason}" for name, reason in session.skipped.items()),
        "",
        session.recording.summary(),
    ]
    files.write_summary(values, lines)
