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

    Args:
        radii_mm: Radii of the profiles, mm.
        poisson: Poisson's ratio.
    """
    first, second = radii_mm[..., :, None], radii_mm[..., None, :]
    inner, outer = np.minimum(first, second), np.maximum(first, second)
    compliance: np.ndarray = (
        (1.0 - poisson**2) * 3.0 / (4.0 * outer) * (1.0 - 0.2 * (inner / outer) ** 2)
    )
    return compliance


def contact_coefficients(
    compliance: Float[np.ndarray, "s k k"], depths: Float[np.ndarray, "s k"]
) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, "s k"]]:
    """Return the coefficients of profiles in contact, and their derivatives by the depth.

    The least energy over all sets of profiles that do not pull is that of the contact.

    Args:
        compliance: Compliance between profiles, one matrix for each press, mm/N.
        depths: Mean depth over each profile, mm; negative where the ball is clear of the body.

    Returns:
        Coefficients (N), and their derivatives by a depth common to all profiles (N/mm); both zero
        without contact.
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


def ball_force(depths_mm: Float[np.ndarray, " s"], ball_mm: float) -> Float[np.ndarray, " s"]:
    """Return the force on a rigid ball pressed into a half-space, over its plane-strain modulus.

    Linear elasticity without friction: I. N. Sneddon, Int. J. Engng Sci. 3, 1965, p. 47, which is
    Hertz's force for small depths. The unit is mm^2.

    Args:
        depths_mm: Depths, mm; there is no force where they are not positive.
        ball_mm: Radius of the ball.
    """
    ratios = np.linspace(0.0, _MAX_RATIO, 2000)[1:]  # of the radius of the contact to the ball's
    logs = np.log((1.0 + ratios) / (1.0 - ratios))
    depths = 0.5 * ball_mm * ratios * logs
    forces = 0.5 * ball_mm**2 * ((1.0 + ratios**2) * logs - 2.0 * ratios)
    # Force over depth^1.5 varies little.
    factors = np.interp(depths_mm, depths, forces / depths**1.5)
    force: np.ndarray = factors * np.maximum(depths_mm, 0.0) ** 1.5
    return force


def restriction_ratio(
    radii_mm: Float[np.ndarray, " k"], ball_mm: float, depths_mm: Float[np.ndarray, " s"]
) -> Float[np.ndarray, " s"]:
    """Return the force on a ball in a half-space over that by a sum of few profiles.

    Args:
        radii_mm: Radii of the profiles.
        ball_mm: Radius of the ball.
        depths_mm: Depths of the ball, mm; the ratio is one where it does not touch.

    Returns:
        The ratios, within 10 % of one: contacts much narrower than all profiles have small forces.
    """
    radii, _, weights = disc_rule()
    heights = np.sqrt(ball_mm**2 - (radii_mm[:, None] * radii) ** 2) - ball_mm
    means = depths_mm[:, None] + heights @ weights
    compliance = half_space_compliance(radii_mm, 0.0)
    many = np.broadcast_to(compliance, (len(means), *compliance.shape))
    forces = contact_coefficients(many, means)[0].sum(axis=1)
    touching = (depths_mm > 0.0) & (forces > 0.0)
    exact = ball_force(depths_mm, ball_mm)
    ratios = np.where(touching, exact / np.where(touching, forces, 1.0), 1.0)
    return np.clip(ratios, 1.0 / _MAX_CORRECTION, _MAX_CORRECTION)
