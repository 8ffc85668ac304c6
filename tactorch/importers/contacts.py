"""First contacts of a palpation, found from the forces.

The force of a probe is that on a ball in a half-space, whose modulus and surface are unknown.
"""

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.errors import FileError
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers.samples import MIN_SAMPLES, MIN_TRAVEL, NAMED, Samples, name_probes

_log = logging.getLogger(__name__)
_MIN_CLEAR = 20  # samples clear of the surface that tell the offset of the force sensor
_STEPS = 60  # of the search for the first contact, within the ball's radius
_COMMON = 0.3  # deviation of the depth of the first sample among probes, over the ball's radius
# Median force of first samples, in standard deviations, from which they are in contact; deviation
# of this force among probes, over the force.
_CONTACT_NOISE, _THRESHOLD = 5.0, 0.05
_OUTLIER = 12.0  # distance of a sample from the others of its probe, over theirs
_MAX_OUTLIERS = 2  # of a probe
_NEIGHBOURS = 16  # contacts, with their own, that tell whether the surface is flat


class Contacts(NamedTuple):
    """First contacts."""

    points_mm: Float[np.ndarray, "probes 3"]
    depth_mm: Float[np.ndarray, " probes"]  # of the ball at its origin
    noise_n: float  # standard deviation of the noise of a sample
    tare_n: float  # offset of the force sensor, which the forces no longer have
    clear: int  # number of samples that are clear of the surface


def find_contacts(samples: Samples, noise_n: float | None, source: str) -> tuple[Samples, Contacts]:
    """Return the samples without offset and outliers, and the first contacts.

    The noise of a force is estimated where it is None; `source` is the name of the file.
    """
    noise = noise_n or _noise(samples)
    samples = _without_outliers(samples, noise, source)
    tare, clear = _offset(samples, noise)
    if clear < _MIN_CLEAR:
        _log.warning(
            "'%s' has %d samples that are clear of the surface, of %d that are needed: the offset "
            "of the force sensor is taken as zero.", source, clear, _MIN_CLEAR,
        )  # fmt: skip
        tare = 0.0
    samples = replace(samples, force_n=samples.force_n - tare)
    samples, depths = _rising(samples, _first_depths(samples, noise), noise, source)
    contacts = samples.origins_mm - (samples.radius_mm - depths)[:, None] * samples.normals
    return samples, Contacts(contacts, depths, noise, tare, clear)


def unevenness(points: Float[np.ndarray, "probes 3"]) -> Float[np.ndarray, " probes"]:
    """Return deviations of contacts from a smooth surface through those nearby, mm.

    At a step, a groove or the foot of a slope a ball touches elsewhere than in the model, which has
    a smooth surface. The value of a contact is the root mean square distance of the nearest ones
    from a paraboloid through them; zero for a few contacts only.
    """
    if len(points) <= _NEIGHBOURS:
        return np.zeros(len(points))
    near = points[cKDTree(points).query(points, _NEIGHBOURS)[1]]
    apart = near - near.mean(axis=1, keepdims=True)
    x, y, z = np.moveaxis(apart @ np.linalg.svd(apart, full_matrices=False)[2].swapaxes(1, 2), 2, 0)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2))
    left = z - np.einsum("pnk,pmk,pm->pn", basis, basis, z)
    deviations: np.ndarray = np.sqrt((left * left).sum(axis=1) / (_NEIGHBOURS - basis.shape[2]))
    return deviations


def _offset(samples: Samples, noise: float) -> tuple[float, int]:
    """Return the median force of samples clear of the surface (N), and their number.

    With the force of first samples as the offset, those are clear that are clear.
    """
    trial = replace(samples, force_n=samples.force_n - float(np.median(_first_forces(samples))))
    depths = _first_depths(trial, noise)
    # By more than the uncertainty of the place of the surface.
    free = samples.advance_mm + depths[samples.probe] < -MIN_TRAVEL * samples.radius_mm
    return (float(np.median(samples.force_n[free])) if free.any() else 0.0), int(free.sum())


def _noise(samples: Samples) -> float:
    """Estimate the noise of a force from second differences along each probe, N.

    Samples at equal steps are assumed; the curvature of the force adds to the noise. The median
    over probes hardly depends on those that end in something stiff.
    """
    order = np.lexsort((samples.advance_mm, samples.probe))
    force, probe = samples.force_n[order], samples.probe[order]
    second = force[2:] - 2.0 * force[1:-1] + force[:-2]
    same = probe[2:] == probe[:-2]
    return float(max(np.median(np.abs(second[same])) / (0.6745 * np.sqrt(6.0)), 1e-6))


