"""Rigid indenters on a bonded elastic layer, without friction: the exact solution at small strain.

A layer of thickness h is bonded to a rigid base. Under a pressure whose Hankel transform is P(k)
the displacement of its surface is the inverse transform of 2 (1 - nu^2) / (E k) L(k h) P(k), with

    L(x) = (2 q sinh 2x - 4x) / (2 q cosh 2x + 4x^2 + 1 + q^2),   q = 3 - 4 nu

(Vorovich, Aleksandrov and Babeshko, 1974). With P(k) = int_0^a phi(t) cos(k t) dt the pressure is
zero beyond the radius a, and an indenter's shape leads to a Fredholm equation of the second kind
(Lebedev and Ufliand, 1958; Hayes, Keer, Herrmann and Mockros, 1972), solved here by Gauss-Legendre
quadrature. For h much larger than a, the limits are 2 E a d / (1 - nu^2) (punch) and Hertz
(sphere).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0

_NODES = 48  # of quadrature over the contact
_WAVES = 400  # of quadrature over k h, up to where 1 - L is zero
_LAST = 40.0


@dataclass(frozen=True)
class Layer:
    """A bonded layer.

    Attributes:
        thickness_mm: h.
        youngs_mpa: E.
        poisson: nu, below 0.5.
    """

    thickness_mm: float
    youngs_mpa: float
    poisson: float

    @property
    def plane_mpa(self) -> float:
        """E / (1 - nu^2)."""
        return self.youngs_mpa / (1.0 - self.poisson**2)


@dataclass(frozen=True, eq=False)
class Indented:
    """An indenter in a layer.

    Attributes:
        layer: The layer.
        radius_mm: Of the contact.
        depth_mm: Of the indenter's tip.
        force_n: Total.
        places_mm: Nodes t of the quadrature.
        shares: Values of phi there times the weights, N.
    """

    layer: Layer
    radius_mm: float
    depth_mm: float
    force_n: float
    places_mm: np.ndarray
    shares: np.ndarray

    def sinks_mm(self, away_mm: np.ndarray) -> np.ndarray:
        """How far the surface sinks at distances from the axis, beyond the contact."""
        k, weights = _waves(self.layer.thickness_mm)
        transform = np.cos(np.outer(k, self.places_mm)) @ self.shares
        missing = (factor(k * self.layer.thickness_mm, self.layer.poisson) - 1.0) * weights
        near = self.shares / np.sqrt(away_mm[:, None] ** 2 - self.places_mm**2)
        thin = j0(np.outer(away_mm, k)) @ (missing * transform)
        return 2.0 / self.layer.plane_mpa * (near.sum(axis=1) + thin)


def flat_punch(layer: Layer, radius_mm: float, depth_mm: float) -> Indented:
    """Press a flat round punch in."""
    t, weights = _places(radius_mm)
    phi = _solved(layer, t, weights, np.full(len(t), depth_mm))
    return _indented(layer, radius_mm, depth_mm, t, weights * phi)


def sphere(layer: Layer, sphere_mm: float, depth_mm: float) -> Indented:
    """Press a paraboloid of a sphere's radius in, as Hertz took it."""

    def left(radius: float) -> float:
        """The depth at which the pressure ends smoothly at a radius, less the wanted one."""
        return _smooth_depth(layer, sphere_mm, radius) - depth_mm

    radius = brentq(left, 1e-6 * sphere_mm, np.sqrt(2.2 * sphere_mm * depth_mm), rtol=1e-9)
    t, weights = _places(radius)
    phi = _solved(layer, t, weights, depth_mm - t**2 / sphere_mm)
    return _indented(layer, radius, depth_mm, t, weights * phi)


def half_space_punch_n(layer: Layer, radius_mm: float, depth_mm: float) -> float:
    """Force on a flat round punch in a half space: 2 E a d / (1 - nu^2)."""
    return 2.0 * layer.plane_mpa * radius_mm * depth_mm


def hertz_n(layer: Layer, sphere_mm: float, depth_mm: float) -> float:
    """Force on a sphere in a half space (Hertz)."""
    return 4.0 / 3.0 * layer.plane_mpa * np.sqrt(sphere_mm) * depth_mm**1.5


def dimitriadis(chi: float) -> float:
    """Force on a sphere in a bonded layer of nu = 0.5 over Hertz's, chi = sqrt(R d) / h.

    Dimitriadis et al., Biophysical Journal 82:2798 (2002), eq. 13; low by 3 % at chi = 0.3 already.
    """
    return 1.0 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4


def garcia(chi: float) -> float:
    """The same by Garcia and Garcia, Biophysical Journal 114:2923 (2018)."""
    return 1.0 + 1.133 * chi + 1.497 * chi**2 + 1.469 * chi**3 + 0.755 * chi**4


def factor(x: np.ndarray, poisson: float) -> np.ndarray:
    """L(x), how much less a layer sinks than a half space under a wave of 2 pi h / x."""
    q = 3.0 - 4.0 * poisson
    e = np.exp(-2.0 * x)
    return (q * (1 - e**2) - 4 * x * e) / (q * (1 + e**2) + e * (4 * x**2 + 1 + q**2))


def _places(radius_mm: float) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * radius_mm * (x + 1), 0.5 * radius_mm * w


def _waves(thickness_mm: float) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(_WAVES)
    return 0.5 * _LAST / thickness_mm * (x + 1), 0.5 * _LAST / thickness_mm * w


def _solved(layer: Layer, t: np.ndarray, weights: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve phi + 2/pi K phi = E / (pi (1 - nu^2)) right, K from 1 - L."""
    k, w = _waves(layer.thickness_mm)
    waves = np.cos(np.outer(t, k))
    missing = (factor(k * layer.thickness_mm, layer.poisson) - 1.0) * w
    kernel = 2.0 / np.pi * (waves * missing) @ waves.T
    return np.linalg.solve(np.eye(len(t)) + kernel * weights, layer.plane_mpa / np.pi * right)


def _smooth_depth(layer: Layer, sphere_mm: float, radius_mm: float) -> float:
    """Depth at which the pressure under a sphere falls to zero at a contact radius."""
    t, weights = _places(radius_mm)
    ends = []
    for right, edge in ((np.ones(len(t)), 1.0), (-(t**2) / sphere_mm, -(radius_mm**2) / sphere_mm)):
        phi = _solved(layer, t, weights, right)
        ends.append(_at_edge(layer, t, weights * phi, radius_mm, edge))
    return -ends[1] / ends[0]


def _at_edge(
    layer: Layer, t: np.ndarray, shares: np.ndarray, radius_mm: float, right: float
) -> float:
    """Continue phi to the contact's edge by its own equation."""
    k, w = _waves(layer.thickness_mm)
    missing = (factor(k * layer.thickness_mm, layer.poisson) - 1.0) * w
    kernel = 2.0 / np.pi * (np.cos(k * radius_mm) * missing) @ np.cos(np.outer(k, t))
    return layer.plane_mpa / np.pi * right - float(kernel @ shares)


def _indented(
    layer: Layer, radius_mm: float, depth_mm: float, t: np.ndarray, shares: np.ndarray
) -> Indented:
    force = 2.0 * np.pi * float(shares.sum())
    return Indented(layer, radius_mm, depth_mm, force, t, shares)
