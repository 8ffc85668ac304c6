"""Images of a bag with the poses of the sensor, as a folder that `tactorch sensor` reads."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tactorch.budget import MAX_PIXELS
from tactorch.errors import FileError
from tactorch.files import write_file
from tactorch.ros2.bag import Bag
from tactorch.ros2.tracks import PoseTrack
from tactorch.ros2.transforms import MAX_BACK_S

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# Channels of an encoding of 8 bits, and OpenCV's code of the conversion to blue, green, red.
_ENCODINGS: dict[str, tuple[int, str]] = {
    "bgr8": (3, ""), "8uc3": (3, ""), "rgb8": (3, "COLOR_RGB2BGR"), "bgra8": (4, "COLOR_BGRA2BGR"),
    "rgba8": (4, "COLOR_RGBA2BGR"), "mono8": (1, "COLOR_GRAY2BGR"), "8uc1": (1, "COLOR_GRAY2BGR"),
    # OpenCV names a Bayer pattern by its second row.
    "bayer_rggb8": (1, "COLOR_BayerBG2BGR"), "bayer_bggr8": (1, "COLOR_BayerRG2BGR"),
    "bayer_gbrg8": (1, "COLOR_BayerGR2BGR"), "bayer_grbg8": (1, "COLOR_BayerGB2BGR"),
}  # fmt: skip
_MAGIC = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"BM": ".bmp"}


class Unpacked(NamedTuple):
    """What was written.

    Attributes:
        frames: Number of frames with poses.
        without_pose: Frames before the first or after the last pose, which are left out.
        repeated: Frames of the time of the frame before, or earlier, which are left out.
    """

    frames: int
    without_pose: int
    repeated: int


def unpack_frames(
    bag: Bag,
    topic: str | None,
    poses: PoseTrack,
    folder: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Unpacked:
    """Write the images of a bag as files, their times, and the pose of each.

    The folder gets `frames/000000.png`, ... (.jpg where the bag has compressed images of that
    kind), `frames/times.csv` (frame, time_s) and `poses.csv` (time_s, x_mm, y_mm, z_mm, qw, qx, qy,
    qz). Times are since the first frame.

    A topic of None is the only one of images; `progress` receives the number of messages that are
    read, and their total.

    Raises:
        FileError: There is no such topic, or no image with a pose; an image has an unknown
            encoding or is incomplete; times run backwards.
    """
    topic = bag.choose(topic, (IMAGE, COMPRESSED), "image_topic")
    what, total = f"bag '{bag.path}': {topic}", bag.counts[topic]
    times: list[float] = []
    names: list[str] = []
    without_pose = repeated = 0
    last_s = -np.inf
    for count, (received, message) in enumerate(bag.messages(topic), start=1):
        progress(count, total)
        time_s = bag.seconds(message.header, received, topic)
        if time_s < last_s - MAX_BACK_S:
            raise FileError(
                f"{what}: times run back by {last_s - time_s:.3g} s after {last_s:.3f} s. Cut the "
                "bag there."
            )
        if time_s <= last_s:
            repeated += 1
            continue
        last_s = time_s
        if not poses.begin_s <= time_s <= poses.end_s:
            without_pose += 1
            continue
        content, suffix = encode(message, f"{what} at {time_s:.3f} s")
        names.append(f"{len(names):06d}{suffix}")
        write_file(folder / "frames" / names[-1], content)
        times.append(time_s)
    if not times:
        raise FileError(
            f"{what}: none of {total} images has a pose; poses are from {poses.begin_s:.3f} to "
            f"{poses.end_s:.3f} s, the last image at {last_s:.3f} s. Set their computers to one "
            "clock."
        )
    _write_tables(folder, names, np.array(times), poses)
    return Unpacked(len(times), without_pose, repeated)


def _write_tables(folder: Path, names: list[str], times: np.ndarray, poses: PoseTrack) -> None:
    at, since = poses.at(times), times - times[0]
    turns = Rotation.from_matrix(at[:, :3, :3]).as_quat(scalar_first=True)
    rows = [f"{name},{time:.6f}" for name, time in zip(names, since, strict=True)]
    write_file(folder / "frames" / "times.csv", "\n".join(["frame,time_s", *rows]) + "\n")
    table = np.column_stack([since, at[:, :3, 3], turns])
    lines = [",".join([f"{row[0]:.6f}", *(f"{v:.9g}" for v in row[1:])]) for row in table]
    header = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"
    write_file(folder / "poses.csv", "\n".join([header, *lines]) + "\n")


def encode(message: Any, what: str) -> tuple[bytes, str]:
    """Return an image message as the content of a file, and the suffix of its format.

    Raises:
        FileError: The encoding is not known, or the image is incomplete or too large.
    """
    data = np.asarray(message.data, dtype=np.uint8)
    if not hasattr(message, "encoding"):
        start = data[:4].tobytes()
        suffix = next((s for magic, s in _MAGIC.items() if start.startswith(magic)), None)
        if suffix is None:
            raise FileError(
                f"{what}: the compressed image has the format {message.format!r}; give JPEG, PNG "
                "or images without compression."
            )
        return data.tobytes(), suffix
    encoding = message.encoding.lower()
    if encoding not in _ENCODINGS:
        raise FileError(
            f"{what}: the image has the encoding {message.encoding!r}; give one of "
            f"{', '.join(_ENCODINGS)}."
        )
    channels, conversion = _ENCODINGS[encoding]
    height, width, step = message.height, message.width, message.step
    if not 0 < height * width <= MAX_PIXELS:
        raise FileError(f"{what}: the image is {width} x {height} px.")
    if step < width * channels or len(data) < height * step:
        raise FileError(
            f"{what}: the image is incomplete: {len(data)} bytes, rows of {step}, for {width} x "
            f"{height} px of {encoding}."
        )
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    image: Any = np.ascontiguousarray(rows.reshape(height, width, channels))
    if conversion:
        image = cv2.cvtColor(image, getattr(cv2, conversion))
    return cv2.imencode(".png", image)[1].tobytes(), ".png"
