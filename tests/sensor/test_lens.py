"""The lens: rectified images are those of OpenCV, gradients are right, and the grid shows it."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from tactorch.errors import ConfigError
from tactorch.sensor.camera import Lens, fit_lens
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.frames import Frame, read_frames
from tactorch.sensor.markers import MarkerAppearance, detect_markers
from tactorch.sensor.render import GelSurface, render

GEL = GelLayer(3.0, 0.2, 0.45, size_mm=(22.0, 17.0))
INTRINSICS = (150.0, 148.0, 80.0, 58.0)
COEFFICIENTS = {
    4: (-0.2, 0.05, 0.002, -0.001),
    5: (-0.2, 0.05, 0.002, -0.001, 0.01),
    8: (-0.2, 0.05, 0.002, -0.001, 0.01, 0.02, -0.01, 0.003),
}  # fmt: skip
COEFFICIENTS[14] = (*COEFFICIENTS[8], 0.001, 0.002, -0.001, 0.001, 0.01, 0.02)
CORNERS = ((12.0, 10.0), (150.0, 8.0), (148.0, 112.0), (9.0, 115.0))
WARPED = SensorDescription(
    "warped", (100, 80), (0.1, 0.1), GEL, raw_size_px=(160, 120), intrinsics_px=INTRINSICS,
    distortion=COEFFICIENTS[5], warp_corners_px=CORNERS, warped_size_px=(110, 90),
    crop_px=(5, 4, 100, 80),
)  # fmt: skip


def photo(rng: np.random.Generator) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.uniform(0, 255, (120, 160, 3)).astype(np.float32), (0, 0), 3)
    return np.clip(3 * noise - 200, 0, 255).astype(np.uint8)


def batch(*images: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.stack(images)).double().movedim(-1, 1)


def undistort(image: np.ndarray, matrix: np.ndarray, coefficients: Sequence[float]) -> np.ndarray:
    """As `cv2.undistort`, but by cubic interpolation."""
    size, lens = image.shape[1::-1], np.array(coefficients)
    maps = cv2.initUndistortRectifyMap(matrix, lens, np.eye(3), matrix, size, cv2.CV_32FC1)
    return cv2.remap(image, *maps, cv2.INTER_CUBIC)


def test_undistorted_images_are_those_of_opencv(rng: np.random.Generator) -> None:
    """OpenCV rounds positions to a 32nd of a pixel, and the result, which is 0.25 on average."""
    images, matrix = [photo(rng), photo(rng)], np.eye(3)
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = INTRINSICS
    for coefficients in COEFFICIENTS.values():
        sensor = SensorDescription(
            "round", (160, 120), (0.1, 0.1), GEL, intrinsics_px=INTRINSICS, distortion=coefficients
        )
        rectified = Lens(sensor)(batch(*images)).detach().movedim(1, -1).numpy()
        expected = [undistort(image, matrix, coefficients) for image in images]
        inner = np.s_[:, 2:-2, 2:-2]  # OpenCV mixes the border with black otherwise
        assert np.abs(rectified - expected)[inner].max() < 1.5
        assert np.abs(rectified - expected)[inner].mean() < 0.28


def test_warped_images_are_those_of_opencv_interpolated_once(rng: np.random.Generator) -> None:
    """Two interpolations in OpenCV blur more: three gray values at most, half of one on average."""
    image, matrix = photo(rng), np.eye(3)
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = INTRINSICS
    ends = np.array([(0, 0), (109, 0), (109, 89), (0, 89)], np.float32)
    warp = cv2.getPerspectiveTransform(np.array(CORNERS, np.float32), ends)
    undistorted = undistort(image, matrix, COEFFICIENTS[5])
    whole = cv2.warpPerspective(undistorted, warp, (110, 90), flags=cv2.INTER_CUBIC)
    expected = whole[4:84, 5:105].astype(float)
    (rectified,) = Lens(WARPED)(batch(image)).detach().movedim(1, -1).numpy()
    assert np.abs(rectified - expected).max() < 3.0
    assert np.abs(rectified - expected).mean() < 0.5
    (frame,) = read_frames([image], WARPED, np.full((80, 100, 3), 99, np.uint8))
    assert isinstance(frame, Frame)
    assert np.abs(frame.image - rectified).max() < 1.0  # the frames of all commands


def test_positions_go_back_and_forth(rng: np.random.Generator) -> None:
    lens = Lens(WARPED)
    positions = torch.from_numpy(rng.uniform(0, 80, (30, 2)))
    with torch.no_grad():
        back = lens.rectified_positions(lens.raw_positions(positions))
    torch.testing.assert_close(back, positions, atol=1e-8, rtol=0)
    image = cv2.GaussianBlur(photo(rng)[:80, :100], (0, 0), 2.0)
    with torch.no_grad():
        same = lens(lens.distort(batch(image))).movedim(1, -1)[0].numpy()
    assert np.abs(same - image)[5:-5, 5:-5].mean() < 1.0


@pytest.mark.parametrize("name", ["intrinsics", "distortion", "corners"])
def test_gradients_of_images_by_the_lens(name: str, rng: np.random.Generator) -> None:
    sensor = SensorDescription(
        "tiny", (8, 8), (0.1, 0.1), GEL, raw_size_px=(9, 10), intrinsics_px=(9.0, 9.5, 4.1, 4.6),
        distortion=COEFFICIENTS[8],
        warp_corners_px=((1.1, 1.2), (7.3, 0.9), (7.6, 8.2), (0.7, 8.4)),
    )  # fmt: skip
    lens, image = Lens(sensor), torch.from_numpy(rng.uniform(0, 1, (1, 2, 10, 9)))

    def images(value: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(lens, {name: value}, (image,))

    assert gradcheck(images, (getattr(lens, name).detach().requires_grad_(),))


def test_images_of_another_size_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"images are 100 x 80 px, but raw images .* 160 x 120"):
        Lens(WARPED)(torch.zeros(1, 3, 80, 100))


# ---------------------------------------------------------------- fit to the grid of markers

GRID = SensorDescription(
    "grid", (320, 240), (0.06, 0.06), GEL, MarkerGrid(9, 7, (2.0, 2.0), 0.6), frame_rate_hz=25.0
)  # fmt: skip
TRUE = SensorDescription(
    "true", (320, 240), (0.06, 0.06), GEL, GRID.markers, raw_size_px=(320, 240),
    intrinsics_px=(320.0, 320.0, 159.5, 119.5), distortion=(-0.25, 0.08, 0.0, 0.0),
    warp_corners_px=((6.0, 4.0), (311.0, 7.0), (314.0, 236.0), (3.0, 233.0)),
)  # fmt: skip


def raw_markers(seed: int = 3) -> np.ndarray:
    """Markers detected in a drawn raw image of a distorting camera."""
    face = GelSurface(np.zeros(GRID.shape), GRID.to_px(GRID.markers.positions_mm))
    with torch.no_grad():
        raw = Lens(TRUE).distort(batch(render(GRID, face, seed=seed)))[0].movedim(0, -1).numpy()
    return detect_markers(raw.round().astype(np.uint8), MarkerAppearance(9.0))


def test_the_grid_of_markers_shows_lens_and_warp() -> None:
    found = raw_markers()
    fitted = fit_lens(GRID, found)
    assert fitted.markers > 55
    assert fitted.start_px > 4.0
    assert fitted.rms_px < 0.15
    assert fitted.held_out_px < 0.25
    positions = torch.from_numpy(GRID.to_px(GRID.markers.positions_mm))
    with torch.no_grad():
        off = Lens(fitted.sensor).raw_positions(positions) - Lens(TRUE).raw_positions(positions)
    assert off.norm(dim=1).max() < 0.35


def test_markers_elsewhere_are_refused() -> None:
    with pytest.raises(ConfigError, match="markers are near their places, and 16 are needed"):
        fit_lens(GRID, raw_markers()[:10])
    bare = SensorDescription("bare", (320, 240), (0.06, 0.06), GEL)
    with pytest.raises(ConfigError, match="has no markers"):
        fit_lens(bare, raw_markers())
