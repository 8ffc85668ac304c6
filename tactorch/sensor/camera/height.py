"""Height of the face by fitting the rendered colours to an image (analysis by synthesis).

The height minimizes the squared residuals of the colours, with outliers weighted down, plus
deviations of its slopes from those of the look-up, of its Laplacian from zero, and of the height
from zero where the face is undeformed. Gauss-Newton steps solve the linearized problem by conjugate
gradients, preconditioned by cosine transforms.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Bool, Float

from tactorch.config import Options, option
from tactorch.linalg import conjugate_gradients
from tactorch.sensor.camera.gel_camera import image_places
from tactorch.sensor.camera.shading import Shading
from tactorch.sensor.depth import (
    HeightMap,
    divide_spectrum,
    find_contact,
    grid_laplacian,
    laplacian_eigenvalues,
)

_OUTLIER = 2.0  # residual over its deviation, from which a pixel counts as an outlier
_RTOL, _MAX_ITERATIONS = 1e-3, 300  # of conjugate gradients
_MIN_DECREASE = 1e-4  # of the cost, relative
_HALVINGS = 8

Image = Float[np.ndarray, "h w 3"]
Height = Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class HeightFitOptions(Options):
    """Weights of a fit of the height."""

    iterations: int = option(8, "Largest number of Gauss-Newton steps", ge=1)
    slope_deviation: float = option(0.15, "Standard deviation of the slopes from the look-up", gt=0)
    curvature_per_mm: float = option(
        2.0, "Standard deviation of the Laplacian of the height", unit="1/mm", gt=0
    )
    zero_deviation_mm: float = option(
        0.01, "Standard deviation of the height of the undeformed face", unit="mm", gt=0
    )


def fit_height(
    change: Image,
    shading: Shading,
    deviation: float,
    slopes: Float[np.ndarray, "h w 2"],
    start: HeightMap,
    mm_per_px: tuple[float, float],
    options: HeightFitOptions | None = None,
) -> HeightMap:
    """Return the height whose rendered colours fit an image.

    Args:
        change: Change of the colours, see `image_change`.
        shading: Light and colour response of the sensor.
        deviation: Standard deviation of the colours from those of the shading, in units of 50 gray
            values, see `LightFit`.
        slopes: dz/dx and dz/dy by the look-up.
        start: Height by the look-up, and the undeformed pixels.
        mm_per_px: Size of a pixel along x and y, mm.
        options: Weights.
    """
    problem = _Problem(
        change, shading, deviation, slopes, start.undeformed, mm_per_px,
        options or HeightFitOptions(),
    )  # fmt: skip
    height = start.height_mm.ravel()
    cost = problem.cost(height)
    for _ in range(problem.options.iterations):
        step = problem.step(height)
        fractions = [0.5**k for k in range(_HALVINGS)]
        found = next((f for f in fractions if problem.cost(height + f * step) < cost), None)
        if found is None:
            break
        height = height + found * step
        previous, cost = cost, problem.cost(height)
        if previous - cost < _MIN_DECREASE * previous:
            break
    fitted = height.reshape(start.height_mm.shape)
    contact = find_contact(fitted, start.undeformed)
    return replace(start, height_mm=fitted, zero_mean_mm=fitted - fitted.mean(), contact=contact)


@dataclass(eq=False)
class _Problem:
    """Cost of a height, (pixels,), and its Gauss-Newton steps."""

    change: Image
    shading: Shading
    deviation: float
    lookup: Float[np.ndarray, "h w 2"]
    undeformed: Bool[np.ndarray, "h w"]
    mm_per_px: tuple[float, float]
    options: HeightFitOptions

    def __post_init__(self) -> None:
        self.shape, self.zero = self.undeformed.shape, self.undeformed.ravel()
        self.colours = torch.from_numpy(np.ascontiguousarray(self.change)).reshape(-1, 3)
        self.slopes = self.lookup.reshape(-1, 2)
        self.places = image_places(torch.zeros(self.shape, dtype=torch.float64)).reshape(-1, 2)
        size = float(self.mm_per_px[0]), float(self.mm_per_px[1])
        self.by_x, self.by_y = _derivatives(self.shape, size)
        self.laplacian = grid_laplacian(self.shape, size)  # its sign does not matter
        self.eigenvalues = laplacian_eigenvalues(self.shape, size)

    def cost(self, height: np.ndarray) -> float:
        """Half the negative logarithm of the posterior, up to a constant."""
        slopes = self._slopes(height)
        with torch.no_grad():
            rendered = self.shading.change(torch.from_numpy(slopes), self.places)
        squares = ((rendered - self.colours) / self.deviation).square().sum(dim=1).numpy()
        colours = _OUTLIER**2 * np.log1p(squares / _OUTLIER**2).sum()
        options = self.options
        by_lookup = ((slopes - self.slopes) ** 2).sum() / options.slope_deviation**2
        smooth = ((self.laplacian @ height) ** 2).sum() / options.curvature_per_mm**2
        level = (height[self.zero] ** 2).sum() / options.zero_deviation_mm**2
        return float(colours + by_lookup + smooth + level)

    def step(self, height: np.ndarray) -> np.ndarray:
        """Gauss-Newton step, with the weights of outliers at this height."""
        slopes, options = self._slopes(height), self.options
        with torch.no_grad():
            colours, by_slope = self.shading.linearize(torch.from_numpy(slopes), self.places)
        residual = (colours - self.colours).numpy() / self.deviation
        jacobian = by_slope.numpy() / self.deviation
        weight = 1.0 / (1.0 + (residual**2).sum(axis=1) / _OUTLIER**2)
        prior = 1.0 / options.slope_deviation**2
        hessian = np.einsum("nca,ncb,n->nab", jacobian, jacobian, weight) + prior * np.eye(2)
        gradient = np.einsum("nca,nc,n->na", jacobian, residual, weight)
        gradient += prior * (slopes - self.slopes)
        smooth, level = 1.0 / options.curvature_per_mm**2, 1.0 / options.zero_deviation_mm**2

        def apply(v: np.ndarray) -> np.ndarray:
            along = np.stack([self.by_x @ v, self.by_y @ v], axis=-1)
            flux = np.einsum("nab,nb->na", hessian, along)
            stiff = self.by_x.T @ flux[:, 0] + self.by_y.T @ flux[:, 1]
            bent = smooth * (self.laplacian.T @ (self.laplacian @ v))
            return np.asarray(stiff + bent + level * np.where(self.zero, v, 0.0))

        mean = float(np.median(np.trace(hessian, axis1=1, axis2=2))) / 2.0
        shift = max(level * float(self.zero.mean()), 1e-9 * mean)
        spectrum = mean * self.eigenvalues + smooth * self.eigenvalues**2 + shift

        def precondition(v: np.ndarray) -> np.ndarray:
            return divide_spectrum(v.reshape(self.shape), spectrum).ravel()

        force = self.by_x.T @ gradient[:, 0] + self.by_y.T @ gradient[:, 1]
        force = force + smooth * (self.laplacian.T @ (self.laplacian @ height))
        force = force + level * np.where(self.zero, height, 0.0)
        # An inexact step is a step, too: its length is searched.
        solved = conjugate_gradients(
            apply, precondition, -force, rtol=_RTOL, max_iterations=_MAX_ITERATIONS
        )
        return solved.solution

    def _slopes(self, height: np.ndarray) -> np.ndarray:
        return np.stack([self.by_x @ height, self.by_y @ height], axis=-1)


@lru_cache(maxsize=4)
def _derivatives(
    shape: tuple[int, int], mm_per_px: tuple[float, float]
) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Derivatives along x and y, 1/mm."""
    (rows, columns), (x, y) = shape, mm_per_px
    by_x = sp.kron(sp.eye(rows), _differences(columns) / x).tocsr()
    return by_x, sp.kron(_differences(rows) / y, sp.eye(columns)).tocsr()


def _differences(n: int) -> sp.csr_matrix:
    """Central differences, one-sided at the ends, as `numpy.gradient`."""
    matrix = sp.diags([-0.5, 0.5], [-1, 1], shape=(n, n)).tolil()
    matrix[0, :2] = matrix[-1, -2:] = [-1.0, 1.0]
    return matrix.tocsr()
