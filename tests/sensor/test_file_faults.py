"""Damaged and hostile files of the sensor: a `TactorchError` that names the file, or a result."""

import io
import json
import struct
import subprocess
import sys
import textwrap
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from tactorch.errors import FileError, TactorchError
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Calibration,
    load_calibration,
    read_labels,
    save_calibration,
)
from tactorch.sensor.description import GelLayer, SensorDescription, load_sensor
from tactorch.sensor.frames import open_source, read_frames, read_image
from tactorch.sensor.poses import read_poses
from tactorch.sensor.scale import read_corners

SENSOR = SensorDescription("small", (64, 48), (0.3, 0.3), GelLayer(3.0, 0.2, size_mm=(20.0, 16.0)))
YAML = """name: s
image_size_px: [64, 48]
mm_per_px: [0.3, 0.3]
gel: {thickness_mm: 3.0, youngs_mpa: 0.2, size_mm: [20.0, 16.0]}
markers: {columns: 5, rows: 4, pitch_mm: [3.0, 3.0], diameter_mm: 1.2}
"""
POSES = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,1,2,3,1,0,0,0\n0.5,1,2,2.5,1,0,0,0\n"
LABELS = "image,center_x_px,center_y_px,radius_px\na.png,30,20,9\nb.png,28,21,8.5\n"
CORNERS = "image,corner,x_px,y_px\np,1,5,5\np,2,50,5\np,3,50,40\np,4,5,40\n"
FLIPS, CUTS = 60, 20


def gel_image() -> np.ndarray:
    y, x = np.mgrid[:48, :64]
    light = np.stack([120 + x, 120 + y, 160 - 0.5 * x], axis=2)
    noise = np.random.default_rng(0).normal(0, 1.5, light.shape)
    return np.clip(light + noise, 0, 255).astype(np.uint8)


IMAGE = gel_image()


def encoded(suffix: str) -> bytes:
    return cv2.imencode(suffix, IMAGE[..., ::-1])[1].tobytes()


def calibration(folder: Path, name: str) -> bytes:
    path = folder / "whole.npz"
    save_calibration(Calibration(SENSOR_MAPS.build(name).create(0), IMAGE, (0.3, 0.3)), path)
    return path.read_bytes()


def video(folder: Path) -> bytes:
    path = folder / "whole.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    for i in range(5):
        writer.write(np.clip(IMAGE.astype(int) + i, 0, 255).astype(np.uint8))
    writer.release()
    return path.read_bytes()


def check_calibration(path: Path) -> None:
    assert np.isfinite(load_calibration(path).slopes(IMAGE, IMAGE)).all()


def check_image(path: Path) -> None:
    image = read_image(path)
    assert image.dtype == np.uint8
    assert image.ndim == 3


def check_frames(path: Path) -> None:
    for frame in read_frames(path, SENSOR, IMAGE):
        assert frame.image is not None or frame.fault


#: Kind of file, its content, and a function that reads it.
KINDS: dict[str, tuple[Callable[[Path], bytes], Callable[[Path], object]]] = {
    "sensor.yaml": (lambda d: YAML.encode(), load_sensor),
    "poses.csv": (lambda d: POSES.encode(), read_poses),
    "labels.csv": (lambda d: LABELS.encode(), read_labels),
    "corners.csv": (lambda d: CORNERS.encode(), read_corners),
    "image.png": (lambda d: encoded(".png"), check_image),
    "image.jpg": (lambda d: encoded(".jpg"), check_image),
    "image.bmp": (lambda d: encoded(".bmp"), check_image),
    "image.tif": (lambda d: encoded(".tif"), check_image),
    "press.avi": (video, check_frames),
    "lookup.npz": (lambda d: calibration(d, "lookup"), check_calibration),
    "mlp.npz": (lambda d: calibration(d, "mlp"), check_calibration),
}


def damaged(content: bytes, seed: int) -> list[bytes]:
    """The content with single and multiple byte flips, and cut short."""
    rng = np.random.default_rng(seed)
    variants = []
    for number in range(FLIPS):
        flipped = bytearray(content)
        # Headers decide more than data, so half of the flips are among the first bytes.
        reach = len(content) if number % 2 else min(len(content), 128)
        for place in rng.integers(reach, size=1 + number % 3):
            flipped[place] ^= int(rng.integers(1, 256))
        variants.append(bytes(flipped))
    return variants + [content[:cut] for cut in rng.integers(len(content), size=CUTS)]


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_or_read(kind: str, tmp_path: Path) -> None:
    make, read = KINDS[kind]
    content, path = make(tmp_path), tmp_path / kind
    path.write_bytes(content)
    read(path)  # whole, it is read
    messages = []
    for variant in damaged(content, seed=len(kind)):
        path.write_bytes(variant)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                read(path)
            except TactorchError as error:
                messages.append(str(error))
    assert messages
    assert all(kind in message for message in messages)


