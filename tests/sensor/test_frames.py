"""Frames of any source: in order, rectified, and with what is wrong with each."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactorch.errors import FileError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import detect_fault, read_frames, read_image, read_reference

MakeSensor = Callable[..., SensorDescription]


def written(folder: Path, images: dict[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, image in images.items():
        cv2.imwrite(str(folder / name), image[..., ::-1])
    return folder


def video(path: Path, images: list[np.ndarray], rate: float = 30.0) -> Path:
    height, width, _ = images[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (width, height))
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path


def brighter(image: np.ndarray, by: int) -> np.ndarray:
    return np.clip(image.astype(int) + by, 0, 255).astype(np.uint8)


def test_a_folder_goes_by_its_numbers(
    make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    images = {f"f{i}.png": brighter(gel_image, i) for i in (2, 10, 1)}
    folder = written(tmp_path / "frames", images)
    (folder / "notes.txt").write_text("no image")
    sensor = make_sensor(frame_rate_hz=10.0)
    found = list(read_frames(folder, sensor, gel_image))
    assert [one.name for one in found] == ["f1.png", "f2.png", "f10.png"]
    assert [one.time_s for one in found] == pytest.approx([0.0, 0.1, 0.2])
    assert [one.fault for one in found] == ["", "", ""]
    for one in found:
        np.testing.assert_array_equal(one.image, images[one.name])


def test_all_sources_give_the_same(
    make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    images = [brighter(gel_image, 3 * i) for i in range(5)]
    file = video(tmp_path / "v.avi", images)
    given = list(read_frames(images, make_sensor(), gel_image))
    seen = list(read_frames(file, make_sensor(), gel_image))
    assert len(given) == len(seen) == 5
    assert seen[3].time_s == pytest.approx(0.1)
    for one, other in zip(given, seen, strict=True):
        assert np.abs(one.image.astype(int) - other.image.astype(int)).mean() < 4  # JPEG


def test_images_are_rectified_once(make_sensor: MakeSensor, gel_image: np.ndarray) -> None:
    raw = np.zeros((100, 120, 3), np.uint8)
    raw[20:68, 30:94] = gel_image
    corners = [(30, 20), (93, 20), (93, 67), (30, 67)]
    warped = make_sensor(raw_size_px=(120, 100), warp_corners_px=corners)
    cropped = make_sensor(raw_size_px=(120, 100), crop_px=(30, 20, 64, 48))
    for sensor in (warped, cropped):
        one, again = read_frames([raw, gel_image], sensor, brighter(gel_image, 1))
        np.testing.assert_allclose(one.image, gel_image, atol=1)
        np.testing.assert_array_equal(again.image, gel_image)


def test_a_lens_is_undone(make_sensor: MakeSensor) -> None:
    """A barrel-distorted straight line comes out straight."""
    sensor = make_sensor(intrinsics_px=(60, 60, 31.5, 23.5), distortion=(-0.3, 0, 0, 0))
    fx, fy, cx, cy = sensor.intrinsics_px
    matrix = np.array([(fx, 0, cx), (0, fy, cy), (0, 0, 1.0)])
    y, x = np.mgrid[:48, :64].astype(np.float32)
    rays = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(rays, matrix, np.array([-0.3, 0, 0, 0.0]), P=matrix)
    column = straight[:, 0, 0].reshape(48, 64)
    raw = np.repeat((255 * np.exp(-((column - 10.0) ** 2) / 4))[..., None], 3, axis=2)
    (one,) = read_frames([raw.astype(np.uint8)], sensor, np.full((48, 64, 3), 9, np.uint8))
    light = one.image[4:-4, :, 0].astype(float)
    centre = (light * np.arange(64)).sum(axis=1) / light.sum(axis=1)
    assert np.ptp(centre) < 0.2
    bent = raw[4:-4, :, 0]
    assert np.ptp((bent * np.arange(64)).sum(axis=1) / bent.sum(axis=1)) > 0.6


def test_faults_are_told_and_the_rest_goes_on(
    make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    torn = gel_image.copy()
    torn[20:] = brighter(gel_image[20:], 60)
    flash = gel_image.copy()
    flash[:, :20] = 255
    folder = written(
        tmp_path / "frames",
        {
            "0.png": brighter(gel_image, 1),
            "1.png": brighter(gel_image, -90),
            "2.png": flash,
            "3.png": torn,
            "5.png": gel_image,
            "6.png": gel_image,
            "7.png": gel_image[:-8],
        },
    )
    (folder / "4.png").write_bytes(b"\x89PNG cut short")
    found = {one.name: one for one in read_frames(folder, make_sensor(), gel_image)}
    said = {name: one.fault for name, one in found.items()}
    assert said["0.png"] == said["5.png"] == ""
    assert "dark: 3" in said["1.png"]
    assert "saturated: 31%" in said["2.png"]
    assert "torn at row 20" in said["3.png"]
    assert "damaged or no image" in said["4.png"]
    assert "frozen" in said["6.png"]
    sound = [name for name, one in found.items() if one.usable]
    assert sound == ["0.png", "2.png", "5.png"]  # what saturates can be measured on, for the most
    assert "64 x 40 px, but the sensor 'small' gives 64 x 48" in said["7.png"]
    assert [name for name, one in found.items() if one.image is None] == ["4.png", "7.png"]


@pytest.mark.parametrize("row", [5, 20, 44])
def test_the_straight_edge_of_a_contact_is_no_tear(gel_image: np.ndarray, row: int) -> None:
    edge = gel_image.copy()
    edge[row : row + 3] = brighter(gel_image[row : row + 3], 60)
    assert detect_fault(edge, gel_image, None) == ""
    torn = edge.copy()
    torn[row:] = brighter(gel_image[row:], 60)
    assert detect_fault(torn, gel_image, None) == f"torn at row {row}"


def dent(row: float) -> np.ndarray:
    """Change of the colors where a ball presses, over a quarter of the width."""
    y, x = np.mgrid[:48, :64]
    ball = np.exp(-((x - 30) ** 2 + (y - row) ** 2) / 60)[..., None]
    return ball * (60, -50, 40)


@pytest.mark.parametrize(
    ("alter", "says"),
    [
        (lambda image: image[..., ::-1], "red and blue are swapped, compared with the reference"),
        (lambda image: np.repeat(image[..., :1], 3, axis=2), "no colors: all channels are equal"),
    ],
)
def test_frames_that_were_converted(
    gel_image: np.ndarray, alter: Callable[[np.ndarray], np.ndarray], says: str
) -> None:
    pressed = np.clip(gel_image + dent(20.0), 0, 255).astype(np.uint8)
    assert detect_fault(np.ascontiguousarray(alter(pressed)), gel_image, None).startswith(says)
    gray = np.ascontiguousarray(np.repeat(gel_image[..., :1], 3, axis=2))
    assert detect_fault(gray, gray, None) == ""


def test_markers_that_move_and_straight_edges_are_no_fault(gel_image: np.ndarray) -> None:
    grid = np.zeros(gel_image.shape[:2], dtype=bool)
    grid[6::16, 4:] = grid[7::16, 4:] = True
    grid[:, :] &= (np.arange(grid.shape[1]) % 16 < 4)[None]
    still = np.where(grid[..., None], 10, gel_image).astype(np.uint8)
    moved = np.where(np.roll(grid, 3, axis=0)[..., None], 10, gel_image).astype(np.uint8)
    assert detect_fault(moved, still, None) == ""
    rows = np.arange(gel_image.shape[0])[:, None, None]
    block = np.where(rows >= 20, 40.0 * np.exp(-(rows - 20) / 12), 0.0)  # of a part of the width
    pressed = gel_image + block * (np.arange(gel_image.shape[1]) < 20)[None, :, None]
    assert detect_fault(np.clip(pressed, 0, 255).astype(np.uint8), gel_image, None) == ""


def test_a_gray_sensor_may_have_colors_of_its_codec(gel_image: np.ndarray) -> None:
    gray = np.repeat(gel_image[..., :1], 3, axis=2)
    noisy = gray.copy()
    noisy[3, 5, 1] ^= 1
    assert (
        detect_fault(np.clip(gray + dent(9.0)[..., :1], 0, 255).astype(np.uint8), noisy, None) == ""
    )


def test_a_press_is_no_fault(gel_image: np.ndarray) -> None:
    pressed = np.clip(gel_image + dent(20.0), 0, 255).astype(np.uint8)
    assert detect_fault(pressed, gel_image, gel_image) == ""


def test_dropped_frames_are_counted(gel_image: np.ndarray, make_sensor: MakeSensor) -> None:
    from tactorch.sensor import frames as module

    assert module._dropped_frames(0.1, 0.0667, 30.0) == ""
    assert "2 frames were dropped" in module._dropped_frames(0.1667, 0.0667, 30.0)


def test_a_video_that_is_cut_short(
    make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    whole = video(tmp_path / "whole.avi", [brighter(gel_image, i) for i in range(30)])
    content = whole.read_bytes()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(content[: len(content) // 2])
    found = list(read_frames(cut, make_sensor(), gel_image))
    assert any(one.image is not None for one in found)
    assert any("cut short" in one.fault for one in found)


def test_a_reference_is_what_is_declared(
    make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    noisy = [
        np.clip(gel_image + rng.normal(0, 6, gel_image.shape), 0, 255).astype(np.uint8)
        for _ in range(16)
    ]
    one, mean = (read_reference(noisy, make_sensor(), count) for count in (1, 16))
    np.testing.assert_array_equal(one, noisy[0])
    assert (mean - gel_image.astype(float)).std() < 0.5 * (one - gel_image.astype(float)).std()
    folder = written(tmp_path / "one", {"r.png": gel_image})
    np.testing.assert_array_equal(read_reference(folder / "r.png", make_sensor()), gel_image)
    with pytest.raises(FileError, match=r"1 of 3 frames.*declare images of the gel without"):
        read_reference(folder, make_sensor(), 3)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nosuch", "folder of frames not found"),
        ("nosuch.avi", "video not found"),
        ("nosuch.png", "image not found"),
        ("text.avi", "cannot be opened"),
        ("empty", "has no image"),
    ],
)
def test_sources_that_are_not_there(
    name: str, message: str, make_sensor: MakeSensor, gel_image: np.ndarray, tmp_path: Path
) -> None:
    (tmp_path / "text.avi").write_text("no video")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match=message) as caught:
        read_frames(tmp_path / name, make_sensor(), gel_image)
    assert name in str(caught.value)


def test_no_camera(make_sensor: MakeSensor, gel_image: np.ndarray) -> None:
    with pytest.raises(FileError, match="camera 99 cannot be opened"):
        read_frames(99, make_sensor(), gel_image)


def test_images_of_another_kind_are_told(make_sensor: MakeSensor, gel_image: np.ndarray) -> None:
    (one,) = read_frames([gel_image.astype(float)], make_sensor(), gel_image)
    assert one.image is None
    assert "of uint8, not (48, 64, 3) of float64" in one.fault


def test_an_image_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nosuch\.png"):
        read_image(tmp_path / "nosuch.png")
