"""Bad input to the sensor: each message names the file, field or value, and says what to do."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.mesh import box_mesh
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Ball,
    BallPress,
    Calibration,
    Circle,
    find_circle,
    fit_map,
    load_calibration,
    read_labels,
    save_calibration,
)
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import build_press, check_pose, facing_triangles
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, load_sensor
from tactorch.sensor.frames import read_frames, read_image, read_reference
from tactorch.sensor.gel import GelContact, GelModel, GelOptions
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker
from tactorch.sensor.poses import Poses, read_poses
from tactorch.sensor.render import GelSurface, render
from tactorch.sensor.scale import Outline, cuboid, hexagon, measure_pixel_scale, read_corners

from .dots import draw, grid

GEL = GelLayer(3.0, 0.2, size_mm=(20.0, 16.0))
SENSOR = SensorDescription("small", (64, 48), (0.3, 0.3), GEL)
MARKED = replace(SENSOR, markers=MarkerGrid(5, 4, (3.0, 3.0), 1.2))
BALL = Ball(3.0, (0.3, 0.3))
YAML = """name: s
image_size_px: [64, 48]
mm_per_px: [0.3, 0.3]
gel: {thickness_mm: 3.0, youngs_mpa: 0.2, size_mm: [20.0, 16.0]}
markers: {columns: 5, rows: 4, pitch_mm: [3.0, 3.0], diameter_mm: 1.2}
"""
LABELS = "image,center_x_px,center_y_px,radius_px\n"
POSES = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
CORNERS = "image,corner,x_px,y_px\n"


def gel_image(rows: int = 48, columns: int = 64) -> np.ndarray:
    y, x = np.mgrid[:rows, :columns]
    light = np.stack([120 + x, 120 + y, 160 - 0.5 * x], axis=2)
    noise = np.random.default_rng(0).normal(0, 1.5, light.shape)
    return np.clip(light + noise, 0, 255).astype(np.uint8)


IMAGE = gel_image()
STILL = np.zeros((48, 64, 3))
KNOWN = np.ones((48, 64), dtype=bool)


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def sensor(folder: Path, old: str, new: str) -> SensorDescription:
    """A description with one thing wrong."""
    assert old in YAML
    return load_sensor(written(folder, "sensor.yaml", YAML.replace(old, new)))


def calibration(folder: Path, about: dict | None = None, **arrays: np.ndarray) -> Calibration:
    """A calibration with something wrong."""
    path = folder / "calib.npz"
    save_calibration(Calibration(SENSOR_MAPS.build("lookup").create(0), IMAGE, (0.3, 0.3)), path)
    with np.load(path) as found:
        content = {name: found[name] for name in found.files}
    text = json.loads(str(content.pop("about"))) | (about or {})
    np.savez(path, about=np.array(json.dumps(text)), **{**content, **arrays})
    return load_calibration(path)


def cut(folder: Path, name: str, content: bytes) -> Path:
    return written(folder, name, content[: len(content) // 2])


def half_calibration(folder: Path) -> Calibration:
    calibration(folder)
    return load_calibration(cut(folder, "calib.npz", (folder / "calib.npz").read_bytes()))


def pickled(folder: Path) -> Calibration:
    np.savez(folder / "calib.npz", about=np.array({"format": 1}, dtype=object))
    return load_calibration(folder / "calib.npz")


def video(folder: Path) -> Path:
    path = folder / "press.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (64, 48))
    for i in range(30):
        image = np.clip(IMAGE.astype(int) + i, 0, 255).astype(np.uint8)
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return cut(folder, "press.avi", path.read_bytes())


def empty(folder: Path) -> Path:
    (folder / "frames").mkdir()
    return folder / "frames"


def png(folder: Path, name: str, image: np.ndarray) -> Path:
    return written(folder, name, cv2.imencode(".png", image[..., ::-1])[1].tobytes())


def pose(*scale: float, place: tuple[float, float, float] = (10.0, 20.0, 30.0)) -> np.ndarray:
    found = np.diag([*(scale or (1.0, 1.0, 1.0)), 1.0])
    found[:3, 3] = place
    return found


def touch(circle: Circle, changed: np.ndarray = STILL) -> BallPress:
    return BallPress("b3.png", changed, KNOWN, circle)


def chain(one: SensorDescription, reference: np.ndarray, size: int = 48) -> SensorChain:
    scale = (0.3, 0.3)
    return SensorChain(
        one, Calibration(SENSOR_MAPS.build("lookup").create(0), gel_image(size), scale), reference
    )


def touching() -> GelContact:
    points = np.stack([*np.meshgrid([-4.0, 0.0, 4.0], [-4.0, 0.0, 4.0]), np.zeros((3, 3))], axis=-1)
    return GelContact(points.reshape(-1, 3), np.zeros((9, 3)), np.zeros((9, 3)))


def above(place: tuple[float, float, float]) -> np.ndarray:
    """A sensor that looks down on the object's top."""
    return pose(1.0, -1.0, -1.0, place=place)


