"""A session that goes on: each contact becomes presses as soon as it has ended."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from tactorch.errors import ConfigError, FileError
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import Poses
from tactorch.sensor.frames import Frame
from tactorch.sensor.recorder.maker import PressBuilder, noise_of, region_of
from tactorch.sensor.recorder.options import RecordOptions
from tactorch.sensor.recorder.region import VirtualCube
from tactorch.sensor.recorder.session import ContactDetector, ContactInterval
from tactorch.versions import versions

_log = logging.getLogger(__name__)
_PAUSE_S = 0.1  # between looks for poses that are late


def contacts_as_they_end(
    frames: Iterable[Frame],
    chain: SensorChain,
    read_poses: Callable[[], Poses],
    target: TetMesh | VirtualCube,
    material: MaterialSpec,
    options: RecordOptions | None = None,
    *,
    provenance: dict[str, Any] | None = None,
    patience_seconds: float = 5.0,
) -> Iterator[Recording]:
    """Yield the presses of each contact, as a recording of its own, once a frame without follows.

    They are those that `record` makes of the whole session, but for the noise that frames show,
    which is that of the frames so far. A contact that cannot be used is told and passed over, and
    so are faulty frames.

    Args:
        frames: As they come, with times.
        chain: The calibrated sensor.
        read_poses: Returns T_object_sensor over the same clock, as far as it is known by now.
        target: The object at rest in the object's frame, mm; or a virtual cube, which is laid under
            the first contact.
        material: Of the object, but for Young's modulus.
        options: How frames become presses.
        provenance: What else to note beside what is noted anyway.
        patience_seconds: For poses that are late.

    Raises:
        ConfigError: A frame has no time, or another size than the reference.
        FileError: A camera gives no image any more.
    """
    options = options or RecordOptions()
    watch, count = ContactDetector(chain, options.min_frames, keep=False), 0
    facts = {"sensor": chain.sensor.name, "versions": versions(), **(provenance or {})}
    mesh = target if isinstance(target, TetMesh) else None
    for touch in _ended(frames, watch):
        count += 1
        try:
            poses = _poses(touch, read_poses, patience_seconds)
            if mesh is None:
                assert isinstance(target, VirtualCube)
                mesh = region_of(target, touch, poses, chain.model.points[:, :2])
            noise_mm = noise_of(watch.noise_mm, chain, options)
            maker = PressBuilder(
                chain, poses, mesh, options, isinstance(target, VirtualCube), noise_mm
            )
            made = [press for _, press in maker.presses(touch, count)]
        except (ConfigError, FileError) as error:
            _log.warning("Contact %d is passed over: %s", count, error)
            continue
        presses = tuple(press for press in made if isinstance(press, Press))
        if presses:
            yield Recording(mesh, presses, material, provenance=facts, check_units=False)


def _ended(frames: Iterable[Frame], watch: ContactDetector) -> Iterator[ContactInterval]:
    for frame in frames:
        if frame.fault:
            _log.warning("%s: %s", frame.name, frame.fault)
        touch = watch.see(frame)
        if touch is not None:
            yield touch
    last = watch.end()
    if last is not None:
        yield last


def _poses(touch: ContactInterval, read: Callable[[], Poses], patience_seconds: float) -> Poses:
    """The poses of a contact's frames, which may be late, or half written.

    Raises:
        ConfigError: They stay away.
        FileError: They cannot be read.
    """
    until = time.monotonic() + patience_seconds
    while True:
        try:
            poses = read()
            poses.at(touch.times_s)
            return poses
        except (ConfigError, FileError):
            if time.monotonic() >= until:
                raise
        time.sleep(_PAUSE_S)
