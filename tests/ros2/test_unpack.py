"""Images of a bag: encodings, times, poses; and wrong bags."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from tactorch.errors import FileError, TactorchError
from tactorch.ros2 import open_bag
from tactorch.ros2 import read_poses as poses_of_bag
from tactorch.ros2.images import COMPRESSED, IMAGE, Unpacked, unpack_frames
from tactorch.sensor.frames import open_source, read_image
from tactorch.sensor.poses import read_poses

from .bags import POSE, TOOL, TYPES, header, pose, write_bag

RNG = np.random.default_rng(0)
COLOURS = RNG.integers(0, 255, (8, 12, 3), dtype=np.uint8)  # red, green, blue


def image(time_s: float, data: np.ndarray, encoding: str = "rgb8", pad: int = 0) -> Any:
    rows = data.reshape(len(data), int(np.prod(data.shape[1:])))
    padded = np.pad(rows, ((0, 0), (0, pad)))
    return time_s, TYPES[IMAGE](
        header=header(time_s, "sensor"), height=data.shape[0], width=data.shape[1],
        encoding=encoding, is_bigendian=0, step=padded.shape[1], data=padded.ravel(),
    )  # fmt: skip


def compressed(time_s: float, content: bytes, name: str = "rgb8; jpeg compressed bgr8") -> Any:
    data = np.frombuffer(content, dtype=np.uint8)
    return time_s, TYPES[COMPRESSED](header=header(time_s, "sensor"), format=name, data=data)


def topics(images: list[Any] | None = None, kind: str = IMAGE) -> dict[str, tuple[str, list[Any]]]:
    """Images at 10 Hz from 0.5 s, of a sensor that moves along x by 10 mm/s from 0 to 2 s."""
    images = [image(0.5 + 0.1 * i, COLOURS) for i in range(5)] if images is None else images
    moves = [pose(0.1 * i, np.array([i, 2.0, 3.0])) for i in range(21)]
    return {"/image": (kind, images), "/pose": (POSE, moves)}


def unpack(bag: Path, out: Path, topic: str | None = None) -> Unpacked:
    with open_bag(bag) as opened:
        poses = poses_of_bag(opened, None, None, None, 0.25)
        return unpack_frames(opened, topic, poses, out)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_frames_have_times_and_poses(tmp_path: Path, storage: str) -> None:
    assert unpack(write_bag(tmp_path / "bag", topics(), storage), tmp_path / "s") == (5, 0, 0)
    frames = list(open_source(tmp_path / "s" / "frames"))
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(frames[3].image, COLOURS)
    poses = read_poses(tmp_path / "s" / "poses.csv")
    assert poses.time_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(
        poses.T_object_sensor[:, :3, 3], [(x, 2.0, 3.0) for x in (5, 6, 7, 8, 9)], atol=1e-5
    )
    np.testing.assert_allclose(poses.T_object_sensor[0, :3, :3], TOOL.as_matrix(), atol=1e-6)


def test_poses_are_at_the_times_of_frames(tmp_path: Path) -> None:
    images = [image(0.53, COLOURS), image(0.78, COLOURS)]
    unpack(write_bag(tmp_path / "bag", topics(images)), tmp_path / "s")
    poses = read_poses(tmp_path / "s" / "poses.csv")
    np.testing.assert_allclose(poses.T_object_sensor[:, 0, 3], [5.3, 7.8], atol=1e-4)


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("rgb8", COLOURS),
        ("bgr8", COLOURS[..., ::-1]),
        ("rgba8", np.dstack([COLOURS, COLOURS[..., :1]])),
        ("bgra8", np.dstack([COLOURS[..., ::-1], COLOURS[..., :1]])),
    ],
)
@pytest.mark.parametrize("pad", [0, 5])
def test_encodings_of_colours(tmp_path: Path, encoding: str, data: np.ndarray, pad: int) -> None:
    bag = write_bag(tmp_path / "bag", topics([image(0.5, data, encoding, pad)]))
    unpack(bag, tmp_path / "s")
    np.testing.assert_array_equal(read_image(tmp_path / "s" / "frames" / "000000.png"), COLOURS)


def test_grey_images_have_equal_channels(tmp_path: Path) -> None:
    grey = COLOURS[..., 0]
    bag = write_bag(tmp_path / "bag", topics([image(0.5, grey, "mono8")]))
    unpack(bag, tmp_path / "s")
    read = read_image(tmp_path / "s" / "frames" / "000000.png")
    np.testing.assert_array_equal(read, np.dstack([grey] * 3))


@pytest.mark.parametrize(
    ("encoding", "first"),
    [("bayer_rggb8", "RG"), ("bayer_bggr8", "BG"), ("bayer_gbrg8", "GB"), ("bayer_grbg8", "GR")],
)
def test_bayer_patterns(tmp_path: Path, encoding: str, first: str) -> None:
    """A red object stays red."""
    mosaic = np.zeros((8, 12), dtype=np.uint8)
    row, column = {"RG": (0, 0), "BG": (1, 1), "GB": (1, 0), "GR": (0, 1)}[first]
    mosaic[row::2, column::2] = 200
    bag = write_bag(tmp_path / "bag", topics([image(0.5, mosaic, encoding)]))
    unpack(bag, tmp_path / "s")
    inner = read_image(tmp_path / "s" / "frames" / "000000.png")[2:-2, 2:-2].reshape(-1, 3)
    assert (inner.mean(axis=0) > [150, -1, -1]).all()
    assert (inner.mean(axis=0)[1:] < 10).all()


def test_compressed_images_are_copied(tmp_path: Path) -> None:
    content = [cv2.imencode(suffix, COLOURS)[1].tobytes() for suffix in (".jpg", ".png")]
    images = [compressed(0.5 + 0.1 * i, c) for i, c in enumerate(content)]
    bag = write_bag(tmp_path / "bag", topics(images, COMPRESSED))
    unpack(bag, tmp_path / "s")
    written = [tmp_path / "s" / "frames" / name for name in ("000000.jpg", "000001.png")]
    assert [path.read_bytes() for path in written] == content


def test_frames_without_a_pose_and_repeated_ones_are_left_out(tmp_path: Path) -> None:
    images = [image(t, COLOURS) for t in (0.5, 0.6, 0.7, 2.5, 2.6)]
    images.append((0.61, image(0.6, COLOURS)[1]))  # sent again
    bag = write_bag(tmp_path / "bag", topics(images))
    assert unpack(bag, tmp_path / "s") == (3, 2, 1)


def short(messages: Any) -> Any:
    messages[1].data = messages[1].data[:-7]
    return messages


def late(images: list[Any]) -> list[Any]:
    images[3][1].header.stamp.nanosec -= 250_000_000
    return images


BAD: dict[str, tuple[Callable[[], dict[str, Any]], str]] = {
    "no images": (lambda: {"/pose": topics()["/pose"]}, "image_topic is needed.*has none"),
    "two topics": (lambda: {**topics(), "/b": topics()["/image"]}, "several: /b, /image"),
    "no poses": (lambda: {"/image": topics()["/image"]}, "pose_topic is needed"),
    "depth": (
        lambda: topics([image(0.5, COLOURS, "16UC1")]), "encoding '16UC1'; give one of bgr8",
    ),
    "incomplete": (lambda: topics([short(image(0.5, COLOURS))]), "is incomplete: 281 bytes"),
    "no pixels": (lambda: topics([image(0.5, COLOURS[:0])]), "12 x 0 px"),
    "other clock": (lambda: topics([image(100.0, COLOURS)]), "none of 1 images has a pose.*clock"),
    "times run back": (
        lambda: topics(late([image(0.5 + 0.1 * i, COLOURS) for i in range(5)])), "run back by 0.15",
    ),
    "unknown compression": (
        lambda: topics([compressed(0.5, b"\0" * 40, "16UC1; compressedDepth")], COMPRESSED),
        "format '16UC1; compressedDepth'",
    ),
    "gap of poses": (
        lambda: {**topics(), "/pose": (POSE, topics()["/pose"][1][::6])}, "has no message from",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_wrong_bags_are_refused(tmp_path: Path, fault: str) -> None:
    make, message = BAD[fault]
    bag = write_bag(tmp_path / "bag", make())
    with pytest.raises(TactorchError, match=message) as error:
        unpack(bag, tmp_path / "s")
    assert "bag" in str(error.value)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["000000.png,0.0"], "no time of 000001.png, and of 4 images in all"),
        ([f"00000{i}.png,{t}" for i, t in enumerate((0, 1, 3, 2, 4))], "must rise"),
        ([f"00000{i}.png,soon" for i in range(5)], "must be a number"),
    ],
)
def test_wrong_times_of_a_folder_are_refused(tmp_path: Path, rows: list[str], message: str) -> None:
    unpack(write_bag(tmp_path / "bag", topics()), tmp_path / "s")
    (tmp_path / "s" / "frames" / "times.csv").write_text("\n".join(["frame,time_s", *rows]) + "\n")
    with pytest.raises(FileError, match=message):
        open_source(tmp_path / "s" / "frames")
