"""Fitting the map between a flat face in mm and its corners in pixels, over several images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from tactorch.errors import ConfigError
from tactorch.sensor.scale.shape import KnownShape, Outline

_OWN = 3  # unknowns of each image: a turn and a place


@dataclass(frozen=True, eq=False)
class Plane:
    """A map from pixels to mm: X = S u / (1 + p u), u being pixels from a middle.

    Attributes:
        terms: ln of the scales along x and y; where it is tilted, also the shear over their mean
            and the two of p, times the middle's distance from the edges.
        middle_px: Where X is 0.
    """

    terms: Float[np.ndarray, " terms"]
    middle_px: Float[np.ndarray, "2"]

    @property
    def scale(self) -> Float[np.ndarray, "2"]:
        """Size of a pixel in the middle along x and y, mm."""
        return np.exp(self.terms[:2])

    def to_px(self, places_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Turn places in mm into pixels."""
        x, y = self.scale
        shear, px, py = self.terms[2:] if len(self.terms) > 2 else (0.0, 0.0, 0.0)
        straight = np.array([(x, shear * np.sqrt(x * y)), (0.0, y)])
        lean = np.array([px, py]) / float(self.middle_px.max())
        matrices = straight - places_mm[:, :, None] * lean
        return np.linalg.solve(matrices, places_mm[:, :, None])[..., 0] + self.middle_px


@dataclass(frozen=True, eq=False)
class Fit:
    """A plane, and how well it fits.

    Attributes:
        plane: The map.
        covariance: Of its terms.
        residuals_px: Of each image's corners.
        freedom: Numbers measured less unknowns.
    """

    plane: Plane
    covariance: Float[np.ndarray, "terms terms"]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    freedom: int

    @property
    def residual_px(self) -> float:
        """Root mean square distance of a corner from where it should be."""
        return float(np.sqrt((np.concatenate(self.residuals_px) ** 2).sum(axis=1).mean()))


def fit_plane(
    outlines: Sequence[Outline],
    shape: KnownShape,
    aspect: float,
    middle_px: Float[np.ndarray, "2"],
    *,
    tilted: bool = False,
) -> Fit:
    """Fit one plane to the corners of a shape in some images, wherever it lies in each.

    Args:
        outlines: Corners in each image.
        shape: What was pressed.
        aspect: About the size of a pixel along y over that along x, which tells the sides of a
            cuboid apart.
        middle_px: Middle of the images.
        tilted: Whether it may be sheared and seen in perspective.

    Raises:
        ConfigError: There are too few corners for as many unknowns.
    """
    paired = [_paired(outline, shape, aspect) for outline in outlines]
    terms = 5 if tilted else 2
    freedom = sum(2 * len(own) for own, _ in paired) - terms - _OWN * len(paired)
    if freedom < 1:
        raise ConfigError(
            f"a {shape.name} in {len(paired)} image tells too little: {freedom + terms} numbers for"
            f" {terms} unknowns; give more images, with the {shape.name} turned and moved."
        )
    start = np.zeros(terms)
    sizes = [abs(pose[0]) for _, pose in paired]
    start[:2] = -np.log(float(np.mean(sizes))) + np.array([0.0, np.log(aspect)])
    middle = np.asarray(middle_px, dtype=float)
    values = [start]
    for own, pose in paired:
        place = (own.mean(axis=0) - middle) * np.exp(start[:2])
        values.append(np.array([np.angle(pose[0]), *place]))

    def off(x: Float[np.ndarray, " x"]) -> Float[np.ndarray, " y"]:
        plane = Plane(x[:terms], middle)
        poses = x[terms:].reshape(-1, _OWN)
        parts = [
            plane.to_px(_posed(shape.corners, pose)) - own
            for (own, _), pose in zip(paired, poses, strict=True)
        ]
        return np.concatenate(parts).ravel()

    found = least_squares(off, np.concatenate(values), x_scale="jac", xtol=1e-12, ftol=1e-12)
    variance = max(
        float(found.fun @ found.fun) / freedom,
        float(np.mean([outline.deviation_px**2 for outline in outlines])),
    )
    spread = variance * np.linalg.pinv(found.jac.T @ found.jac)[:terms, :terms]
    cuts = np.cumsum([len(own) for own, _ in paired])[:-1]
    residuals = tuple(np.split(found.fun.reshape(-1, 2), cuts))
    return Fit(Plane(found.x[:terms], middle), spread, residuals, freedom)


def _posed(
    corners: Float[np.ndarray, "n 2"], pose: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    c, s = np.cos(pose[0]), np.sin(pose[0])
    return corners @ np.array([(c, s), (-s, c)]) + pose[1:]


def _paired(
    outline: Outline, shape: KnownShape, aspect: float
) -> tuple[Float[np.ndarray, "n 2"], tuple[complex, complex]]:
    """Corners in the shape's order, and the similarity that takes the shape nearest to them."""
    outline.require(shape)
    own = shape.corners[:, 0] + 1j * shape.corners[:, 1]
    best, found = np.inf, None
    for shift in range(len(own)):
        corners = np.roll(outline.corners_px, -shift, axis=0)
        z = corners[:, 0] + 1j * corners[:, 1] * aspect
        factor = complex(np.vdot(own, z - z.mean()) / np.vdot(own, own))
        misfit = float(np.linalg.norm(z - z.mean() - factor * own))
        if misfit < best * (1 - 1e-9):
            best, found = misfit, (corners, (factor, complex(z.mean())))
    assert found is not None
    return found