def frames(source: object, reference: np.ndarray = IMAGE, one: SensorDescription = SENSOR) -> list:
    return list(read_frames(source, one, reference))


def images_of(folder: Path, labels: str) -> list[np.ndarray]:
    png(folder, "a.png", IMAGE)
    table = read_labels(written(folder, "labels.csv", labels))
    return [read_image(folder / name) for name in table]


def outline(shift: float = 0.0, turn: float = 0.0) -> Outline:
    corners = np.array([(10.0, 10.0), (50.0, 10.0), (50.0, 40.0), (10.0, 40.0)])
    return Outline("p1.png", corners + shift + turn * corners[:, ::-1])


@dataclass(frozen=True)
class Bad:
    """Something bad.

    Attributes:
        what: In words.
        where: Which function is told.
        call: It, given an empty folder.
        says: What the message must hold.
        error: Its kind.
    """

    what: str
    where: str
    call: Callable[[Path], object]
    says: tuple[str, ...]
    error: type[TactorchError] = ConfigError


REFUSED = [
    # Frames and references
    Bad("no reference", "read_reference", lambda d: read_reference(d / "ref.png", SENSOR),
        ("image not found", "ref.png", "folder holds"), FileError),
    Bad("reference of garbage bytes", "read_reference",
        lambda d: read_reference(written(d, "ref.png", b"\x89PNG nonsense"), SENSOR),
        ("ref.png", "damaged or no image"), FileError),
    Bad("reference of another size", "read_reference",
        lambda d: read_reference(png(d, "ref.png", gel_image(60, 80)), SENSOR),
        ("ref.png is 80 x 60 px", "'small' gives 64 x 48", "check image_size_px"), FileError),
    Bad("reference in the dark", "read_reference",
        lambda d: read_reference(png(d, "ref.png", IMAGE // 40), SENSOR),
        ("ref.png", "is dark, 3.", "lights on?"), FileError),
    Bad("reference of too few frames", "read_reference",
        lambda d: read_reference([IMAGE, IMAGE], SENSOR, 5),
        ("2 of 5 frames", "declare images of the gel without contact"), FileError),
    Bad("reference of no frame", "read_reference", lambda d: read_reference([IMAGE], SENSOR, 0),
        ("frames=0", "at least 1")),
    Bad("reference of another sensor", "read_frames", lambda d: frames([IMAGE], gel_image(60, 80)),
        ("reference is 80 x 60 px", "64 x 48", "read_reference")),
    Bad("empty folder", "read_frames", lambda d: frames(empty(d)),
        ("frames' has no image", ".png"), FileError),
    Bad("no images given", "read_frames", lambda d: frames([]),
        ("no image was given", "source empty?"), FileError),
    Bad("file that is no source", "read_frames", lambda d: frames(written(d, "f.npy", b"1")),
        ("f.npy' is no source of frames", "give a folder"), FileError),
    Bad("video of garbage bytes", "read_frames", lambda d: frames(written(d, "p.avi", b"RIFF00")),
        ("p.avi' cannot be opened", "damaged"), FileError),
    Bad("camera that is not there", "read_frames", lambda d: frames(97),
        ("camera 97 cannot be opened", "not there, or another program"), FileError),
    Bad("camera of a negative number", "read_frames", lambda d: frames(-1),
        ("camera -1", "numbered from 0"), FileError),
    # Descriptions
    Bad("no description", "load_sensor", lambda d: load_sensor(d / "sensor.yaml"),
        ("sensor.yaml' is not a file", "or one of finger"), FileError),
    Bad("unknown field", "load_sensor", lambda d: sensor(d, "name: s", "name: s\nppmm: 19.6"),
        ("sensor.yaml", "unknown setting 'ppmm'", "Settings of this group: name, image")),
    Bad("modulus in kPa", "load_sensor", lambda d: sensor(d, "youngs_mpa: 0.2", "youngs_mpa: 200"),
        ("sensor.yaml", "youngs_mpa=200:", "0.001 to 20", "in kPa? Then give 0.2")),
    Bad("modulus in Pa", "load_sensor",
        lambda d: sensor(d, "youngs_mpa: 0.2", "youngs_mpa: 200000"),
        ("sensor.yaml", "youngs_mpa=200000", "0.001 to 20", "in Pa? Then give 0.2")),
    Bad("number that YAML takes for text", "load_sensor",
        lambda d: sensor(d, "youngs_mpa: 0.2", "youngs_mpa: 2e-1"),
        ("sensor.yaml", "youngs_mpa='2e-1'", "takes 1.0e-3 for one")),
    Bad("thickness in metres", "load_sensor",
        lambda d: sensor(d, "thickness_mm: 3.0", "thickness_mm: 0.003"),
        ("sensor.yaml", "gel.thickness_mm=0.003", "metres? Then give 3")),
    Bad("gel's size in metres", "load_sensor",
        lambda d: sensor(d, "[20.0, 16.0]", "[0.02, 0.016]"),
        ("sensor.yaml", "gel.size_mm=[0.02, 0.016]", "metres? Then give 20, 16")),
    Bad("pixels per mm", "load_sensor", lambda d: sensor(d, "[0.3, 0.3]", "[19.58, 19.58]"),
        ("sensor.yaml", "mm_per_px=[19.58, 19.58]", "give mm per pixel (0.05107)")),
    Bad("metres per pixel", "load_sensor", lambda d: sensor(d, "[0.3, 0.3]", "[3.0e-5, 3.0e-5]"),
        ("sensor.yaml", "mm_per_px", "looks like metres", "(0.03)")),
    Bad("image that shows far more than the gel", "load_sensor",
        lambda d: sensor(d, "64, 48", "640, 480"),
        ("sensor.yaml", "192 x 144 mm, but the gel is 20 x 16 mm", "check mm_per_px")),
    Bad("Poisson's ratio of a liquid", "load_sensor",
        lambda d: sensor(d, "youngs_mpa: 0.2", "youngs_mpa: 0.2, poisson: 0.5"),
        ("sensor.yaml", "poisson is 0.5", "use 0.49 to 0.499")),
    Bad("a word for a number", "load_sensor",
        lambda d: sensor(d, "thickness_mm: 3.0", "thickness_mm: thick"),
        ("sensor.yaml", "gel.thickness_mm='thick'", "give a number, 0.05 to 100")),
    Bad("more markers than fit", "load_sensor", lambda d: sensor(d, "columns: 5", "columns: 12"),
        ("sensor.yaml", "24 of 48 are outside the gel", "Check columns, rows and pitch_mm")),
    Bad("as many markers as pixels", "load_sensor",
        lambda d: sensor(d, "columns: 5", "columns: 5000"),
        ("sensor.yaml", "markers.columns=5000", "a whole number, 1 to 1000")),
    # Presses of a ball
    Bad("table without a column", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", "image,center_x_px\na.png,3\n")),
        ("labels.csv' lacks the column center_y_px", "it needs image"), FileError),
    Bad("number that is none", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", LABELS + "a.png,30,x,9\n")),
        ("labels.csv', line 2", "'x'", "center_y_px must be a number"), FileError),
    Bad("line that ends too soon", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", LABELS + "a.png,30,20\n")),
        ("labels.csv', line 2", "radius_px is missing"), FileError),
    Bad("contact of negative radius", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", LABELS + "a.png,30,20,-9\n")),
        ("labels.csv', line 2", "radius_px=-9.0", "at least 2"), FileError),
    Bad("two contacts of one image", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", LABELS + "a.png,3,2,9\na.png,3,2,8\n")),
        ("labels.csv', line 3", "a.png has a contact already", "give one"), FileError),
    Bad("table that is no text", "read_labels",
        lambda d: read_labels(written(d, "labels.csv", b"\xff\xfe\x00\x01")),
        ("labels.csv' is not readable text", "save it as CSV"), FileError),
    Bad("labels of an absent image", "read_image",
        lambda d: images_of(d, LABELS + "a.png,30,20,9\nb.png,30,20,9\n"),
        ("image not found", "b.png' is not a file", "folder holds: a.png"), FileError),
    Bad("label beside the image", "Touch", lambda d: touch(Circle((300.0, 20.0), 9.0)),
        ("b3.png", "(300, 20) px is outside the image of 64 x 48", "x before y?")),
    Bad("contact wider than the image", "Touch", lambda d: touch(Circle((30.0, 20.0), 90.0)),
        ("b3.png", "radius_px=90", "64 x 48", "give pixels")),
    Bad("image that is not finite", "Touch",
        lambda d: touch(Circle((30.0, 20.0), 9.0), np.full((48, 64, 3), np.nan)),
        ("b3.png", "not finite; leave it out")),
    Bad("pixel that is not finite", "Touch",
        lambda d: touch(Circle((30.0, 20.0), 9.0), np.where(np.arange(3) < 2, STILL, np.inf)),
        ("b3.png", "not finite; leave it out")),
    Bad("contact wider than the ball", "fit_map",
        lambda d: fit_map([touch(Circle((30.0, 20.0), 11.0))], BALL),
        ("b3.png", "radius 3.3 mm is wider than the ball (3 mm)", "check radius_mm")),
    Bad("no press at all", "fit_map", lambda d: fit_map([], BALL),
        ("no press of the ball", "give images")),
    Bad("ball of negative radius", "Ball", lambda d: Ball(-2.0, (0.3, 0.3)),
        ("radius_mm=-2", "a number, 0.2 to 100")),
    Bad("ball in metres", "Ball", lambda d: Ball(0.00235, (0.3, 0.3)),
        ("radius_mm=0.00235", "metres? Then give 2.35")),
    Bad("pixels per mm for a ball", "Ball", lambda d: Ball(2.35, (19.58, 19.58)),
        ("mm_per_px=[19.58, 19.58]", "0.05107")),
    Bad("no ball", "find_circle", lambda d: find_circle(STILL, BALL, "b3.png"),
        ("b3.png: no ball found; nothing changed", "Leave the image out")),
    Bad("ball much larger than the view", "find_circle",
        lambda d: find_circle(STILL, Ball(60.0, (0.3, 0.3)), "b3.png"),
        ("b3.png", "radius_mm=60", "200 px in an image of 64 x 48", "check radius_mm")),
    # Calibrations
    Bad("no calibration", "load_calibration", lambda d: load_calibration(d / "calib.npz"),
        ("calibration not found", "calib.npz"), FileError),
    Bad("damaged calibration", "load_calibration", half_calibration,
        ("calib.npz' cannot be read", "Calibrate again"), FileError),
    Bad("calibration with a pickle", "load_calibration", pickled,
        ("calib.npz' cannot be read", "Python objects", "Calibrate again"), FileError),
    Bad("calibration of a newer version", "load_calibration",
        lambda d: calibration(d, {"version": 9}),
        ("calib.npz' is of version 9, this tactorch reads 1", "calibrate again"), FileError),
    Bad("calibration in pixels per mm", "load_calibration",
        lambda d: calibration(d, {"mm_per_px": [19.58, 19.58]}),
        ("calib.npz", "mm_per_px=[19.58, 19.58]", "Calibrate again"), FileError),
    Bad("calibration that is not finite", "load_calibration",
        lambda d: calibration(d, **{"map/table": np.full((24, 24, 24, 2), np.nan)}),
        ("calib.npz", "map/table is not finite", "Calibrate again"), FileError),
    Bad("calibration of another image size", "Calibration.slopes",
        lambda d: calibration(d).slopes(gel_image(60, 80), gel_image(60, 80)),
        ("(60, 80, 3)", "calibrated with (48, 64, 3)", "calibrate again")),
    # The size of a pixel
    Bad("nut in metres", "hexagon", lambda d: hexagon(0.008),
        ("across_flats_mm=0.008", "looks like metres; give 8")),
    Bad("cuboid without a side", "cuboid", lambda d: cuboid(8.0, 0.0),
        ("height_mm=0.0", "positive")),
    Bad("corners on a line", "read_corners",
        lambda d: read_corners(
            written(d, "c.csv", CORNERS + "p1.png,1,1,1\np1.png,2,30,30\np1.png,3,60,60\n")
        ),
        ("c.csv", "p1.png", "on a line", "convex polygon")),
    Bad("too few corners", "pixel_scale",
        lambda d: measure_pixel_scale([outline()], hexagon(8.0), SENSOR),
        ("p1.png: 4 corners, but a hexagon has 6", "give each once")),
    Bad("corners beside the image", "pixel_scale",
        lambda d: measure_pixel_scale([outline(30.0)], cuboid(12.0, 9.0), SENSOR),
        ("p1.png", "(80.0, 40.0) px is outside the image of 64 x 48", "rectified")),
    Bad("corners of another shape", "pixel_scale",
        lambda d: measure_pixel_scale([outline(-5.0, 0.2)], cuboid(12.0, 9.0), SENSOR),
        ("p1.png: its corners are no cuboid", "check the shape")),
    # Markers, depth and gel
    Bad("reference with too few markers", "MarkerTracker",
        lambda d: MarkerTracker(draw(grid()[:4]), MarkerAppearance(10.0)),
        ("4 markers were found", "9 are needed", "diameter_px=10 right?")),
    Bad("frame of another size", "MarkerTracker.follow",
        lambda d: MarkerTracker(draw(grid()), MarkerAppearance(10.0)).track(draw(grid())[:-4]),
        ("(236, 320, 3)", "(240, 320, 3)", "rectified frames of one sensor")),
    Bad("slopes that are not finite", "height_of",
        lambda d: reconstruct_height(np.full((48, 64, 2), np.nan), (0.3, 0.3)),
        ("not finite", "fill them in first")),
    Bad("displacement of the gel all NaN", "GelModel.forces",
        lambda d: GelModel(GEL, GelOptions(2.0, 2, "tet4")).forces(np.full((99, 3), np.nan)),
        ("no displacement of the gel is known",)),
    Bad("calibration of another sensor", "SensorChain", lambda d: chain(MARKED, IMAGE, 60),
        ("the calibration is of images of 64 x 60 px", "64 x 48", "of this sensor")),
    Bad("calibration at another scale", "SensorChain",
        lambda d: chain(replace(MARKED, mm_per_px=(0.28, 0.3)), IMAGE),
        ("'small' was calibrated with mm_per_px=(0.3, 0.3)", "(0.28, 0.3)", "calibrate again")),
    Bad("rendered face that is not finite", "render",
        lambda d: render(SENSOR, GelSurface(np.full((48, 64), np.nan), np.zeros((0, 2)))),
        ("heights are not finite", "give 0")),
    # Poses
    Bad("poses for fewer than all frames", "Poses.at",
        lambda d: Poses(np.array([0.0, 1.0]), np.stack([pose()] * 2)).at([0.5, 1.5, 2.0]),
        ("2 of 3 frames have no pose", "0.500 to 2.000 s, poses from 0.000 to 1.000 s",
         "one clock")),
    Bad("frames without a time", "Poses.at",
        lambda d: Poses(np.array([0.0, 1.0]), np.stack([pose()] * 2)).at([np.nan, 0.5]),
        ("1 of 2 frames have no time", "give frame_rate_hz")),
    Bad("pose without a time", "Poses", lambda d: Poses(np.array([np.nan]), pose()[None]),
        ("pose 0 has no time", "time_s is nan; give seconds")),
    Bad("times that go back", "Poses",
        lambda d: Poses(np.array([1.0, 0.5]), np.stack([pose()] * 2)),
        ("time_s must rise", "pose 1 is at 0.5 s")),
    Bad("table of poses without a column", "read_poses",
        lambda d: read_poses(written(d, "p.csv", POSES.replace("x_mm", "x_m") + "0,1,2\n")),
        ("p.csv' lacks the column x_mm", "it needs time_s"), FileError),
    Bad("quaternion of another length", "read_poses",
        lambda d: read_poses(written(d, "p.csv", POSES + "0,1,2,3,0.5,0,0,0\n")),
        ("p.csv', line 2", "length 0.5, not 1", "give qw"), FileError),
    Bad("singular pose", "check_pose", lambda d: check_pose(pose(1.0, 1.0, 0.0), "pose 7"),
        ("pose 7 is singular (determinant 0)", "must be a rotation")),
    Bad("mirrored pose", "check_pose", lambda d: check_pose(pose(1.0, 1.0, -1.0), "pose 7"),
        ("pose 7 mirrors (determinant -1)", "turn one axis round")),
    Bad("pose that scales", "check_pose", lambda d: check_pose(pose(1.0, 1.0, 1.001), "pose 7"),
        ("pose 7", "not orthonormal", "scale or shear?")),
    Bad("transposed pose", "check_pose", lambda d: check_pose(pose().T, "pose 7"),
        ("pose 7", "last row must be 0 0 0 1", "transposed?")),
    Bad("pose in micrometres", "check_pose",
        lambda d: check_pose(pose(place=(1e5, 0.0, 0.0)), "pose 7"),
        ("pose 7 is 1e+05 mm away", "give mm")),
    Bad("pose in metres", "facing",
        lambda d: facing_triangles(box_mesh(10.0, 2), above((0.005, 0.005, 0.01)), touching(), 3.0),
        ("over no part of the object", "[0.005, 0.005, 0.01] looks like metres; give mm")),
    Bad("contact on no part of the object", "facing",
        lambda d: facing_triangles(box_mesh(10.0, 2), above((5.0, 5.0, 40.0)), touching(), 3.0),
        ("over no part of the object", "nearest is 30 mm away", "check T_object_sensor")),
    Bad("frame without contact", "build_press",
        lambda d: build_press(
            touching(), above((5.0, 5.0, 9.0)), above((5.0, 5.0, 10.0)), box_mesh(10.0, 2),
            np.zeros(9, dtype=bool),
        ),
        ("touches nothing in this frame", "leave it out")),
]  # fmt: skip


@pytest.mark.parametrize("bad", REFUSED, ids=lambda bad: f"{bad.where}: {bad.what}")
def test_bad_input_is_refused(bad: Bad, tmp_path: Path) -> None:
    with pytest.raises(bad.error) as caught:
        bad.call(tmp_path)
    for part in bad.says:
        assert part in str(caught.value)


def told(found: list) -> str:
    """What is told of the first faulty frame."""
    return next((frame.fault for frame in found if frame.fault), "nothing is told")


def folder_with(folder: Path, name: str, content: bytes) -> Path:
    png(empty(folder), "0.png", np.clip(IMAGE + 3, 0, 255).astype(np.uint8))
    return written(folder / "frames", name, content).parent


#: What goes on all the same, with the frame's fault told.
TOLD = [
    Bad("frame of garbage bytes", "read_frames",
        lambda d: frames(folder_with(d, "1.png", b"\x89PNG nonsense")),
        ("1.png' cannot be read", "damaged or no image")),
    Bad("empty frame", "read_frames", lambda d: frames(folder_with(d, "1.png", b"")),
        ("1.png' cannot be read",)),
    Bad("frame of another size", "read_frames", lambda d: frames([gel_image(60, 80)]),
        ("frame 0 is 80 x 60 px", "'small' gives 64 x 48", "check image_size_px")),
    Bad("frame with NaN", "read_frames", lambda d: frames([np.full((48, 64, 3), np.nan)]),
        ("must be (h, w, 3) of uint8", "of float64", "convert")),
    Bad("frame of 16 bits", "read_frames", lambda d: frames([IMAGE.astype(np.uint16)]),
        ("must be (h, w, 3) of uint8", "of uint16")),
    Bad("grey frame", "read_frames", lambda d: frames([IMAGE[..., 0]]),
        ("must be (h, w, 3) of uint8, not (48, 64)",)),
    Bad("all frames dark", "read_frames", lambda d: frames([IMAGE // 20, IMAGE // 21]),
        ("dark: ", "of the reference's brightness")),
    Bad("video cut short", "read_frames", lambda d: frames(video(d)),
        ("video is cut short", "of 30 frames can be decoded", "times are too early")),
]  # fmt: skip


@pytest.mark.parametrize("bad", TOLD, ids=lambda bad: f"{bad.where}: {bad.what}")
def test_faulty_frames_are_told(bad: Bad, tmp_path: Path) -> None:
    found = bad.call(tmp_path)
    for part in bad.says:
        assert part in told(found)


def test_good_input_is_taken(tmp_path: Path) -> None:
    """What bad cases are changed from is accepted, so that each is refused for its own fault."""
    assert sensor(tmp_path, "name: s", "name: good").name == "good"
    assert calibration(tmp_path).mm_per_px == (0.3, 0.3)
    assert calibration(tmp_path).slopes(IMAGE).shape == (48, 64, 2)
    assert read_reference(png(tmp_path, "ref.png", IMAGE), SENSOR).shape == IMAGE.shape
    assert len(images_of(tmp_path, LABELS + "a.png,30,20,9\n")) == 1
    assert len(read_poses(written(tmp_path, "p.csv", POSES + "0,1,2,3,1,0,0,0\n"))) == 1
    assert len(facing_triangles(box_mesh(10.0, 2), above((5.0, 5.0, 10.0)), touching(), 3.0)) > 0
    check_pose(pose())
    found = measure_pixel_scale([outline()], cuboid(12.0, 9.0), SENSOR)
    assert found.mm_per_px == pytest.approx((0.3, 0.3))


def test_tables_of_spreadsheets_are_read(tmp_path: Path) -> None:
    """With the mark that some programs begin a file with, and blanks around names."""
    text = "\ufeff" + LABELS.replace(",", ", ") + "a.png, 30, 20, 9\r\n"
    assert read_labels(written(tmp_path, "l.csv", text)) == {"a.png": Circle((30.0, 20.0), 9.0)}
