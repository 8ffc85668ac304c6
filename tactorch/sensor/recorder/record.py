"""From frames and poses to a recording: contacts, first touch, forces, presses."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import Poses
from tactorch.sensor.frames import Frame
from tactorch.sensor.recorder.maker import PressBuilder, noise_of, region_of
from tactorch.sensor.recorder.options import RecordOptions
from tactorch.sensor.recorder.region import VirtualCube
from tactorch.sensor.recorder.session import ContactInterval, Session, watch
from tactorch.versions import versions

ProgressCallback = Callable[[str, int, int | None], None]


@dataclass(frozen=True, eq=False)
class Recorded:
    """What came of a session.

    Attributes:
        recording: Its presses.
        presses: Of each press: contact, frame, time_s, depth_mm, force_n (three components, in the
            object's frame) and nodes (how many were seen).
        session: What its frames show.
        passed_over: Why frames with contact became no press, by their names.
    """

    recording: Recording
    presses: list[dict[str, Any]]
    session: Session
    passed_over: dict[str, str]


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
) -> Recorded:
    """Turn a session of frames and poses into a recording (Sections III-B and VI-B).

    Args:
        frames: Of the session, with times.
        chain: The calibrated sensor.
        poses: T_object_sensor over the same clock; or what returns them once all frames are
            there.
        target: The object at rest in the object's frame, mm; or a virtual cube where its shape is
            not known.
        material: Of the object, but for Young's modulus.
        options: How frames become presses.
        provenance: What else to note beside what is noted anyway.
        progress: Called with a stage ("frames", "presses"), how much of it is done, and of how
            much (None where unknown).

    Raises:
        ConfigError: No frame shows contact, a frame has no time or no pose, no contact could be
            used, or the object is not held as told.
        RecordingError: Presses, mesh and material do not fit each other.
    """
    options = options or RecordOptions()
    session = watch(
        frames, chain, min_frames=options.min_frames,
        progress=lambda done: progress("frames", done, None),
    )  # fmt: skip
    _require_contact(session, chain)
    if not isinstance(poses, Poses):
        poses = poses()
    poses.at([time_s for touch in session.contacts for time_s in touch.times_s])  # all are known
    mesh = (
        target
        if isinstance(target, TetMesh)
        else region_of(target, session.contacts[0], poses, chain.model.points[:, :2])
    )
    virtual = not isinstance(target, TetMesh)
    maker = PressBuilder(
        chain, poses, mesh, options, virtual, noise_of(session.noise_mm, chain, options)
    )
    total = sum(len(touch.chosen(options.steps)) for touch in session.contacts)
    presses: list[Press] = []
    rows, passed_over = [], {}
    for number, touch in enumerate(session.contacts, start=1):
        for index, made in maker.presses(touch, number):
            if isinstance(made, Press):
                presses.append(made)
                rows.append(_row(number, touch, index, made))
            else:
                passed_over[touch.looks[index].frame.name] = str(made)
            progress("presses", len(presses) + len(passed_over), total)
    if not presses:
        first_name, reason = next(iter(passed_over.items()))
        raise ConfigError(f"no frame with contact became a press; '{first_name}': {reason}")
    facts = {"sensor": chain.sensor.name, "frames": len(session.glances), "presses": rows}
    facts |= {"faulty frames": session.faults, "passed over": passed_over, "versions": versions()}
    recording = Recording(
        mesh, tuple(presses), material, provenance={**facts, **(provenance or {})}
    )
    return Recorded(recording, rows, session, passed_over)


def _require_contact(session: Session, chain: SensorChain) -> None:
    if session.contacts:
        return
    faulty = f", {len(session.faults)} of them faulty," if session.faults else ""
    raise ConfigError(
        f"none of {len(session.glances)} frames{faulty} shows contact: the gel is pressed by"
        f" {session.deepest_mm:.3g} mm at most, contact counts from"
        f" {float(chain.options.min_depth_mm):g} mm (min_depth_mm); its slopes reach"
        f" {session.steepest:.3g}, it counts as deformed from"
        f" {float(chain.options.steep):g} (steep)."
        " Is the reference without contact, and is the calibration of this sensor?"
    )


def _row(contact: int, touch: ContactInterval, index: int, press: Press) -> dict[str, Any]:
    return {
        "contact": contact,
        "frame": touch.looks[index].frame.name,
        "time_s": touch.times_s[index],
        "depth_mm": touch.depths_mm[index],
        "force_n": press.total_force.tolist(),
        "nodes": int(press.observed.any(axis=1).sum()),
    }