def _first_depths(samples: Samples, noise: float) -> Float[np.ndarray, " probes"]:
    """Return the depth of the ball at each origin that fits the forces best, mm.

    A depth is negative where the origin is clear of the surface; the most frequent depth is then
    more probable than others. A robot that begins at its first contact does so at about the same
    force everywhere, by which stiff places are less deep.
    """
    radius, count = samples.radius_mm, len(samples.numbers)
    travel = np.zeros(count)
    np.maximum.at(travel, samples.probe, samples.advance_mm)
    grid = np.linspace(-float(np.median(travel)), 0.5 * radius, 2 * _STEPS)
    sums = np.array([_sums(samples, np.full(count, depth)) for depth in grid])
    mixed, squares, total = sums.swapaxes(0, 1)
    moduli = np.maximum(mixed, 0.0) / np.maximum(squares, 1e-300)  # that fit the forces best
    costs = (total - moduli**2 * squares) / noise**2
    first = float(np.median(_first_forces(samples)))
    if first > _CONTACT_NOISE * noise / np.sqrt(count):
        begins = moduli * ball_force(grid, radius)[:, None]
        prior = ((begins - first) / (_THRESHOLD * first)) ** 2
    else:
        common = grid[np.argmin(np.median(costs, axis=1))]
        prior = (((grid - common) / (_COMMON * radius)) ** 2)[:, None]
    depths: np.ndarray = grid[np.argmin(costs + prior, axis=0)]
    return depths


def _first_forces(samples: Samples) -> Float[np.ndarray, " probes"]:
    """Return the force of the sample of least advance of each probe, N."""
    order = np.lexsort((samples.advance_mm, samples.probe))
    _, first = np.unique(samples.probe[order], return_index=True)
    return samples.force_n[order[first]]


def _sums(samples: Samples, depths: Float[np.ndarray, " probes"]) -> Float[np.ndarray, "3 probes"]:
    """Return the sums over each probe of f u, u u and f f, of forces f (N).

    u are the forces on a half-space of unit plane-strain modulus at these depths, N/MPa.
    """
    force = samples.force_n
    unit = ball_force(samples.advance_mm + depths[samples.probe], samples.radius_mm)
    products = (unit * force, unit * unit, force * force)
    return np.array([np.bincount(samples.probe, p, len(samples.numbers)) for p in products])


def _without_outliers(samples: Samples, noise: float, source: str) -> Samples:
    """Leave out samples that are far from a parabola through the others of their probe."""
    far = np.zeros(len(samples.probe), dtype=bool)
    for k in range(len(samples.numbers)):
        rows = np.flatnonzero(samples.probe == k)
        for _ in range(_MAX_OUTLIERS):
            if len(rows) <= MIN_SAMPLES:
                break
            ratios = _distances(samples.advance_mm[rows], samples.force_n[rows], noise)
            worst = int(np.argmax(ratios))
            if ratios[worst] < _OUTLIER:
                break
            far[rows[worst]] = True
            rows = np.delete(rows, worst)
    if far.any():
        named = np.unique(samples.numbers[samples.probe[far]])
        _log.warning(
            "'%s': %d samples far from the others of their probe are left out, of probes %s.",
            source, far.sum(), ", ".join(map(str, named[:NAMED])),
        )  # fmt: skip
    return samples.keep(~far)


def _distances(
    advance: Float[np.ndarray, " k"], force: Float[np.ndarray, " k"], noise: float
) -> Float[np.ndarray, " k"]:
    """Return the distance of each sample from the parabola of the others, over their own.

    Distances from a least-squares fit to the others follow from that to all (by the leverages).
    """
    powers = np.vander((advance - advance.mean()) / max(np.ptp(advance), 1e-12), 3)
    hat = powers @ np.linalg.pinv(powers)
    residual = force - hat @ force
    left = np.maximum(1.0 - np.diag(hat), 1e-6)
    others = residual @ residual - residual**2 / left  # sum of squares without each
    spread = np.sqrt(np.maximum(others, 0.0) / max(len(force) - 4, 1))
    distances: np.ndarray = np.abs(residual) / left / np.maximum(spread, noise)
    return distances


def _rising(
    samples: Samples, depths: Float[np.ndarray, " probes"], noise: float, source: str
) -> tuple[Samples, Float[np.ndarray, " probes"]]:
    """Leave out probes whose force does not rise with the depth."""
    mixed, squares, _ = _sums(samples, depths)
    flat = ~(mixed > 3.0 * noise * np.sqrt(squares))
    name_probes(source, samples.numbers[flat], "a force that does not rise")
    if flat.all():
        raise FileError(
            f"'{source}': no probe's force rises with depth; give the force on the ball in N, along"
            " the outward normal."
        )
    return samples.keep(~flat[samples.probe]), depths[~flat]
