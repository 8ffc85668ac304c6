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
over_time.png (depth, contacts, selected frames) and presses.png (the contacts, on the object).
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from tactorch.cli.console import ProgressCallback, log, progress
from tactorch.cli.existing import check_file
from tactorch.cli.sensor.frames import OVER_TIME, RunFiles
from tactorch.cli.sensor.inputs import FrameSequence, build_chain
from tactorch.cli.sensor.options import RecordSettings
from tactorch.cli.settings import material_spec
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.files import require_file
from tactorch.recording import Recording, append_press, compact
from tactorch.sensor.chain import Measurement
from tactorch.sensor.poses import Poses, read_poses
from tactorch.sensor.recorder import ContactInterval, VirtualCube, record, record_streaming
from tactorch.viz import save_figure
from tactorch.viz.presses import presses_figure
from tactorch.viz.session import session_figure

_TABLE, _PRESSES, _RECORDING = "session.csv", "presses.png", "recording.h5"
_WITHOUT_MARKERS = (
    "The sensor has no markers: forces and displacements across its axis are unknown; the forces"
    " are those of a contact without friction."
)
_LABELS = {"frames": "following the gel", "presses": "finding forces"}


def run(cfg: RecordSettings) -> Path:
    """Record a session; returns the recording's path."""
    files = RunFiles("record", _TABLE, _PRESSES)
    out = files.folder / _RECORDING if cfg.out is None else cfg.out
    if cfg.out is None:
        check_file(out, cfg.overwrite)
    target = cfg.object if isinstance(cfg.object, VirtualCube) else cfg.object.mesh()
    material = material_spec(cfg.material)
    frames, chain = build_chain(cfg, once=True, endless=cfg.as_they_end)
    facts = {"settings": to_mapping(cfg), "calibration": chain.calibration.facts}
    poses = _pose_reader(cfg, frames)
    if cfg.as_they_end:
        out.unlink(missing_ok=True)  # with overwrite=true
        grown = record_streaming(frames, chain, poses, target, material, cfg, provenance=facts)
        return _append_contacts(grown, out)
    if frames.is_camera:
        require_file(str(cfg.poses), "table of poses")  # a robot still appends to it
    else:
        poses()  # errors of the table are reported at once
    with _stages(frames) as report:
        recording, measurements, contacts = record(
            frames, chain, poses, target, material, cfg, provenance=facts, progress=report
        )
    recording.save(out)
    _write(files, recording, measurements, contacts)
    if cfg.plots:
        figure = session_figure(recording, measurements, contacts)
        save_figure(figure, files.folder / OVER_TIME)
        save_figure(presses_figure(recording), files.folder / _PRESSES)
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


@contextmanager
def _stages(frames: FrameSequence) -> Iterator[Callable[[str, int, int | None], None]]:
    """Progress of consecutive stages; a terminal shows one bar at a time."""
    reports: dict[str, ProgressCallback] = {}
    with ExitStack() as stack:

        def report(stage: str, done: int, total: int | None) -> None:
            if stage not in reports:
                stack.close()
                reports[stage] = stack.enter_context(progress(_LABELS[stage], stage))
            reports[stage](done, total or frames.total)

        yield report


def _append_contacts(contacts: Iterable[Recording], out: Path) -> Path:
    """Append the presses of contacts to a recording until the frames end, or Ctrl-C."""
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


def _write(
    files: RunFiles,
    recording: Recording,
    measurements: list[Measurement],
    contacts: list[ContactInterval],
) -> None:
    facts = recording.provenance
    presses, faults, skipped = facts["presses"], facts["faulty frames"], facts["skipped"]
    selected = {row["frame"] for row in presses}
    numbers = {
        measurement.frame.index: number
        for number, contact in enumerate(contacts, start=1)
        for measurement in contact.measurements
    }
    frames = [
        replace(m.frame, fault=m.frame.fault or skipped.get(m.frame.name, "")) for m in measurements
    ]
    files.write_frame_table(
        _TABLE,
        frames,
        depth_mm=[m.depth_mm for m in measurements],
        contact=[numbers.get(frame.index) for frame in frames],
        selected=[int(frame.name in selected) for frame in frames],
    )
    strongest = max(float(np.linalg.norm(row["force_n"])) for row in presses)
    values = {
        "frames": len(measurements),
        "contacts": len(contacts),
        "presses": presses,
        "faulty": faults,
        "tangential_known": facts["tangential_known"],
    }
    values |= {"skipped": skipped, "noise_mm": recording.presses[0].noise_mm}
    lines = [
        f"{len(presses)} presses of {len(contacts)} contacts in {len(measurements)} frames; forces"
        f" up to {strongest:.3g} N.",
        *([] if facts["tangential_known"] else [_WITHOUT_MARKERS]),
        *(f"  {name}: {fault}" for name, fault in faults.items()),
        *(f"  {name} became no press: {reason}" for name, reason in skipped.items()),
        "",
        recording.summary(),
    ]
    files.write_summary(values, lines)
