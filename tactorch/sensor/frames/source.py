"""Where frames come from: folders of images, video files, cameras, and anything that yields arrays.

Images are RGB, 8 bits a channel. A frame that cannot be read is told as such, and the rest goes on.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError
from tactorch.files import require_file, require_folder
from tactorch.sensor.frames.camera import camera_frames
from tactorch.sensor.frames.raw import RawFrame
from tactorch.sensor.image import Image

#: A path of a folder, an image or a video, the number of a camera, or images themselves.
SourceLike = str | Path | int | Iterable[np.ndarray]
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
VIDEOS = (".avi", ".mp4", ".mov", ".mkv", ".webm", ".mpg", ".mpeg")


def frames_of(source: SourceLike) -> Iterator[RawFrame]:
    """Yield the frames of a source in their order.

    Args:
        source: See `SourceLike`. Files of a folder go by their names, numbers in them as numbers.

    Raises:
        FileError: There is nothing to read.
    """
    if isinstance(source, int):
        return camera_frames(source)
    if not isinstance(source, str | Path):
        return _given(source)
    path = Path(source)
    if path.suffix.lower() in VIDEOS:
        return _video(path)
    if path.suffix.lower() in IMAGES:
        return iter([RawFrame(path.name, read_image(path))])
    if path.is_file():
        raise FileError(
            f"'{path}' is no source of frames; give a folder, an image ({', '.join(IMAGES)}) or a"
            f" video ({', '.join(VIDEOS)})."
        )
    return _folder(path)


def read_image(path: str | Path) -> Image:
    """Read an image as RGB.

    Raises:
        FileError: The file is missing or no image.
    """
    import cv2

    require_file(path, "image")
    # Not cv2.imread, which writes its own complaints and cannot open every path.
    content = np.fromfile(path, np.uint8)
    image = cv2.imdecode(content, cv2.IMREAD_COLOR) if len(content) else None
    if image is None:
        raise FileError(
            f"image '{path}' cannot be read: it is damaged or no image; take or copy it again."
        )
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _folder(path: Path) -> Iterator[RawFrame]:
    found = require_folder(path, "folder of frames")
    files = sorted(
        (p for p in found.iterdir() if p.suffix.lower() in IMAGES and p.name[0] != "."),
        key=lambda p: [int(w) if w.isdigit() else w for w in re.split(r"(\d+)", p.name)],
    )
    if not files:
        raise FileError(f"folder of frames '{path}' has no image ({', '.join(IMAGES)}).")
    return map(_read, files)


def _read(path: Path) -> RawFrame:
    try:
        return RawFrame(path.name, read_image(path))
    except FileError as error:
        return RawFrame(path.name, None, fault=str(error))


def _video(path: Path) -> Iterator[RawFrame]:
    import cv2

    require_file(path, "video")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise FileError(f"video '{path}' cannot be opened: it is damaged, or of an unknown codec.")
    return _decoded(capture, path)


def _decoded(capture: Any, path: Path) -> Iterator[RawFrame]:
    import cv2

    rate = capture.get(cv2.CAP_PROP_FPS)
    told = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = 0
    try:
        while True:
            there, image = capture.read()
            if not there:
                break
            time_s = count / rate if rate > 0 else None
            yield RawFrame(
                f"{path.name} frame {count}", cv2.cvtColor(image, cv2.COLOR_BGR2RGB), time_s
            )
            count += 1
    finally:
        capture.release()
    if not count:
        raise FileError(f"video '{path}' has no frame that can be decoded.")
    for missing in range(count, told):
        fault = f"the video is cut short: {count} of {told} frames can be decoded"
        yield RawFrame(f"{path.name} frame {missing}", None, fault=fault)


def _given(images: Iterable[np.ndarray]) -> Iterator[RawFrame]:
    i = -1
    for i, image in enumerate(images):
        name = f"frame {i}"
        array = np.asarray(image)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
            fault = (
                f"an image must be (h, w, 3) of uint8, not {array.shape} of {array.dtype}; convert"
                " it to RGB of 8 bits"
            )
            yield RawFrame(name, None, fault=fault)
        else:
            yield RawFrame(name, array)
    if i < 0:
        raise FileError("no image was given as a frame; is the source empty?")
