"""Cameras, with one that is drawn in the place of OpenCV's."""

import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from tactorch.errors import FileError
from tactorch.sensor import frames as sources
from tactorch.sensor.frames import Frame, open_source

_PERIOD_S = 0.01


class Capture:
    """A camera that gives a grey image every hundredth of a second, brighter each time."""

    def __init__(self, images: int) -> None:
        self.left, self.given, self.released = images, 0, False
        self.asked_s: list[float] = []

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, np.ndarray | None]:
        time.sleep(_PERIOD_S)
        if self.given == self.left:
            return False, None
        self.given += 1
        self.asked_s.append(time.time())
        return True, np.full((4, 6, 3), self.given, np.uint8)

    def release(self) -> None:
        self.released = True


@pytest.fixture
def capture(monkeypatch: pytest.MonkeyPatch) -> Iterator[Capture]:
    found = Capture(8)
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: found)
    monkeypatch.setattr(sources, "_CAMERA_TIMEOUT_S", 0.2)
    monkeypatch.setattr(sources, "_CAMERA_RETRY_S", 0.05)
    return found


def test_slow_work_on_a_frame_neither_loses_nor_delays_the_others(capture: Capture) -> None:
    frames = []
    for frame in open_source(0):
        frames.append(frame)
        time.sleep(6 * _PERIOD_S if len(frames) < 3 else 0.0)
        if len(frames) == 8:
            break
    assert [int(frame.image[0, 0, 0]) for frame in frames] == list(range(1, 9))
    taken = [frame.unix_s for frame in frames]
    np.testing.assert_allclose(taken, capture.asked_s, atol=_PERIOD_S / 2)
    since = np.array([frame.time_s for frame in frames])
    np.testing.assert_allclose(np.array(taken) - taken[0], since - since[0], atol=1e-6)
    assert frames[0].name == "camera 0 frame 0"


def test_a_camera_that_is_left_is_let_go(capture: Capture) -> None:
    frames = open_source(0)
    next(frames)
    assert not capture.released
    del frames
    assert capture.released


def test_a_camera_that_is_unplugged_is_told(capture: Capture) -> None:
    seen: list[Frame] = []
    with pytest.raises(FileError, match=r"camera 0 gave no image for 0\.2 s"):
        seen.extend(open_source(0))
    assert [frame.fault for frame in seen[:9]] == [""] * 8 + ["the camera gave no image"]
    assert capture.released


def test_frames_that_nobody_takes_are_dropped(
    capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "_MAX_QUEUED_FRAMES", 2)
    frames = open_source(0)
    first = next(frames)
    time.sleep(7 * _PERIOD_S)
    rest = [next(frames) for _ in range(2)]
    assert [frame.name[-1] for frame in (first, *rest)] == ["0", "1", "2"]


def test_frames_that_wait_have_a_limit_of_memory(
    capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "_MAX_QUEUED_BYTES", 2 * 4 * 6 * 3)
    frames = open_source(0)
    next(frames)
    time.sleep(7 * _PERIOD_S)
    rest = [next(frames) for _ in range(3)]
    assert [frame.name[-1] for frame in rest] == ["1", "2", "3"]
    with pytest.raises(FileError, match="gave no image"):
        assert not [frame for frame in frames if frame.image is not None]
