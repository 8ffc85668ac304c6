"""Contact pressures of a rigid ball as sums of Hertz profiles.

A body of a linear material touches a frictionless ball where the complementary energy
1/2 c^T C c - c^T g is least over pressures that do not pull (J. J. Kalker, J. Inst. Maths
Applics 20, 1977, p. 199). Here the pressure is a sum of a few Hertz profiles of given radii around
the axis of the approach, with coefficients c >= 0 that are their resultants; C is the compliance
between profiles, and g the depth of the ball averaged over each.
"""

from itertools import product

import numpy as np
from jaxtyping import Bool, Float

_RINGS, _SPOKES = 5, 12  # quadrature points of a profile
_MAX_RATIO = 0.99  # of the radius of a contact to that of the ball
_MAX_CORRECTION = 1.1  # of a force for the restriction to few profiles
_PULL = 1e-12  # of a coefficient, over the largest, that is round-off


def disc_rule() -> tuple[
    Float[np.ndarray, " q"], Float[np.ndarray, "q 2"], Float[np.ndarray, " q"]
]:
    """Return a rule for means over a Hertz profile: radii, directions and weights.

    The profile has unit radius and resultant. With s the root of 1 - r^2 its mean of f is the
    integral of 3 s^2 f from 0 to 1.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    s = 0.5 * (nodes + 1.0)
    rings = 1.5 * weights * s**2
    # Turned from ring to ring, so that the points are not in line.
    turns = (np.arange(_SPOKES) + 0.5 * (np.arange(_RINGS) % 2)[:, None]) * 2.0 * np.pi / _SPOKES
    directions = np.stack([np.cos(turns), np.sin(turns)], axis=-1).reshape(-1, 2)
    radii = np.repeat(np.sqrt(1.0 - s**2), _SPOKES)
    return radii, directions, np.repeat(rings / rings.sum() / _SPOKES, _SPOKES)


def half_space_compliance(
    radii_mm: Float[np.ndarray, "*s k"], poisson: float
) -> Float[np.ndarray, "*s k k"]:
    """Return the compliance between Hertz profiles on a half-space of 1 MPa, mm/N.

    It is the displacement by one of unit resultant, averaged over the other: K. L. Johnson, Contact
    Mechanics, 1985, eq. (3.41a).
    """
    first, second = radii_mm[..., :, None], radii_mm[..., None, :]
    inner, outer = np.minimum(first, second), np.maximum(first, second)
    shared: np.ndarray = 1.0 - 0.2 * (inner / outer) ** 2
    return (1.0 - poisson**2) * 3.0 / (4.0 * outer) * shared


def contact_coefficients(
    compliance: Float[np.ndarray, "s k k"], depths: Float[np.ndarray, "s k"]
) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, "s k"]]:
    """Return the coefficients of profiles in contact, and their derivatives by a common depth.

    The least energy over all sets of profiles that do not pull is that of the contact. Without
    contact both are zero.

    Args:
        compliance: Compliance between profiles, one matrix for each press, mm/N.
        depths: Mean depth over each profile, mm; negative where the ball is clear of the body.
    """
    count, k = depths.shape
    best, found, rates = np.zeros(count), np.zeros((count, k)), np.zeros((count, k))
    for choice in product((False, True), repeat=k):
        used: Bool[np.ndarray, " k"] = np.array(choice)
        if not used.any():
            continue
        right = np.stack([depths[:, used], np.ones((count, int(used.sum())))], axis=-1)
        solution = np.linalg.solve(compliance[:, used][:, :, used], right)
        c = solution[..., 0]
        energy = -0.5 * np.einsum("sk,sk->s", c, depths[:, used])
        pushes = (c >= -_PULL * np.abs(c).max(axis=1, keepdims=True)).all(axis=1)
        better = np.flatnonzero(pushes & (energy < best))
        best[better] = energy[better]
        found[better], rates[better] = 0.0, 0.0
        found[np.ix_(better, used)] = c[better]
        rates[np.ix_(better, used)] = solution[better, :, 1]
    return found, rates


def _sneddon() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return radii of contact, depths (both over the ball's radius) and forces (over its square).

    Linear elasticity without friction; the force is over the plane-strain modulus: I. N. Sneddon,
    Int. J. Engng Sci. 3, 1965, p. 47. For small depths it is Hertz's.
    """
    radii = np.linspace(0.0, _MAX_RATIO, 2000)[1:]
    logs = np.log((1.0 + radii) / (1.0 - radii))
    return radii, 0.5 * radii * logs, 0.5 * ((1.0 + radii**2) * logs - 2.0 * radii)


_RADII, _DEPTHS, _FORCES = _sneddon()


def contact_radius(
    depths_mm: Float[np.ndarray, " s"], ball_mm: float | Float[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    """Return the radius of the contact of a rigid ball with a half-space, mm; see `ball_force`."""
    depths = np.maximum(depths_mm, 0.0) / ball_mm
    # Radius over the root of the depth varies little.
    radius: np.ndarray = np.interp(depths, _DEPTHS, _RADII / np.sqrt(_DEPTHS)) * np.sqrt(depths)
    return np.minimum(radius, _MAX_RATIO) * ball_mm


def ball_force(
    depths_mm: Float[np.ndarray, " s"], ball_mm: float | Float[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    """Return the force on a rigid ball pressed into a half-space, over its plane-strain modulus.

    By Sneddon (1965), without friction; Hertz's force for small depths. The unit is mm^2. There is
    no force where the depth is not positive.
    """
    depths = np.maximum(depths_mm, 0.0) / ball_mm
    # Force over depth^1.5 varies little.
    force: np.ndarray = np.interp(depths, _DEPTHS, _FORCES / _DEPTHS**1.5) * depths**1.5
    return force * ball_mm**2


def restriction_ratio(
    radii_mm: Float[np.ndarray, "s k"],
    ball_mm: Float[np.ndarray, " s"],
    depths_mm: Float[np.ndarray, " s"],
) -> Float[np.ndarray, " s"]:
    """Return the force on a ball in a half-space over that by a sum of few profiles.

    It is within 10 % of one, as contacts much narrower than all profiles have small forces, and one
    where the ball does not touch.
    """
    radii, _, weights = disc_rule()
    balls = ball_mm[:, None, None]
    heights = np.sqrt(balls**2 - (radii_mm[..., None] * radii) ** 2) - balls
    means = depths_mm[:, None] + heights @ weights
    forces = contact_coefficients(half_space_compliance(radii_mm, 0.0), means)[0].sum(axis=1)
    touching = (depths_mm > 0.0) & (forces > 0.0)
    exact = ball_force(depths_mm, ball_mm)
    ratios = np.where(touching, exact / np.where(touching, forces, 1.0), 1.0)
    return np.clip(ratios, 1.0 / _MAX_CORRECTION, _MAX_CORRECTION)
