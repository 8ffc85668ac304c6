"""Recordings from frames and poses: of a whole session, or contact by contact while it runs."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from tactorch.errors import ConfigError, FileError
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sensor.chain import Measurement, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.poses import Poses
from tactorch.sensor.recorder.detector import ContactDetector, ContactInterval
from tactorch.sensor.recorder.objects import VirtualCube
from tactorch.sensor.recorder.press_builder import PressBuilder, RecordOptions
from tactorch.versions import versions

_log = logging.getLogger(__name__)
_POSES_POLL_S = 0.1
ProgressCallback = Callable[[str, int, int | None], None]


def record(
    frames: Iterable[Frame],
    chain: SensorChain,
    poses: Poses | Callable[[], Poses],
    target: TetMesh | VirtualCube,
    material: MaterialSpec,
    options: RecordOptions | None = None,
    *,
    provenance: dict[str, Any] | None = None,
    progress: ProgressCallback = lambda stage, done, total: None,
) -> tuple[Recording, list[Measurement], list[ContactInterval]]:
    """Convert a session of frames and poses to a recording (Sections III-B and VI-B).

    Args:
        frames: Frames of the session, with times.
        chain: Calibrated sensor.
        poses: T_object_sensor on the frames' clock; or a function that returns it, called after
            the last frame.
        target: Object at rest in the object frame, mm; or a virtual cube for an unknown shape.
        material: Material of the object, without Young's modulus.
        options: Conversion options.
        provenance: Additional facts to store.
        progress: Callback with the stage ("frames", "presses"), the amount done, and the total
            (None if unknown).

    Returns:
        The recording with all presses, the depth of each frame (measurements without images,
        heights, markers and displacements), and the contacts. The provenance of the recording has
        "presses", a table of contact (from 1), frame, time_s, depth_mm, force_n (three components
        in the object frame) and nodes (number of observed nodes); "tangential_known", whether
        forces and displacements across the sensor's axis were measured (by markers), and are not
        taken as zero; "faulty frames", the faults by name; and "skipped", the reason by name for
        each frame with contact that became no press.

    Raises:
        ConfigError: No frame shows contact, a frame has no time or no pose, no contact yields a
            press, or the object has no such side to support.
        RecordingError: Presses, mesh and material are inconsistent.
    """
    options = options or RecordOptions()
    measurements = list[Measurement]()

    def report(measurement: Measurement) -> None:
        measurements.append(measurement)
        progress("frames", len(measurements), None)

    detector = ContactDetector(chain, options.min_frames, report)
    contacts = list[ContactInterval]()
    for contact in detector.detect(frames):
        contact.keep(contact.select_frames(options.steps))
        contacts.append(contact)
    faults = {m.frame.name: m.frame.fault for m in measurements if m.frame.fault}
    if not contacts:
        raise ConfigError(_no_contact(measurements, len(faults), chain))
    known_poses = poses if isinstance(poses, Poses) else poses()
    known_poses.at([time_s for contact in contacts for time_s in contact.times_s])
    builder = PressBuilder(chain, target, options)
    total = sum(len(contact.select_frames(options.steps)) for contact in contacts)
    presses, rows, skipped = list[Press](), [], {}
    for number, contact in enumerate(contacts, start=1):
        for measurement, result in builder.build(contact, number, known_poses, detector.noise_mm):
            name = measurement.frame.name
            if isinstance(result, Press):
                presses.append(result)
                row = {"contact": number, "frame": name, "time_s": measurement.frame.time_s}
                row |= {"depth_mm": measurement.depth_mm, "force_n": result.total_force.tolist()}
                rows.append(row | {"nodes": _observed_nodes(result)})
            else:
                skipped[name] = str(result)
            progress("presses", len(presses) + len(skipped), total)
    if not presses:
        name, reason = next(iter(skipped.items()))
        raise ConfigError(f"no frame with contact became a press; '{name}': {reason}")
    facts = {"sensor": chain.sensor.name, "frames": len(measurements), "presses": rows}
    facts["tangential_known"] = chain.tracker is not None
    facts |= {"faulty frames": faults, "skipped": skipped, "versions": versions()}
    assert builder.mesh is not None
    facts |= provenance or {}
    recording = Recording(builder.mesh, tuple(presses), material, provenance=facts)
    return recording, measurements, contacts


def record_streaming(
    frames: Iterable[Frame],
    chain: SensorChain,
    read_poses: Callable[[], Poses],
    target: TetMesh | VirtualCube,
    material: MaterialSpec,
    options: RecordOptions | None = None,
    *,
    provenance: dict[str, Any] | None = None,
    poses_timeout_s: float = 5.0,
) -> Iterator[Recording]:
    """Yield the presses of each contact as a recording as soon as the contact has ended.

    The presses equal those of `record`, except that the noise is estimated from the frames so far.
    Faulty frames and contacts that yield no press are logged and skipped. Arguments are those of
    `record`, except that `frames` come as they are captured, `read_poses` returns T_object_sensor
    on the same clock as far as known, and `poses_timeout_s` is the time to wait for late poses.

    Raises:
        ConfigError: A frame has no time, or another size than the reference.
        FileError: A camera stops giving images.
    """
    options = options or RecordOptions()
    detector = ContactDetector(chain, options.min_frames, _log_fault)
    builder = PressBuilder(chain, target, options)
    facts = {"sensor": chain.sensor.name, "tangential_known": chain.tracker is not None}
    facts |= {"versions": versions(), **(provenance or {})}
    for number, contact in enumerate(detector.detect(frames), start=1):
        try:
            poses = _wait_for_poses(contact, read_poses, poses_timeout_s)
            results = [r for _, r in builder.build(contact, number, poses, detector.noise_mm)]
        except (ConfigError, FileError) as error:
            _log.warning("Contact %d is skipped: %s", number, error)
            continue
        presses = tuple(press for press in results if isinstance(press, Press))
        if presses:
            assert builder.mesh is not None
            yield Recording(builder.mesh, presses, material, provenance=facts, check_units=False)


def _observed_nodes(press: Press) -> int:
    """Number of nodes whose displacement was measured, in all components or along an axis."""
    along_axis = 0 if press.surface is None else len(press.surface.points_mm)
    return int(press.observed.any(axis=1).sum()) + along_axis


def _log_fault(measurement: Measurement) -> None:
    if measurement.frame.fault:
        _log.warning("%s: %s", measurement.frame.name, measurement.frame.fault)


def _wait_for_poses(
    contact: ContactInterval, read_poses: Callable[[], Poses], timeout_s: float
) -> Poses:
    """Poses of a contact's frames, which may be late or incompletely written."""
    end = time.monotonic() + timeout_s
    while True:
        try:
            poses = read_poses()
            poses.at(contact.times_s)
            return poses
        except (ConfigError, FileError):
            if time.monotonic() >= end:
                raise
        time.sleep(_POSES_POLL_S)


def _no_contact(frames: list[Measurement], n_faulty: int, chain: SensorChain) -> str:
    faulty = f", {n_faulty} of them faulty," if n_faulty else ""
    depth = np.nanmax([0.0, *(frame.depth_mm for frame in frames)])
    slope = np.nanmax([0.0, *(frame.max_slope for frame in frames)])
    return (
        f"none of {len(frames)} frames{faulty} shows contact: the gel is pressed by"
        f" {depth:.3g} mm at most, contact counts from {chain.options.min_depth_mm:g} mm"
        f" (min_depth_mm); its slopes reach {slope:.3g}, it counts as deformed from"
        f" {chain.options.min_slope:g} (min_slope)."
        " Is the reference without contact, and is the calibration of this sensor?"
    )
