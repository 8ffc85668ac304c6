"""From what the camera gives to the image of the gel: no distortion, warped square, cropped."""

from collections.abc import Callable

import numpy as np

from tactorch.errors import FileError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.image import Image


def rectifier(sensor: SensorDescription) -> Callable[[Image, str], Image]:
    """Return a function that rectifies an image of a name; its maps are worked out once.

    The function raises `FileError` for images of another size than the sensor's.
    """
    steps = [*_undistorted(sensor), *_warped(sensor), *_cropped(sensor)]
    raw, own = tuple(sensor.raw_size_px or ()), tuple(sensor.image_size_px)

    def rectify(image: Image, name: str) -> Image:
        size = (image.shape[1], image.shape[0])
        if size == own and (size != raw or not steps):
            return image  # it has been rectified before
        if size != raw:
            also = "" if raw == own else f", or rectified {own[0]} x {own[1]}"
            raise FileError(
                f"{name} is {size[0]} x {size[1]} px, but the sensor '{sensor.name}' gives"
                f" {raw[0]} x {raw[1]}{also}; check image_size_px and raw_size_px."
            )
        for step in steps:
            image = step(image)
        return np.ascontiguousarray(image)

    return rectify


Step = Callable[[Image], Image]


def _undistorted(sensor: SensorDescription) -> list[Step]:
    if sensor.intrinsics_px is None:
        return []
    import cv2

    fx, fy, cx, cy = map(float, sensor.intrinsics_px)
    matrix = np.array([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])
    lens = np.array(sensor.distortion, dtype=float) if len(sensor.distortion) else np.zeros(4)
    assert sensor.raw_size_px is not None
    size = (sensor.raw_size_px[0], sensor.raw_size_px[1])
    x, y = cv2.initUndistortRectifyMap(matrix, lens, np.eye(3), matrix, size, cv2.CV_32FC1)
    return [lambda image: cv2.remap(image, x, y, cv2.INTER_LINEAR)]


def _warped(sensor: SensorDescription) -> list[Step]:
    if sensor.warp_corners_px is None:
        return []
    import cv2

    width, height = sensor.warped_size
    corners = np.array(sensor.warp_corners_px, dtype=np.float32)
    square = np.array(
        [(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)], dtype=np.float32
    )
    matrix = cv2.getPerspectiveTransform(corners, square)
    return [lambda image: cv2.warpPerspective(image, matrix, (width, height))]


def _cropped(sensor: SensorDescription) -> list[Step]:
    if sensor.crop_px is None:
        return []
    left, top, width, height = sensor.crop_px
    return [lambda image: image[top : top + height, left : left + width]]