NESTED = "name: " + "[" * 5000 + "]" * 5000


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("gel: &a [*a]", "uses the alias '\\*a'"),
        ("&a name: 1\ngel: &b {<<: *b}", "uses the alias '\\*b'"),
        ("a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]", "uses the alias"),
        (NESTED, "nested deeper than 32 levels"),
        ("name: 2001-99-99", "not valid YAML"),
        ("name: " + "1" * 5000, "a value of 5000 characters in line 1"),
        ("name: " + "x" * 1_100_000, "1100006 bytes"),
    ],
    ids=["recursive", "merge", "shared", "nested", "date", "digits", "size"],
)
def test_hostile_descriptions(content: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(content)
    with pytest.raises(FileError, match=f"sensor.yaml'.*{reason}"):
        load_sensor(path)


def test_number_beyond_the_floats(tmp_path: Path) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(YAML.replace("thickness_mm: 3.0", "thickness_mm: " + "9" * 400))
    with pytest.raises(TactorchError, match=r"sensor\.yaml"):
        load_sensor(path)


FLAT = np.full((48, 64, 3), 200)


def tagged(orientation: int) -> bytes:
    """A JPEG file whose tag states another orientation."""
    content, tags = io.BytesIO(), PillowImage.Exif()
    tags[0x0112] = orientation
    PillowImage.fromarray(IMAGE).save(content, "JPEG", exif=tags, quality=97)
    return content.getvalue()


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_orientation_tags_are_ignored(orientation: int, tmp_path: Path) -> None:
    (tmp_path / "frame.jpg").write_bytes(tagged(orientation))
    assert np.abs(read_image(tmp_path / "frame.jpg").astype(int) - IMAGE).mean() < 3.0


@pytest.mark.parametrize(
    ("suffix", "stored", "says"),
    [
        (".png", FLAT.astype(np.uint16) * 16, "16 bits per channel.*above 3200.*of 12 bits; scale"),
        (".png", FLAT.astype(np.uint16) * 4, "above 800: values of 10 bits"),
        (".tif", (FLAT / 255).astype(np.float32), "TIFF of floats.*save it as PNG"),
        (
            ".tif",
            (FLAT[..., 0] / 255).astype(np.float32),
            "TIFF of floats.*save it as PNG",
        ),
        (".webp", FLAT.astype(np.uint8), "it is a WebP, or damaged; save it as PNG with 8 bits"),
        (".gif", FLAT.astype(np.uint8), "it is a GIF, or damaged; save it as PNG with 8 bits"),
    ],
)
def test_images_of_other_values_or_formats(
    suffix: str, stored: np.ndarray, says: str, tmp_path: Path
) -> None:
    path = tmp_path / ("frame.tif" if suffix == ".tif" else "frame.png")
    path.write_bytes(cv2.imencode(suffix, stored)[1].tobytes())
    with pytest.raises(FileError, match=says) as caught:
        read_image(path)
    assert path.name in str(caught.value)


def test_sixteen_bits_are_scaled(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), IMAGE[..., ::-1].astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_image(tmp_path / "frame.png"), IMAGE)


def test_libraries_print_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    flipped = bytearray(encoded(".png"))
    flipped[len(flipped) // 2] ^= 0xFF
    damaged = {"half.png": flipped[:2000], "flipped.png": flipped, "text.mp4": b"no video" * 500}
    for name, content in damaged.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=name):
            list(open_source(tmp_path / name))
    assert "".join(capfd.readouterr()) == ""


class VariableVideo:
    """A capture whose frames have time stamps, with the rate and number that a header declares."""

    def __init__(self, stamps_ms: list[float], rate: float, declared: int) -> None:
        self.stamps_ms, self.next = stamps_ms, 0
        self.header = {cv2.CAP_PROP_FPS: rate, cv2.CAP_PROP_FRAME_COUNT: float(declared)}

    def isOpened(self) -> bool:
        return True

    def get(self, key: int) -> float:
        stamp = self.stamps_ms[max(self.next - 1, 0)] if self.stamps_ms else 0.0
        return stamp if key == cv2.CAP_PROP_POS_MSEC else self.header.get(key, 48.0)

    def read(self) -> tuple[bool, np.ndarray]:
        self.next += 1
        return self.next <= len(self.stamps_ms), IMAGE

    def release(self) -> None:
        pass


