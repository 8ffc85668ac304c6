"""Samples of a palpation: read from a table, without those that cannot be used."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import FileError
from tactorch.importers.sheets import read_sheet

_log = logging.getLogger(__name__)
_POSITION = ("x_mm", "y_mm", "z_mm")
_FORCE = ("fx_n", "fy_n", "fz_n")
_CONTACT = ("contact_x_mm", "contact_y_mm", "contact_z_mm")
_NORMAL = ("normal_x", "normal_y", "normal_z")
MIN_SAMPLES = 4  # of a probe
#: Travel of a probe, over the ball's radius, below which it did not move.
MIN_TRAVEL = 0.05
_UNIT = 0.2  # of the length of a unit normal, which rounding and averaging change
_MIN_UP = 0.05  # component of a normal along z, the axis of the height of the surface
NAMED = 8  # probes that a message names


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of probes."""

    numbers: Int[np.ndarray, " probes"]  # of the probes in the file
    normals: Float[np.ndarray, "probes 3"]  # outward unit normals
    origins_mm: Float[np.ndarray, "probes 3"]  # on their axes, where the ball touches at most a bit
    radius_mm: float  # of the ball
    probe: Int[np.ndarray, " s"]  # index of the probe
    centres_mm: Float[np.ndarray, "s 3"]  # of the ball
    advance_mm: Float[np.ndarray, " s"]  # motion along minus the normal from the origin
    force_n: Float[np.ndarray, " s"]  # on the ball along the normal
    count: Float[np.ndarray, " s"]  # number of samples that were averaged

    def keep(self, kept: Bool[np.ndarray, " s"]) -> "Samples":
        """Return some of the samples, and the probes that have any."""
        probes, inverse = np.unique(self.probe[kept], return_inverse=True)
        return replace(
            self,
            numbers=self.numbers[probes], normals=self.normals[probes],
            origins_mm=self.origins_mm[probes], probe=inverse, centres_mm=self.centres_mm[kept],
            advance_mm=self.advance_mm[kept], force_n=self.force_n[kept], count=self.count[kept],
        )  # fmt: skip

    def reduced(self, depths: int | None) -> "Samples":
        """Return means of successive samples, so many of each probe."""
        if depths is None:
            return self
        order = np.lexsort((self.advance_mm, self.probe))
        sizes = np.bincount(self.probe)
        rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        parts = np.minimum(rank * depths // np.repeat(sizes, sizes), depths - 1)
        key = self.probe[order] * depths + parts
        keys, first, count = np.unique(key, return_index=True, return_counts=True)

        def mean(values: np.ndarray) -> np.ndarray:
            return (np.add.reduceat(values[order], first).T / count).T

        return replace(
            self, probe=keys // depths, centres_mm=mean(self.centres_mm),
            advance_mm=mean(self.advance_mm), force_n=mean(self.force_n), count=count * 1.0,
        )  # fmt: skip


def read_samples(path: Path, radius_mm: float | None, *, check_units: bool) -> Samples:
    """Read the samples of a file; see `make_samples`."""
    sheet, required = read_sheet(path, "palpation"), ("probe", *_POSITION, *_FORCE)
    missing = [name for name in required if name not in sheet.columns]
    if missing:
        raise FileError(
            f"'{path}' lacks the column {missing[0]!r}; its columns are "
            f"{', '.join(sheet.columns)}. A palpation needs {', '.join(required)}."
        )

    def columns(*names: str) -> Float[np.ndarray, "s k"]:
        return np.column_stack([sheet.numbers(name, finite=False) for name in names])

    has_surface = {*_CONTACT, *_NORMAL} <= set(sheet.columns)
    return make_samples(
        path, columns("probe")[:, 0], columns(*_POSITION), columns(*_FORCE), radius_mm,
        surface=(columns(*_CONTACT), columns(*_NORMAL)) if has_surface else None,
        check_units=check_units,
    )  # fmt: skip


def make_samples(
    path: Path,
    probes: Float[np.ndarray, " s"],
    centres: Float[np.ndarray, "s 3"],
    forces: Float[np.ndarray, "s 3"],
    radius_mm: float | None,
    *,
    surface: tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s 3"]] | None = None,
    check_units: bool,
) -> Samples:
    """Return the samples of rows; rows and probes that cannot be used are left out, and named.

    Args:
        path: Name of their file in messages.
        probes: Number of the probe of each row.
        centres: Centre of the ball, mm.
        forces: Force on the ball, N.
        radius_mm: Radius of the ball; None for the distance of its centre from the contacts.
        surface: First contact and outward normal of the probe of each row, where the file has them.
        check_units: Whether magnitudes that suggest a wrong unit are refused.
    """
    good = np.isfinite(np.column_stack([probes, centres, forces])).all(axis=1)
    if not good.all():
        count = (~good).sum()
        _log.warning("'%s': %d rows without a number in every column are left out.", path, count)
    probes, centres, forces = probes[good], centres[good], forces[good]
    if check_units:
        _check_units(path, centres, forces)
    numbers, first, probe = np.unique(probes, return_index=True, return_inverse=True)
    last = len(probes) - 1 - np.unique(probes[::-1], return_index=True)[1]
    origins, motion = centres[first], centres[last] - centres[first]
    travel = np.linalg.norm(motion, axis=1)
    normals = -motion / np.maximum(travel, 1e-300)[:, None]
    radius = radius_mm
    if surface is not None:
        contacts, normals = (values[good][first] for values in surface)
        if radius is None:
            radius = _radius(path, origins, contacts)
    if radius is None:
        raise FileError(
            f"'{path}' has no contacts that tell the radius of the ball; give format.radius_mm."
        )
    lengths = np.linalg.norm(normals, axis=1)
    faults = {
        f"fewer than {MIN_SAMPLES} samples": np.bincount(probe) < MIN_SAMPLES,
        f"a travel of less than {MIN_TRAVEL * radius:.2g} mm": travel < MIN_TRAVEL * radius,
        "no unit normal": ~(np.abs(lengths - 1.0) < _UNIT),
        "a normal that does not point upwards (z)": ~(normals[:, 2] > _MIN_UP * lengths),
    }
    usable = np.ones(len(numbers), dtype=bool)
    for reason, faulty in faults.items():
        name_probes(path, numbers[faulty & usable], reason)
        usable &= ~faulty
    if not usable.any():
        raise FileError(
            f"'{path}' has no probe that can be used; see the warnings. Normals must point out of "
            "the object, with z upwards."
        )
    normals = normals / np.maximum(lengths, 1e-300)[:, None]
    advance = -((centres - origins[probe]) * normals[probe]).sum(axis=1)
    force = (forces * normals[probe]).sum(axis=1)
    whole, ones = numbers.astype(int), np.ones(len(force))
    samples = Samples(whole, normals, origins, radius, probe, centres, advance, force, ones)
    return samples.keep(usable[probe])


def _check_units(
    path: Path, centres: Float[np.ndarray, "s 3"], forces: Float[np.ndarray, "s 3"]
) -> None:
    span = float(np.linalg.norm(np.ptp(centres, axis=0))) if len(centres) else 0.0
    largest = float(np.linalg.norm(forces, axis=1).max(initial=0.0))
    for found, value, unit, low, high in (
        ("positions span", span, "mm", 1.0, 1e4),
        ("forces reach", largest, "N", 1e-3, 1e3),
    ):
        if not low < value < high:
            raise FileError(
                f"'{path}': {found} {value:.3g} {unit}; another unit? Convert to {unit}, or pass "
                "format.check_units=false."
            )


def _radius(
    path: Path, starts: Float[np.ndarray, "probes 3"], contacts: Float[np.ndarray, "probes 3"]
) -> float:
    """Return the distance of the ball's centre from the contacts, mm."""
    distances = np.linalg.norm(starts - contacts, axis=1)
    distances = distances[np.isfinite(distances) & (distances > 0.0)]
    if not len(distances):
        raise FileError(f"'{path}' has no contact; give format.radius_mm.")
    radius = float(np.median(distances))
    _log.info("The radius of the ball is %.3g mm by the contacts of the file.", radius)
    return radius


def name_probes(path: str | Path, numbers: np.ndarray, reason: str) -> None:
    """Log a warning about probes that are left out, where there are any."""
    if len(numbers):
        shown = ", ".join(f"{n:g}" for n in numbers[:NAMED])
        more = f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else ""
        _log.warning("'%s': probes with %s are left out: %s%s.", path, reason, shown, more)
