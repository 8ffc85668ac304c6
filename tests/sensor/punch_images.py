"""Images of a flat-ended punch pressed into a gel, its outline known to the last digit."""

import numpy as np
from scipy import fft
from scipy.sparse.linalg import LinearOperator, cg

from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.render import GelSurface, RenderOptions, render

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(24.0, 18.0))


def sensor(x: float = 0.06, y: float = 0.06, markers: bool = False) -> SensorDescription:
    """A sensor of 320 x 240 px."""
    grid = MarkerGrid(9, 7, (2.1, 2.1), 0.6) if markers else None
    return SensorDescription("punched", (320, 240), (x, y), GEL, grid)


def rotated(corners_mm: np.ndarray, turn_deg: float, middle_mm: tuple[float, float]) -> np.ndarray:
    """Corners in the sensor's frame."""
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    return corners_mm @ np.array([(c, s), (-s, c)]) + middle_mm


def outside_mm(one: SensorDescription, corners_mm: np.ndarray) -> np.ndarray:
    """Distance of each pixel from a convex polygon that goes round from x to y; 0 within it."""
    rows, columns = np.indices(one.shape)
    places = one.to_mm(np.stack([columns, rows], axis=-1).astype(float))
    inside, near = np.ones(one.shape, dtype=bool), np.full(one.shape, np.inf)
    for a, b in zip(corners_mm, np.roll(corners_mm, -1, axis=0), strict=True):
        away, along = places - a, b - a
        inside &= along[0] * away[..., 1] - along[1] * away[..., 0] >= 0
        t = np.clip((away @ along) / (along @ along), 0, 1)
        near = np.minimum(near, np.linalg.norm(away - t[..., None] * along, axis=-1))
    return np.where(inside, 0.0, near)


def decaying(one: SensorDescription, corners_mm: np.ndarray, depth_mm: float = 0.5) -> np.ndarray:
    """Heights that die away outside the punch."""
    return -depth_mm * np.exp(-outside_mm(one, corners_mm) / 0.8)


def half_space(one: SensorDescription, corners_mm: np.ndarray, depth_mm: float = 0.5) -> np.ndarray:
    """Heights of an elastic half-space under a flat frictionless punch (Boussinesq, 1885).

    Pressure within the outline is found so that all of it sinks alike; outside, the face slopes
    infinitely at the edge.
    """
    x, y = (float(size) for size in one.mm_per_px)
    under = outside_mm(one, corners_mm) == 0.0
    rows, columns = one.shape
    across = np.minimum(np.arange(2 * columns), 2 * columns - np.arange(2 * columns)) * x
    along = np.minimum(np.arange(2 * rows), 2 * rows - np.arange(2 * rows)) * y
    distance = np.hypot(along[:, None], across)
    distance[0, 0] = np.sqrt(x * y) / 3.5255  # mean of 1/r over a square pixel
    waves = fft.rfft2(1.0 / distance)

    def sunk(pressure: np.ndarray) -> np.ndarray:
        return fft.irfft2(waves * fft.rfft2(pressure, distance.shape))[:rows, :columns]

    def applied(inner: np.ndarray) -> np.ndarray:
        pressure = np.zeros(one.shape)
        pressure[under] = inner
        return sunk(pressure)[under]

    count = int(under.sum())
    matrix = LinearOperator((count, count), applied, dtype=float)
    inner, failed = cg(matrix, np.ones(count), rtol=1e-4, maxiter=200)
    assert not failed
    pressure = np.zeros(one.shape)
    pressure[under] = inner
    return -depth_mm * sunk(pressure)


def image(one: SensorDescription, height_mm: np.ndarray, seed: int) -> np.ndarray:
    """The image of such heights."""
    places = np.zeros((0, 2)) if one.markers is None else one.markers.positions_mm
    return render(
        one, GelSurface(height_mm, one.to_px(places)), RenderOptions(noise=1.5), seed=seed
    )


def still(one: SensorDescription) -> np.ndarray:
    """The gel without contact."""
    return image(one, np.zeros(one.shape), 999)