@pytest.mark.parametrize(
    ("stamps_ms", "declared", "times_s", "missing"),
    [
        pytest.param([0, 33, 67, 167, 267], 9, [0, 0.033, 0.067, 0.167, 0.267], 0, id="variable"),
        pytest.param([0, 33, 67, 167, 267], 12, [0, 0.033, 0.067, 0.167, 0.267], 3, id="cut"),
        pytest.param([500, 540, 580], 3, [0, 0.04, 0.08], 0, id="from a later start"),
        pytest.param([0, 0, 0], 3, [0, 1 / 30, 2 / 30], 0, id="none"),
        pytest.param([0, 50, 20, 120], 4, [0, 0.05, 0.05 + 1 / 30, 0.12], 0, id="one back"),
        pytest.param([0, float("nan"), 70], 3, [0, 1 / 30, 0.07], 0, id="one unknown"),
    ],
)
def test_times_are_those_of_the_video(
    stamps_ms: list[float], declared: int, times_s: list[float], missing: int, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    path = tmp_path / "press.mkv"
    path.write_bytes(b"RIFF")
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: VariableVideo(stamps_ms, 30.0, declared))
    frames = list(open_source(path))
    seen = [frame for frame in frames if frame.image is not None]
    np.testing.assert_allclose([frame.time_s for frame in seen], times_s, atol=1e-9)
    assert len(frames) - len(seen) == missing


def huge_png(side: int) -> bytes:
    """A small PNG whose header declares many black pixels, and holds them."""

    def chunk(name: bytes, content: bytes) -> bytes:
        checksum = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", checksum)

    packer = zlib.compressobj(9)
    row = b"\0" * (1 + side)
    rows = b"".join([*(packer.compress(row) for _ in range(side)), packer.flush()])
    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def peak_memory_mb(code: str) -> float:
    """Run code in a process of its own and return the growth of its peak memory, MB."""
    program = (
        "import resource, cv2, numpy\n"
        "from tactorch.sensor.frames import read_image\n"
        "from tactorch.errors import FileError\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        f"{textwrap.dedent(code)}\n"
        "print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return float(done.stdout.splitlines()[-1])


def test_large_images_are_refused_by_their_header(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    path.write_bytes(huge_png(12_000))  # 430 MB as RGB
    code = f"""
    try:
        read_image({str(path)!r})
    except FileError as error:
        assert "12000 x 12000 px" in str(error), error
    else:
        raise SystemExit("it was read")
    """
    assert peak_memory_mb(code) < 60


def test_arrays_too_large_to_unpack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "calib.npz"
    path.write_bytes(calibration(tmp_path, "lookup"))
    monkeypatch.setenv("TACTORCH_FILE_GIB", "1e-6")
    with pytest.raises(FileError, match=r"calib\.npz' is too large.*set TACTORCH_FILE_GIB=1 "):
        load_calibration(path)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("map/table", np.zeros((24, 24, 24))),
        ("map/table", np.zeros((24, 24, 3, 2))),
        ("map/plane", np.zeros((2, 9))),
        ("map/most", np.array(0.0)),
    ],
)
def test_arrays_of_another_shape(name: str, values: np.ndarray, tmp_path: Path) -> None:
    calibration(tmp_path, "lookup")
    with np.load(tmp_path / "whole.npz") as archive:
        content = {key: archive[key] for key in archive.files}
    np.savez(tmp_path / "calib.npz", **{**content, name: values})
    with pytest.raises(FileError, match=r"calib\.npz"):
        load_calibration(tmp_path / "calib.npz")


def test_calibration_text_of_another_kind(tmp_path: Path) -> None:
    np.savez(tmp_path / "calib.npz", about=np.array(json.dumps([1, 2])))
    with pytest.raises(FileError, match=r"calib\.npz"):
        load_calibration(tmp_path / "calib.npz")


@pytest.mark.parametrize("declared", [1e9, float("nan"), -5.0])
def test_videos_that_declare_absurd_lengths(
    declared: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Capture:
        """A capture of two frames whose header declares another number."""

        def __init__(self, path: str) -> None:
            self.left = 2

        def isOpened(self) -> bool:
            return True

        def get(self, key: int) -> float:
            sizes = {cv2.CAP_PROP_FRAME_WIDTH: 64.0, cv2.CAP_PROP_FRAME_HEIGHT: 48.0}
            return sizes.get(key, declared)

        def read(self) -> tuple[bool, np.ndarray]:
            self.left -= 1
            return self.left >= 0, IMAGE

        def release(self) -> None:
            pass

    path = tmp_path / "press.avi"
    path.write_bytes(b"RIFF")
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    frames = list(read_frames(path, SENSOR, IMAGE))
    assert 2 <= len(frames) <= 20_000
    assert all(frame.time_s is None for frame in frames)


def test_videos_of_too_many_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tactorch.sensor import frames as sources

    path = tmp_path / "press.avi"
    path.write_bytes(video(tmp_path))
    monkeypatch.setattr(sources, "MAX_PIXELS", 1000)
    with pytest.raises(FileError, match=r"press\.avi' is too large: 64 x 48 px"):
        list(read_frames(path, SENSOR, IMAGE))
