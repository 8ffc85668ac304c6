"""First contacts of a palpation, found from the forces.

The force of a probe is that on a ball in a half-space, whose modulus and surface are unknown.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.errors import FileError
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers.offsets import MIN_CLEAR, Offsets, pool_offsets, without_drift
from tactorch.importers.samples import MIN_SAMPLES, MIN_TRAVEL, NAMED, Samples, name_probes

_log = logging.getLogger(__name__)
_MIN_COMMON = 20  # samples clear of the surface that tell a common offset of the force sensor
_RISES = 5.0  # standard deviations of the force by which it rises with the depth
_STEP, _MAX_STEPS, _FINE = 0.01, 400, 21  # of the search for contacts, over the ball's radius
_COMMON = 0.3  # deviation of the depth of the first sample among probes, over the ball's radius
# Median force of first samples, in standard deviations, from which they are in contact; deviation
# of this force among probes, over the force.
_CONTACT_NOISE, _THRESHOLD = 5.0, 0.05
_OUTLIER = 12.0  # distance of a sample from the others of its probe, over theirs
_MAX_OUTLIERS = 2  # of a probe, besides single samples far from those beside them
_BESIDE = range(1, 6)  # distances of the samples before and after one that predict its force
_ROUNDING = 1e-9  # of forces that were written as text, over the largest
_NEIGHBOURS = 16  # contacts, with their own, that tell whether the surface is flat


class Contacts(NamedTuple):
    """First contacts."""

    points_mm: Float[np.ndarray, "probes 3"]
    depth_mm: Float[np.ndarray, " probes"]  # of the ball at its origin
    plane_mpa: Float[np.ndarray, " probes"]  # modulus E / (1 - nu^2) of a half-space
    noise_n: float  # standard deviation of the noise of a sample
    offsets: Offsets  # of the force sensor, which the forces no longer have


def find_contacts(samples: Samples, noise_n: float | None, source: str) -> tuple[Samples, Contacts]:
    """Return the samples without offset and outliers, and the first contacts.

    The noise of a force is estimated where it is None; `source` is the name of the file.
    """
    noise = noise_n or _noise(samples)
    _check_sign(samples, noise, source)
    samples = _without_outliers(samples, noise, source)
    own = _clear_by_probe(samples)
    count = np.bincount(samples.probe, own)
    known = count >= MIN_CLEAR
    if known.mean() > 0.5 or count[known].sum() >= _MIN_COMMON:
        samples = without_drift(samples, own, noise, source)
        offsets = pool_offsets(samples, own, noise, source)
    else:
        offsets = _common_offset(samples, noise, source)
    samples = replace(samples, force_n=samples.force_n - offsets.force_n[samples.probe])
    depths = _first_depths(samples, noise)
    mixed, squares, _ = _sums(samples, depths)
    rises = mixed > _RISES * noise * np.sqrt(squares)
    samples = _rising(samples, rises, source)
    depths, plane = depths[rises], mixed[rises] / squares[rises]
    contacts = samples.origins_mm - (samples.radius_mm - depths)[:, None] * samples.normals
    offsets = Offsets(offsets.force_n[rises], offsets.deviation_n[rises], offsets.clear)
    return samples, Contacts(contacts, depths, plane, noise, offsets)


def hysteresis(samples: Samples) -> float | None:
    """Return the share of the work of pressing that lifting does not give back.

    It is the median of the probes; None where balls are not lifted in contact.
    """
    shares = []
    for k in np.flatnonzero(np.isfinite(samples.lost[:, 0])):
        lost_nmm, low, high = samples.lost[k]
        rows = np.flatnonzero(samples.probe == k)
        rows = rows[np.argsort(samples.advance_mm[rows])]
        grid = np.linspace(low, high, 100)
        force = np.interp(grid, samples.advance_mm[rows], samples.force_n[rows])
        work = float(np.trapezoid(force, grid))
        if work > 0.0:
            shares.append(lost_nmm / work)
    return float(np.median(shares)) if shares else None


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


def _clear_by_probe(samples: Samples) -> Bool[np.ndarray, " s"]:
    """Return which samples are clear of the surface, by the forces of their probe alone.

    The force of a probe is an offset and that of a ball in a half-space. A depth of the first
    sample is taken that fits best, with the offset and the modulus of each depth.
    """
    count = np.bincount(samples.probe)
    sum_force = np.bincount(samples.probe, samples.force_n)

    def costs(depths: Float[np.ndarray, " probes"]) -> Float[np.ndarray, " probes"]:
        mixed, squares, total = _sums(samples, depths)
        unit = ball_force(samples.advance_mm + depths[samples.probe], samples.radius_mm)
        sum_unit = np.bincount(samples.probe, unit)
        mixed = np.maximum(mixed - sum_unit * sum_force / count, 0.0)
        squares = np.maximum(squares - sum_unit**2 / count, 1e-300)
        explained: np.ndarray = mixed**2 / squares
        return total - sum_force**2 / count - explained

    travel = np.zeros(len(count))
    np.maximum.at(travel, samples.probe, samples.advance_mm)
    shares = np.linspace(-1.0, 0.0, _MAX_STEPS // 4)
    depths = _least(costs, travel * shares[:, None])
    return samples.advance_mm + depths[samples.probe] < -MIN_TRAVEL * samples.radius_mm


def _common_offset(samples: Samples, noise: float, source: str) -> Offsets:
    """Return the median force of samples clear of the surface, or zero where they are few.

    With the force of first samples as the offset, those are clear that are clear.
    """
    trial = replace(samples, force_n=samples.force_n - float(np.median(_end_forces(samples)[0])))
    depths = _first_depths(trial, noise)
    # By more than the uncertainty of the place of the surface.
    free = samples.advance_mm + depths[samples.probe] < -MIN_TRAVEL * samples.radius_mm
    clear, ones = int(free.sum()), np.ones(len(samples.names))
    if clear < _MIN_COMMON:
        _log.warning(
            "'%s' has %d samples that are clear of the surface, of %d that are needed: the offset "
            "of the force sensor is taken as zero.", source, clear, _MIN_COMMON,
        )  # fmt: skip
        return Offsets(0.0 * ones, 0.0 * ones, clear)
    offset = float(np.median(samples.force_n[free]))
    return Offsets(offset * ones, noise / np.sqrt(clear) * ones, clear)


def _noise(samples: Samples) -> float:
    """Estimate the noise of a force from second differences along each probe, N.

    Samples at equal steps are assumed; the curvature of the force adds to the noise. The median
    over probes hardly depends on those that end in something stiff.
    """
    order = np.lexsort((samples.advance_mm, samples.probe))
    force, probe = samples.force_n[order], samples.probe[order]
    second = force[2:] - 2.0 * force[1:-1] + force[:-2]
    same = probe[2:] == probe[:-2]
    second = second[same]
    noise = np.median(np.abs(second)) / 0.6745 if len(second) else 0.0
    # The median of forces in coarse steps is zero, but for rounding.
    if len(second) and noise < _ROUNDING * np.abs(force).max():
        noise = np.sqrt(np.mean(second**2))
    return max(float(noise) / np.sqrt(6.0), 1e-6)


def _first_depths(samples: Samples, noise: float) -> Float[np.ndarray, " probes"]:
    """Return the depth of the ball at each origin that fits the forces best, mm.

    A depth is negative where the origin is clear of the surface; the most frequent depth is then
    more probable than others. A robot that begins at its first contact does so at about the same
    force everywhere, by which stiff places are less deep.
    """
    radius, count = samples.radius_mm, len(samples.names)
    travel = float(samples.advance_mm.max(initial=0.0))
    steps = int(np.clip(np.ceil((travel + 0.5 * radius) / (_STEP * radius)), 2, _MAX_STEPS))
    grid = np.linspace(-travel, 0.5 * radius, steps)
    first = float(np.median(_end_forces(samples)[0]))
    pressed = first > _CONTACT_NOISE * noise / np.sqrt(count)

    def misfits(
        depths: Float[np.ndarray, " probes"],
    ) -> tuple[Float[np.ndarray, " probes"], Float[np.ndarray, " probes"]]:
        mixed, squares, total = _sums(samples, depths)
        moduli = np.maximum(mixed, 0.0) / np.maximum(squares, 1e-300)  # that fit the forces best
        return moduli, (total - moduli**2 * squares) / noise**2

    every = np.array([misfits(np.full(count, depth))[1] for depth in grid])
    common = grid[np.argmin(np.median(every, axis=1))]

    def costs(depths: Float[np.ndarray, " probes"]) -> Float[np.ndarray, " probes"]:
        moduli, misfit = misfits(depths)
        begins = moduli * ball_force(depths, radius)
        force = ((begins - first) / (_THRESHOLD * first)) ** 2 if pressed else 0.0
        place = 0.0 if pressed else ((depths - common) / (_COMMON * radius)) ** 2
        return misfit + force + place

    depths = _least(costs, np.repeat(grid[:, None], count, axis=1))
    near = (grid[1] - grid[0]) * np.linspace(-1.0, 1.0, _FINE)
    return _least(costs, depths + near[:, None])


def _end_forces(samples: Samples) -> Float[np.ndarray, "2 probes"]:
    """Return the forces of the samples of least and of largest advance of each probe, N."""
    order = np.lexsort((samples.advance_mm, samples.probe))
    _, first = np.unique(samples.probe[order], return_index=True)
    return samples.force_n[order[[first, np.append(first[1:], len(order)) - 1]]]


def _least(
    costs: Callable[[Float[np.ndarray, " probes"]], Float[np.ndarray, " probes"]],
    grid: Float[np.ndarray, "steps probes"],
) -> Float[np.ndarray, " probes"]:
    """Return the value of a grid with the least cost for each probe."""
    best = np.argmin([costs(values) for values in grid], axis=0)
    least: np.ndarray = np.take_along_axis(grid, best[None], axis=0)[0]
    return least


def _sums(samples: Samples, depths: Float[np.ndarray, " probes"]) -> Float[np.ndarray, "3 probes"]:
    """Return the sums over each probe of f u, u u and f f, of forces f (N).

    u are the forces on a half-space of unit plane-strain modulus at these depths, N/MPa.
    """
    force = samples.force_n
    unit = ball_force(samples.advance_mm + depths[samples.probe], samples.radius_mm)
    products = (unit * force, unit * unit, force * force)
    return np.array([np.bincount(samples.probe, p, len(samples.names)) for p in products])


def _without_outliers(samples: Samples, noise: float, source: str) -> Samples:
    """Leave out samples far from those beside them, or from a parabola through their probe's."""
    far = _spikes(samples, noise)
    for k in range(len(samples.names)):
        rows = np.flatnonzero((samples.probe == k) & ~far)
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
        named = np.unique(samples.names[samples.probe[far]].astype(str))
        _log.warning(
            "'%s': %d samples far from the others of their probe are left out, of probes %s.",
            source, far.sum(), ", ".join(map(str, named[:NAMED])),
        )  # fmt: skip
    return samples.keep(~far, "far from the others of their probe")


