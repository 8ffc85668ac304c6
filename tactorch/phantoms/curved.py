"""Objects of curved outline: those of Fig. 4(e) to (g), 5(c) and 12.

They stand on the plane z = 0; lengths in mm, moduli in MPa.
"""

import numpy as np

from tactorch.mesh import Cylinder, Hemisphere, Hyperboloid, Lathe, Sphere
from tactorch.mesh.values import Real, positive
from tactorch.phantoms.background import RandomField
from tactorch.phantoms.phantom import HOLE_MPA, Phantom

_SOFT, _HARD = 0.2, 1.0


def cylinder_sphere(
    depth: Real = 0.4,
    radius: Real = 0.2,
    diameter_mm: Real = 10.0,
    height_mm: Real = 10.0,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """An upright cylinder with a ball; depth in heights, radius in diameters."""
    wide, high = positive("diameter_mm", diameter_mm), positive("height_mm", height_mm)
    body = Cylinder((wide / 2, wide / 2, high / 2), wide / 2, high)
    ball = Sphere((wide / 2, wide / 2, high * (1.0 - float(depth))), float(radius) * wide)
    return Phantom(body, [(ball, inclusion_mpa)], youngs_mpa)


def cylinder_hole_sphere(
    diameter_mm: Real = 12.0,
    height_mm: Real = 10.0,
    radius: Real = 0.14,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
    hole_mpa: Real = HOLE_MPA,
) -> Phantom:
    """A cylinder with a hole and a ball side by side (Fig. 4e); radius of both in diameters."""
    wide, high = positive("diameter_mm", diameter_mm), positive("height_mm", height_mm)
    body = Cylinder((wide / 2, wide / 2, high / 2), wide / 2, high)
    r = float(radius) * wide
    hole = Sphere((0.28 * wide, wide / 2, 0.6 * high), r)
    ball = Sphere((0.72 * wide, wide / 2, 0.6 * high), r)
    return Phantom(body, [(hole, hole_mpa), (ball, inclusion_mpa)], youngs_mpa)


def hyperboloid_sphere(
    waist_mm: Real = 3.5,
    rim_mm: Real = 5.0,
    height_mm: Real = 10.0,
    radius_mm: Real = 2.0,
    height: Real = 0.6,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A hyperboloid with a ball on its axis (Fig. 4f), at `height` of its own height."""
    rim, high = positive("rim_mm", rim_mm), positive("height_mm", height_mm)
    body = Hyperboloid((rim, rim, high / 2), waist_mm, rim, high)
    ball = Sphere((rim, rim, float(height) * high), radius_mm)
    return Phantom(body, [(ball, inclusion_mpa)], youngs_mpa)


def hemisphere_spheres(
    radius_mm: Real = 10.0,
    count: int = 4,
    ball: Real = 0.2,
    distance: Real = 0.55,
    height: Real = 0.4,
    youngs_mpa: Real = _SOFT,
    inclusion_mpa: Real = _HARD,
) -> Phantom:
    """A hemisphere on its flat side with balls in a ring (Fig. 4g).

    Args:
        radius_mm: Of the hemisphere.
        count: Of the balls.
        ball: Their radius; this and what follows in radii of the hemisphere.
        distance: Of their centres from its axis.
        height: Of their centres above the flat side.
        youngs_mpa: Of the hemisphere.
        inclusion_mpa: Of the balls.
    """
    r = positive("radius_mm", radius_mm)
    angles = 2.0 * np.pi * np.arange(count) / count
    spots = [
        (np.cos(a) * float(distance), np.sin(a) * float(distance), float(height)) for a in angles
    ]
    balls = [(Sphere(r * np.array(spot), float(ball) * r), inclusion_mpa) for spot in spots]
    return Phantom(Hemisphere((0.0, 0.0, 0.0), r), balls, youngs_mpa)


def hemisphere_random(
    radius_mm: Real = 10.0, median_mpa: Real = 0.3, spread: Real = 0.5, seed: int = 5
) -> Phantom:
    """A hemisphere of a smooth random field (as Fig. 5c); see `RandomField`."""
    r = positive("radius_mm", radius_mm)
    field = RandomField(median_mpa, spread, 0.4 * r, seed)
    return Phantom(Hemisphere((0.0, 0.0, 0.0), r), (), field)


def hemisphere_two_spheres(
    radius_mm: Real = 10.0, youngs_mpa: Real = 0.1, inclusion_mpa: Real = 0.5
) -> Phantom:
    """A hemisphere with two balls, one shallow and one deeper (Fig. 12a)."""
    r = positive("radius_mm", radius_mm)
    shallow = Sphere((0.45 * r, 0.0, 0.45 * r), 0.28 * r)
    deep = Sphere((-0.4 * r, 0.15 * r, 0.38 * r), 0.28 * r)
    parts = [(shallow, inclusion_mpa), (deep, inclusion_mpa)]
    return Phantom(Hemisphere((0.0, 0.0, 0.0), r), parts, youngs_mpa)


def toy_two_spheres(
    height_mm: Real = 20.0, youngs_mpa: Real = _SOFT, inclusion_mpa: Real = _HARD
) -> Phantom:
    """A toy figure, belly and head on a flat base, with a ball in either (as Fig. 12b)."""
    h = positive("height_mm", height_mm)
    body = Lathe((0.0, 0.0, 0.0), h * _toy_outline())
    belly, head = (
        Sphere((0.1 * h, 0.0, 0.3 * h), 0.12 * h),
        Sphere((0.0, 0.05 * h, 0.76 * h), 0.09 * h),
    )
    return Phantom(body, [(belly, inclusion_mpa), (head, inclusion_mpa)], youngs_mpa)


def _toy_outline() -> np.ndarray:
    """A belly cut flat below and a head above it, meeting in a neck; of height 1."""
    belly, head = (0.36, 0.34), (0.24, 0.76)  # radius, height of the centre
    outline = [(0.0, 0.0)]
    for radius, middle in (belly, head):
        angles = np.linspace(-np.pi / 2, np.pi / 2, 65)
        arc = np.column_stack((radius * np.cos(angles), middle + radius * np.sin(angles)))
        other = head if (radius, middle) == belly else belly
        outside = np.hypot(arc[:, 0], arc[:, 1] - other[1]) >= other[0]
        kept = arc[outside & (arc[:, 1] > 0) & (arc[:, 0] > 1e-9)]
        if middle == belly[1]:
            kept = np.concatenate(([(np.sqrt(radius**2 - middle**2), 0.0)], kept))
        outline += [tuple(point) for point in kept]
    return np.array([*outline, (0.0, 1.0)])
