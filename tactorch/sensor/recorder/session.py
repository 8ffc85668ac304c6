"""The frames of a session, sorted into contacts."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.chain import Deformed, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import displacement_mm


@dataclass(eq=False)
class Episode:
    """Frames in turn that show contact.

    Attributes:
        free_s: Time of the last frame before them without contact; None where there is none.
        times_s: Of each frame.
        depths_mm: How deep the gel is pressed in each.
        looks: How each shows the gel's face to have moved, without images.
    """

    free_s: float | None
    times_s: list[float] = field(default_factory=list)
    depths_mm: list[float] = field(default_factory=list)
    looks: list[Deformed] = field(default_factory=list)

    def add(self, look: Deformed, time_s: float) -> None:
        """Add a frame; its image and heights are let go, for sessions are long."""
        assert look.height is not None
        self.times_s.append(time_s)
        self.depths_mm.append(float(-look.height.height_mm.min()))
        self.looks.append(replace(look, frame=replace(look.frame, image=None), height=None))

    def chosen(self, steps: int) -> list[int]:
        """Return frames up to the deepest, evenly spaced in depth, at most `steps`."""
        deepest = int(np.argmax(self.depths_mm))
        loading = np.array(self.depths_mm[: deepest + 1])
        wanted = loading[-1] * np.arange(1, steps + 1) / steps
        nearest = np.abs(loading[None] - wanted[:, None]).argmin(axis=1)
        return sorted({int(i) for i in nearest})


@dataclass(eq=False)
class Session:
    """What the frames of a session show.

    Attributes:
        frames: How many there were.
        contacts: The contacts.
        faults: What was wrong with frames, by their names.
        deepest_mm: How deep the gel was pressed in any frame.
        noise_mm: Root mean square of how markers move along the face without contact; None where
            no frame is without.
    """

    frames: int = 0
    contacts: list[Episode] = field(default_factory=list)
    faults: dict[str, str] = field(default_factory=dict)
    deepest_mm: float = 0.0
    noise_mm: float | None = None


def watch(
    frames: Iterable[Frame],
    chain: SensorChain,
    *,
    least_frames: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> Session:
    """Follow the markers through a session and find its contacts.

    Frames that cannot be measured on are told, and neither end a contact nor count for one.

    Args:
        frames: In their order.
        chain: The calibrated sensor.
        least_frames: Contacts of fewer are passed over.
        progress: Called with the number of frames so far.

    Raises:
        ConfigError: A frame has no time, or another size than the reference.
    """
    found, squares, free_s = Session(), [], None
    now: Episode | None = None
    for frame in frames:
        found.frames += 1
        if frame.fault:
            found.faults[frame.name] = frame.fault
        if frame.image is not None and frame.sound:
            time_s, look = _time(frame), chain.deformed(frame)
            if look.height is not None:
                found.deepest_mm = max(found.deepest_mm, float(-look.height.height_mm.min()))
            if look.moved is None:
                squares.append(_squared(chain, look))
                now, free_s = None, time_s
            else:
                if now is None:
                    now = Episode(free_s)
                    found.contacts.append(now)
                now.add(look, time_s)
        progress(found.frames)
    found.contacts = [one for one in found.contacts if len(one.looks) >= least_frames]
    if squares:
        found.noise_mm = float(np.sqrt(np.nanmean(np.concatenate(squares))))
    return found


def _time(frame: Frame) -> float:
    if frame.time_s is None:
        raise ConfigError(
            f"frame '{frame.name}' has no time, by which it is paired with a pose: give"
            " frame_rate_hz in the sensor's description."
        )
    return frame.time_s


def _squared(chain: SensorChain, look: Deformed) -> Float[np.ndarray, " _"]:
    _, moved = displacement_mm(chain.sensor, chain.tracker.begin, look.markers_px)
    return (moved[:, :2] ** 2).ravel()
