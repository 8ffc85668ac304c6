"""The differentiable camera: it draws what NumPy and OpenCV draw, and its gradients are right."""

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from tactorch.sensor.camera import GelCamera, Shading, face_slopes
from tactorch.sensor.camera.gel_camera import cast_shadow, marker_coverage
from tactorch.sensor.render import Lamps

from .numpy_renderer import covered, illuminated, shadow

SIZE = (0.1, 0.12)


def heights() -> np.ndarray:
    """A dent and a flat imprint with steep sides."""
    y, x = np.mgrid[:70, :90]
    dent = 1.2 * np.exp(-((x - 50.0) ** 2 + (y - 30.0) ** 2) / 150.0)
    return -dent - 0.3 * ((x > 10) & (x < 25) & (y > 45) & (y < 60))


def drawn(camera: GelCamera, *height: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        return camera(torch.from_numpy(np.stack(height))).movedim(1, -1).numpy()


def small_camera(**settings: object) -> GelCamera:
    """Everything at once, for images of a few pixels."""
    shading = Shading(
        (10.0, 130.0), 40.0, ((150.0, 20.0, 15.0), (20.0, 160.0, 25.0)), (40.0,) * 3, 0.2
    )
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for name in ("diffuse", "mixing", "gamma"):
            parameter = getattr(shading, name)
            noise = torch.rand(parameter.shape, generator=generator, dtype=torch.float64)
            parameter += 0.1 * noise
    return GelCamera(shading, (0.2, 0.25), marker_diameter_mm=0.7, **settings)


def test_a_batch_is_drawn_as_numpy_draws_each_image() -> None:
    lamps = Lamps(shadow=0.0)
    camera = GelCamera(lamps.shading(), SIZE)
    faces = heights(), 0.5 * heights()[::-1]
    for image, face in zip(drawn(camera, *faces), faces, strict=True):
        np.testing.assert_allclose(image, illuminated(lamps, face, SIZE), atol=1e-9)


def test_shadows_are_those_of_opencv_to_its_interpolation() -> None:
    """OpenCV rounds positions to a 32nd of a pixel: 3 gray values at edges, 0.02 on average."""
    lamps = Lamps()
    (image,) = drawn(GelCamera(lamps.shading(), SIZE, shadow=lamps.shadow), heights())
    difference = np.abs(image - illuminated(lamps, heights(), SIZE))
    assert difference.max() < 5.0
    assert difference.mean() < 0.02
    direction = np.array([np.cos(0.6), 0.0, -np.sin(0.6)])
    expected = shadow(heights(), direction, SIZE)
    angles = (torch.tensor(v, dtype=torch.float64) for v in (0.0, 0.6))
    dark = cast_shadow(torch.from_numpy(heights())[None], *angles, torch.tensor(SIZE))[0]
    assert expected.max() == 1.0
    assert np.abs(dark.numpy() - expected).mean() < 1e-3


def test_slopes_are_those_of_numpy() -> None:
    slopes = face_slopes(torch.from_numpy(heights())[None], torch.tensor(SIZE))[0].numpy()
    expected = np.gradient(heights(), SIZE[1], SIZE[0])
    np.testing.assert_allclose(slopes[..., 0], expected[1], atol=1e-6)
    np.testing.assert_allclose(slopes[..., 1], expected[0], atol=1e-6)


def test_markers_cover_what_they_cover_one_by_one(rng: np.random.Generator) -> None:
    centers = rng.uniform(-3, 63, (2, 12, 2))
    radius = (3.0, 2.4)
    images = marker_coverage(
        torch.from_numpy(centers), torch.tensor(radius, dtype=torch.float64), (50, 60)
    )
    for image, positions in zip(images.numpy(), centers, strict=True):
        # Beyond the window of a marker its blurred edge is below a thousandth.
        np.testing.assert_allclose(image, covered(positions, radius, (50, 60)), atol=1e-3)


def test_gradients_by_height_and_markers() -> None:
    camera = small_camera(blur_px=0.7)
    generator = torch.Generator().manual_seed(1)
    height = 0.1 * torch.rand(2, 6, 7, generator=generator, dtype=torch.float64)
    markers = torch.tensor([[(2.2, 3.1), (5.3, 1.2)]] * 2, dtype=torch.float64)
    inputs = height.requires_grad_(), markers.requires_grad_()
    assert gradcheck(camera, inputs)


def test_gradients_through_shadows() -> None:
    """Where the lamps stand low, a step casts shadows on the face beside it."""
    height = torch.zeros(1, 6, 9, dtype=torch.float64)
    height[:, 2:4, 4:6] = -0.31
    height += 0.01 * torch.rand(height.shape, generator=torch.Generator().manual_seed(2))
    shading = Shading((0.0,), 20.0, ((200.0, 150.0, 100.0),))
    camera = GelCamera(shading, (0.1, 0.1), shadow=0.6)
    assert cast_shadow(height, *shading.azimuth, *shading.elevation, camera.mm_per_px).max() > 0.2
    assert gradcheck(camera, (height.requires_grad_(),))


@pytest.mark.parametrize(
    "name",
    ["azimuth", "elevation", "colours", "ambient", "falloff", "diffuse", "mixing", "gamma"],
)
def test_gradients_by_the_light_and_the_response(name: str) -> None:
    camera = small_camera()
    generator = torch.Generator().manual_seed(1)
    height = 0.1 * torch.rand(1, 5, 6, generator=generator, dtype=torch.float64)

    def images(value: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(camera, {f"shading.{name}": value}, (height,))

    assert gradcheck(images, (getattr(camera.shading, name).detach().requires_grad_(),))


def test_gradients_by_the_size_of_a_pixel() -> None:
    camera = small_camera()
    height = 0.1 * torch.rand(1, 5, 6, dtype=torch.float64, generator=torch.Generator())
    markers = torch.tensor([[(2.2, 3.1)]], dtype=torch.float64)

    def images(size: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(camera, {"mm_per_px": size}, (height, markers))

    assert gradcheck(images, (camera.mm_per_px.detach().requires_grad_(),))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_the_camera_runs_on_a_gpu() -> None:
    camera = small_camera(shadow=0.5)
    height = torch.from_numpy(heights())[None]
    expected = camera(height)
    torch.testing.assert_close(camera.to("cuda")(height.cuda()).cpu(), expected)
