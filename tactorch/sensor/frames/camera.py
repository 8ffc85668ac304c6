"""Frames of a camera, taken by a thread: work on one makes the next neither late nor stale."""

import time
from collections.abc import Iterator
from contextlib import suppress
from queue import Full, Queue
from threading import Event, Thread
from typing import Any

from tactorch.errors import FileError
from tactorch.sensor.frames.raw import RawFrame

_MOST_WAITING = 600  # frames, of which later ones are dropped; their times tell
_GONE_S = 3.0  # without an image, from which on the camera counts as gone
_PAUSE_S = 0.05  # after an image that did not come
_LOOK_S = 0.2  # between looks whether to stop


def camera_frames(number: int) -> Iterator[RawFrame]:
    """Yield frames as a camera gives them, with the times at which they came.

    Args:
        number: Of the camera, from 0.

    Raises:
        FileError: The camera cannot be opened, or gives no image any more.
    """
    import cv2

    if number < 0:  # which OpenCV takes for any camera, and may crash on
        raise FileError(f"camera {number} is none; cameras are numbered from 0.")
    capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise FileError(
            f"camera {number} cannot be opened: it is not there, or another program has it."
        )
    return _taken(capture, number)


def _taken(capture: Any, number: int) -> Iterator[RawFrame]:
    waiting: Queue[RawFrame | None] = Queue(_MOST_WAITING)
    stop = Event()
    taker = Thread(target=_take, args=(capture, number, waiting, stop), daemon=True)
    taker.start()
    try:
        while (frame := waiting.get()) is not None:
            yield frame
    finally:
        stop.set()
        taker.join()
        capture.release()
    raise FileError(f"camera {number} gave no image for {_GONE_S:g} s; is it plugged in?")


def _take(capture: Any, number: int, waiting: Queue[RawFrame | None], stop: Event) -> None:
    """Put frames where they wait until told to stop, or the camera is gone: then None."""
    try:
        for frame in _frames(capture, number, stop):
            with suppress(Full):
                waiting.put_nowait(frame)
    finally:  # whatever happened: who waits must not wait for ever
        _end(waiting, stop)


def _end(waiting: Queue[RawFrame | None], stop: Event) -> None:
    while not stop.is_set():
        with suppress(Full):
            waiting.put(None, timeout=_LOOK_S)
            return


def _frames(capture: Any, number: int, stop: Event) -> Iterator[RawFrame]:
    import cv2

    # A clock that is set meanwhile moves no frame.
    start, start_unix, count, image_s = time.monotonic(), time.time(), 0, 0.0
    while not stop.is_set():
        there, image = capture.read()
        now = time.monotonic() - start
        name, unix_s = f"camera {number} frame {count}", start_unix + now
        if there:
            yield RawFrame(name, cv2.cvtColor(image, cv2.COLOR_BGR2RGB), now, unix_s=unix_s)
            image_s = now
        elif now - image_s >= _GONE_S:
            return
        else:
            yield RawFrame(name, None, now, "the camera gave no image", unix_s)
            time.sleep(_PAUSE_S)
        count += 1