def _spikes(samples: Samples, noise: float) -> Bool[np.ndarray, " s"]:
    """Return which samples are far from those before and after them, whatever their share.

    The distance is that from the median of up to five lines through others, of which two spikes
    change less than half, over that of the samples beside it, which a bend of the force has, too.
    Lines are not continued into the air before the contact.
    """
    order = np.lexsort((samples.advance_mm, samples.probe))
    reach = 2 * max(_BESIDE)
    force = np.pad(samples.force_n[order], reach, constant_values=np.nan)
    probe = np.pad(samples.probe[order], reach, constant_values=-1)

    def beside(values: np.ndarray, k: int) -> np.ndarray:
        return np.where(np.roll(probe, k) == probe, np.roll(values, k), np.nan)

    def line(k: int) -> np.ndarray:
        before, after = beside(force, k), beside(force, -k)
        at_end = 2.0 * before - beside(force, 2 * k)
        return np.where(np.isnan(after), at_end, 0.5 * (before + after))

    lines = np.sort([line(k) for k in _BESIDE], axis=0)  # those that are not known come last
    middle = np.maximum(np.isfinite(lines).sum(axis=0) - 1, 0) // 2
    apart = np.abs(force - np.take_along_axis(lines, middle[None], axis=0)[0])
    around = np.sort([beside(apart, k) for k in (-2, -1, 1, 2)], axis=0)
    usual = np.maximum(np.where(np.isnan(around[2]), around[1], around[2]), noise)
    far = np.zeros(len(order), dtype=bool)
    far[order] = (apart > _OUTLIER * usual)[reach:-reach]
    return far


