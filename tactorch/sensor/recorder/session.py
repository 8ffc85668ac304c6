"""The frames of a session, sorted into contacts."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.chain import Deformed, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import displacement_mm


@dataclass(eq=False)
class ContactInterval:
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

    def add(self, look: Deformed, time_s: float, depth_mm: float) -> None:
        """Add a frame; its image and heights are let go, for sessions are long."""
        self.times_s.append(time_s)
        self.depths_mm.append(depth_mm)
        self.looks.append(replace(look, frame=replace(look.frame, image=None), height=None))

    def chosen(self, steps: int) -> list[int]:
        """Return frames up to the deepest, evenly spaced in depth, at most `steps`."""
        deepest = int(np.argmax(self.depths_mm))
        loading = np.array(self.depths_mm[: deepest + 1])
        wanted = loading[-1] * np.arange(1, steps + 1) / steps
        nearest = np.abs(loading[None] - wanted[:, None]).argmin(axis=1)
        return sorted({int(i) for i in nearest})


class FrameSummary(NamedTuple):
    """What is kept of a frame.

    Attributes:
        name: Of the frame.
        time_s: Since the first frame; None where unknown.
        depth_mm: How deep the gel is pressed; NaN where that cannot be measured.
        steepest: Largest slope of its face; NaN likewise.
        contact: Number of the contact that it belongs to, from 0; None without.
        fault: What is wrong with it, or "".
    """

    name: str
    time_s: float | None
    depth_mm: float
    steepest: float
    contact: int | None
    fault: str


@dataclass(eq=False)
class Session:
    """What the frames of a session show.

    Attributes:
        glances: What is kept of each frame.
        contacts: The contacts.
        noise_mm: Root mean square of how markers move along the face without contact; None where
            no frame is without.
    """

    glances: list[FrameSummary] = field(default_factory=list)
    contacts: list[ContactInterval] = field(default_factory=list)
    noise_mm: float | None = None

    @property
    def faults(self) -> dict[str, str]:
        """What is wrong with frames, by their names."""
        return {one.name: one.fault for one in self.glances if one.fault}

    @property
    def deepest_mm(self) -> float:
        """How deep the gel was pressed in any frame."""
        return float(np.nanmax([0.0, *(one.depth_mm for one in self.glances)]))

    @property
    def steepest(self) -> float:
        """Largest slope of the gel's face in any frame."""
        return float(np.nanmax([0.0, *(one.steepest for one in self.glances)]))


def watch(
    frames: Iterable[Frame],
    chain: SensorChain,
    *,
    min_frames: int = 1,
    progress: Callable[[int], None] = lambda done: None,
) -> Session:
    """Follow the markers through a session and find its contacts.

    Frames that cannot be measured on are told, and neither end a contact nor count for one.

    Args:
        frames: In their order.
        chain: The calibrated sensor.
        min_frames: Contacts of fewer are passed over.
        progress: Called with the number of frames so far.

    Raises:
        ConfigError: A frame has no time, or another size than the reference.
    """
    seen = ContactDetector(chain, min_frames)
    for frame in frames:
        seen.see(frame)
        progress(len(seen.glances))
    return seen.session()


@dataclass(eq=False)
class ContactDetector:
    """Follows the markers frame by frame.

    Attributes:
        chain: The calibrated sensor.
        min_frames: Contacts of fewer are passed over.
        keep: Whether frames and contacts are kept for `session`; one without end keeps neither.
        glances: What is kept of each frame so far.
    """

    chain: SensorChain
    min_frames: int = 1
    keep: bool = True
    glances: list[FrameSummary] = field(default_factory=list)
    _episodes: list[ContactInterval] = field(default_factory=list)
    _squares: tuple[float, int] = (0.0, 0)  # sum of markers' movements squared, mm^2, and count
    _now: ContactInterval | None = None
    _free_s: float | None = None

    def see(self, frame: Frame) -> ContactInterval | None:
        """Take the next frame; returns the contact of enough frames that has ended with it.

        Raises:
            ConfigError: The frame has no time, or another size than the reference.
        """
        depth_mm, steepest, number, ended = float("nan"), float("nan"), None, None
        if frame.image is not None and frame.usable:
            time_s, look = _time(frame), self.chain.deformed(frame)
            if look.height is not None:
                depth_mm, steepest = -float(look.height.height_mm.min()), look.height.steepest
            if look.moved is None:
                self._add_noise(_squared(self.chain, look))
                ended, self._free_s = self.end(), time_s
            else:
                if self._now is None:
                    self._now = ContactInterval(self._free_s)
                    if self.keep:
                        self._episodes.append(self._now)
                number = len(self._episodes) - 1
                self._now.add(look, time_s, depth_mm)
        if self.keep:
            self.glances.append(
                FrameSummary(frame.name, frame.time_s, depth_mm, steepest, number, frame.fault)
            )
        return ended

    def end(self) -> ContactInterval | None:
        """End the contact that there is; returns it if it has frames enough."""
        now, self._now = self._now, None
        return None if now is None or len(now.looks) < self.min_frames else now

    def session(self) -> Session:
        """Return what the frames so far show."""
        found = Session(list(self.glances))
        _keep(found, self._episodes, self.min_frames)
        found.noise_mm = self.noise_mm
        return found

    @property
    def noise_mm(self) -> float | None:
        """As of `Session`, of the frames so far."""
        total, count = self._squares
        return float(np.sqrt(total / count)) if count else None

    def _add_noise(self, squares: Float[np.ndarray, " _"]) -> None:
        total, count = self._squares
        known = squares[np.isfinite(squares)]
        self._squares = total + float(known.sum()), count + len(known)


def _keep(found: Session, episodes: list[ContactInterval], min_frames: int) -> None:
    """Keep contacts of enough frames, and number them anew."""
    kept = [i for i, one in enumerate(episodes) if len(one.looks) >= min_frames]
    found.contacts = [episodes[i] for i in kept]
    new: dict[int | None, int] = {old: number for number, old in enumerate(kept)}
    found.glances = [one._replace(contact=new.get(one.contact)) for one in found.glances]


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