def _distances(
    advance: Float[np.ndarray, " k"], force: Float[np.ndarray, " k"], noise: float
) -> Float[np.ndarray, " k"]:
    """Return the distance of each sample from the parabola of the others, over their own.

    Distances from a least-squares fit to the others follow from that to all (by the leverages).
    """
    powers = np.vander((advance - advance.mean()) / max(np.ptp(advance), 1e-12), 3)
    inverse = np.linalg.pinv(powers)
    residual = force - powers @ (inverse @ force)
    left = np.maximum(1.0 - (powers * inverse.T).sum(axis=1), 1e-6)
    others = residual @ residual - residual**2 / left  # sum of squares without each
    spread = np.sqrt(np.maximum(others, 0.0) / max(len(force) - 4, 1))
    distances: np.ndarray = np.abs(residual) / left / np.maximum(spread, noise)
    return distances


def _check_sign(samples: Samples, noise: float, source: str) -> None:
    """Refuse forces that fall while the balls are pressed in."""
    first, last = _end_forces(samples)
    rise = float(np.median(last - first))
    if rise < -_CONTACT_NOISE * noise:
        raise FileError(
            f"'{source}': no probe's force rises with depth, it changes by {rise:.3g} N. If it is "
            "that on the object, not on the ball, give format.reverse_force=true."
        )


def _rising(samples: Samples, rises: Bool[np.ndarray, " probes"], source: str) -> Samples:
    """Leave out probes whose force does not rise with the depth."""
    name_probes(source, samples.names[~rises], "a force that does not rise, as without contact")
    if not rises.any():
        raise FileError(
            f"'{source}': no probe's force rises with depth: the balls do not touch, or the forces "
            "are not those on the ball, along the outward normal."
        )
    return samples.keep(rises[samples.probe], "of probes that cannot be used")
