"""Samples of a palpation: rows of a table by probe, without those that cannot be used."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import FileError
from tactorch.importers.quantities import PALPATION_UNITS, clean
from tactorch.importers.sheets import Sheet, read_sheet
from tactorch.importers.strokes import (
    find_mixed,
    find_places,
    find_steps,
    find_stroke,
    is_limited,
    lost_work,
)

_log = logging.getLogger(__name__)
_AXES = "xyz"
_REQUIRED = {
    "probe": "probe",
    **{a: f"{a}_mm" for a in _AXES},
    **{f"f{a}": f"f{a}_n" for a in _AXES},
}
# Names of times, the most certain first; "T" alone is a temperature.
_UNIT_OF_TIME = "(_(s|secs?|ms|us|ns|min))"
_TIMES = (rf"time{_UNIT_OF_TIME}?", rf"t{_UNIT_OF_TIME}",
          rf"(header_)?(time|timestamp|stamp|ros_time){_UNIT_OF_TIME}?", "t")  # fmt: skip
_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]*)?|[0-9]\.[0-9]+e[+-][0-9]{2}")  # also of savetxt
_SECONDS, _NANOSECONDS = re.compile(r"(.*_)?secs?"), re.compile(r"(.*_)?n(ano)?secs?")
MIN_SAMPLES = 4  # of a probe
#: Travel of a probe, over the ball's radius, below which it did not move.
MIN_TRAVEL = 0.05
_MAX_BACK = 0.01  # of the rows, before which a clock began again
_STILL = 0.01  # motion that is none, over the ball's radius
_RELAXED = 0.1  # fall of the force while balls are held, over its rise, from which it matters
_APART = 0.5  # distance of places along the surface, over the ball's radius
_UNIT = 0.2  # of the length of a unit normal, which rounding and averaging change
_MIN_UP = 0.05  # component of a normal along z, the axis of the height of the surface
_PRESSED = 5.0  # largest change of the force in contact, over its median
NAMED = 8  # probes that a message names


class Rows(NamedTuple):
    """Rows of a palpation, in the order of the file."""

    labels: np.ndarray  # of the probes, text; "" where there is none
    centres_mm: Float[np.ndarray, "s 3"]  # of the ball
    forces_n: Float[np.ndarray, "s 3"]  # on the ball
    lines: Sequence[str]  # what messages call each row
    time: Float[np.ndarray, " s"] | None = None  # in any unit
    contacts_mm: Float[np.ndarray, "s 3"] | None = None  # first contact of the row's probe
    normals: Float[np.ndarray, "s 3"] | None = None  # outward normal there

    def take(self, index: Int[np.ndarray, " k"]) -> "Rows":
        """Return some rows."""
        lines = [self.lines[i] for i in index]
        arrays: dict[str, Any] = {
            name: None if value is None else value[index]
            for name, value in self._asdict().items()
            if name != "lines"
        }
        return Rows(**arrays, lines=lines)

    def finite(self) -> "Rows":
        """Return the rows that have numbers of force and position, and a probe."""
        values = np.column_stack([self.centres_mm, self.forces_n])
        good = np.isfinite(values).all(axis=1) & (self.labels != "")
        return self.take(np.flatnonzero(good))

    def turned(self, turn: Float[np.ndarray, "3 3"], sign: float) -> "Rows":
        """Return the rows in turned axes, with a sign of the forces."""

        def of(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else values @ turn.T

        return self._replace(
            centres_mm=self.centres_mm @ turn.T, forces_n=sign * self.forces_n @ turn.T,
            contacts_mm=of(self.contacts_mm), normals=of(self.normals),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of probes while the ball is pressed in."""

    names: np.ndarray  # of the probes in the file, text
    normals: Float[np.ndarray, "probes 3"]  # outward unit normals
    origins_mm: Float[np.ndarray, "probes 3"]  # on their axes, where the samples begin
    lost: Float[np.ndarray, "probes 3"]  # work that is not given back, see `lost_work`
    radius_mm: float  # of the ball
    probe: Int[np.ndarray, " s"]  # index of the probe
    advance_mm: Float[np.ndarray, " s"]  # motion along minus the normal from the origin
    force_n: Float[np.ndarray, " s"]  # on the ball along the normal
    time: Float[np.ndarray, " s"]  # in any unit
    count: Float[np.ndarray, " s"]  # number of samples that were averaged
    left_out: Mapping[str, int] = field(default_factory=dict)  # number of rows, by the reason

    def keep(self, kept: Bool[np.ndarray, " s"], reason: str) -> "Samples":
        """Return some of the samples, and the probes that have any."""
        probes, inverse = np.unique(self.probe[kept], return_inverse=True)
        of_probes = ("names", "normals", "origins_mm", "lost")
        of_samples = ("advance_mm", "force_n", "time", "count")
        left = self.left_out.get(reason, 0) + int((~kept).sum())
        return replace(
            self, probe=inverse, left_out={**self.left_out, reason: left},
            **{name: getattr(self, name)[probes] for name in of_probes},
            **{name: getattr(self, name)[kept] for name in of_samples},
        )  # fmt: skip

    def reduced(self, depths: int | None, begin_mm: Float[np.ndarray, " probes"]) -> "Samples":
        """Return means over equal steps of the depth in contact, so many of each probe.

        The advance of a mean is that at which a ball on a half-space has the mean force.

        `depths` is their number, None for the samples themselves, and `begin_mm` the advance at
        which the contact of each probe begins.
        """
        samples = self.keep(self.advance_mm > begin_mm[self.probe], "in air")
        if depths is None:
            return samples
        depth = samples.advance_mm - begin_mm[samples.probe]
        low, high = np.full(len(begin_mm), np.inf), np.zeros(len(begin_mm))
        np.minimum.at(low, samples.probe, depth)
        np.maximum.at(high, samples.probe, depth)
        share = (depth - low[samples.probe]) / np.maximum(high - low, 1e-300)[samples.probe]
        key = samples.probe * depths + np.minimum(share * depths, depths - 1).astype(int)
        keys, part, count = np.unique(key, return_inverse=True, return_counts=True)

        def mean(values: np.ndarray) -> np.ndarray:
            return np.asarray(np.bincount(part, values) / count)

        probe = keys // depths
        return replace(
            samples, probe=probe, force_n=mean(samples.force_n), count=count * 1.0,
            advance_mm=begin_mm[probe] + mean(depth**1.5) ** (2.0 / 3.0), time=mean(samples.time),
        )  # fmt: skip


def read_rows(path: Path, columns: Mapping[str, str], units: Mapping[str, str]) -> Rows:
    """Read the rows of a table; see `assign` for columns and units."""
    sheet = read_sheet(path, "palpation")
    found = sheet.assigned(columns, units, PALPATION_UNITS)
    absent = [f"f{axis}" for axis in _AXES if f"f{axis}" not in found]
    lateral = absent if len(absent) == 2 else []  # of a load cell of one axis
    needed = {name: column for name, column in _REQUIRED.items() if name not in lateral}
    sheet.assigned(columns, units, PALPATION_UNITS, needed, "palpation")
    if lateral:
        _log.warning("'%s' has no %s and %s: they are taken as zero.", path, *lateral)
        (measured,) = found.keys() & {f"f{axis}" for axis in _AXES}
        found |= {name: (found[measured][0], 0.0) for name in lateral}

    def vectors(prefix: str) -> Float[np.ndarray, "s 3"] | None:
        names = [prefix + axis for axis in _AXES]
        if not found.keys() >= set(names):
            return None
        parts = [found[name] for name in names]
        return np.column_stack([f * sheet.numbers(name, finite=False) for name, f in parts])

    centres, forces = vectors(""), vectors("f")
    contacts, normals = vectors("contact_"), vectors("normal_")
    assert centres is not None
    assert forces is not None
    known = np.isfinite(np.column_stack([centres, forces])).any(axis=0)
    if not known.all():
        column = found[list(_REQUIRED)[1 + known.argmin()]][0]
        raise FileError(
            f"'{path}': the column {column!r} has no numbers; fill it in. Where one force only was "
            "measured, remove the columns of the others."
        )
    both = contacts is not None and normals is not None
    labels = np.array([_label(text) for text in sheet.texts(found["probe"][0])])
    return Rows(
        labels, centres, forces, sheet.lines, _time(sheet, labels),
        contacts if both else None, normals if both else None,
    )  # fmt: skip


def _label(text: str) -> str:
    """Return the name of a probe: a number in its shortest form, "" where it is missing."""
    if _NUMBER.fullmatch(text):
        return f"{float(text):.12g}"
    return "" if text.lower() == "nan" else text


def _time(sheet: Sheet, labels: np.ndarray) -> Float[np.ndarray, " s"] | None:
    """Return the times of the rows, in any unit; None where they are not known for all."""
    names = {"" if name == "T" else clean(name): name for name in sheet.columns}
    whole = [name for form in _TIMES for name in names if re.fullmatch(form, name)]
    parts = [[name for name in names if form.fullmatch(name)] for form in (_SECONDS, _NANOSECONDS)]
    try:
        if all(parts):
            seconds, nano = (sheet.numbers(names[part[0]], finite=False) for part in parts)
            times = seconds + 1e-9 * nano
        elif whole:
            times = sheet.numbers(names[whole[0]], finite=False)
        else:
            return None
    except FileError:  # such as a date
        return None
    backwards = (np.diff(times) < 0.0) & (labels[1:] == labels[:-1])
    if not np.isfinite(times).all() or (not all(parts) and whole[0] == "t" and backwards.any()):
        return None
    back = -np.minimum(np.diff(times, prepend=times[:1]), 0.0)
    # A clock that began again, unless the rows are in no order.
    return times + np.cumsum(back) if (back > 0.0).mean() < _MAX_BACK else times


def make_samples(path: Path, rows: Rows, radius_mm: float | None) -> Samples:
    """Return the samples of rows; rows and probes that cannot be used are left out, and named.

    The rows are in axes whose z points out of the object. A radius of None is the distance of the
    ball's centre from the contacts.
    """
    radius = radius_mm or _radius(path, rows)
    names, probe = _probes(path, rows, _APART * radius)
    left_out = {"apart from the others of their probe": int((probe < 0).sum())}
    order = np.arange(len(probe)) if rows.time is None else np.argsort(rows.time, kind="stable")
    order = order[np.argsort(probe[order], kind="stable")]
    order = order[probe[order] >= 0]
    strokes = _Strokes(rows.take(order), probe[order], names, radius, path)
    return strokes.samples(path, left_out)


def _probes(path: Path, rows: Rows, apart_mm: float) -> tuple[np.ndarray, Int[np.ndarray, " s"]]:
    """Return names of the probes, and the probe of each row; -1 for rows that are apart.

    Rows of a label at several places are several probes.
    """
    names: list[str] = []
    split: list[tuple[str, int, int]] = []
    probe = np.full(len(rows.labels), -1)
    for label in dict.fromkeys(rows.labels.tolist()):
        of_label = np.flatnonzero(rows.labels == label)
        places = find_places(rows.centres_mm[of_label, :2], apart_mm, MIN_SAMPLES)
        for place in range(places.max() + 1):
            probe[of_label[places == place]] = len(names)
            names.append(f"{label} ({place + 1})" if place else label)
        if places.max() > 0:
            first, second = (int(of_label[np.argmax(places == k)]) for k in (0, 1))
            split.append((label, first, second))
    if split:
        label, first, second = split[0]
        at = [", ".join(f"{x:.4g}" for x in rows.centres_mm[i, :2]) for i in (first, second)]
        _log.warning(
            "'%s': rows of %d probes are at more than one place, such as those of probe %s: %s at "
            "(%s) mm, %s at (%s) mm. Each place is taken as a probe ('%s', '%s (2)'); give each "
            "place a separate number if that is wrong.", path, len(split), label,
            rows.lines[first], at[0], rows.lines[second], at[1], label, label,
        )  # fmt: skip
    return np.array(names, dtype=object), probe


class _Strokes:
    """Rows by probe, in the order of time."""

    def __init__(
        self, rows: Rows, probe: Int[np.ndarray, " s"], names: np.ndarray, radius: float, path: Path
    ):
        self.rows, self.names, self.radius = rows, names, radius
        self.parts = np.split(np.arange(len(probe)), np.cumsum(np.bincount(probe))[:-1])
        up = np.array([[0.0, 0.0, 1.0]])
        first = [part[0] for part in self.parts]
        normals = np.repeat(up, len(names), 0) if rows.normals is None else rows.normals[first]
        if rows.normals is None:
            self._check_axis(path)
        still, timed = _STILL * radius, rows.time is not None
        lengths = np.linalg.norm(normals, axis=1)
        known = np.where((lengths > 1.0 - _UNIT)[:, None], normals, up)
        self.strokes = [
            find_stroke(rows.centres_mm[part], outward, still, timed)
            for part, outward in zip(self.parts, known, strict=True)
        ]
        self.pressed = [p[s.pressed] for p, s in zip(self.parts, self.strokes, strict=True)]
        self.limited, self.held = self._leave_limited(known, path), self._leave_held(known, path)
        centres = [rows.centres_mm[pressed] for pressed in self.pressed]
        self.origins, last = (np.array([c[i] for c in centres]) for i in (0, -1))
        self.travel = np.linalg.norm(last - self.origins, axis=1)
        self.unit = np.abs(lengths - 1.0) < _UNIT
        self.normals = normals / np.maximum(lengths, 1e-300)[:, None]
        if rows.normals is None:
            self._take_motion(centres, last)

    def _branches(
        self, outward: Float[np.ndarray, "probes 3"]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return advances (mm) and forces along the axis of the sensor nearest to the normal."""
        parts = zip(self.pressed, outward, np.abs(outward).argmax(axis=1), strict=True)
        centres, forces = self.rows.centres_mm, self.rows.forces_n
        return [(-centres[p] @ n, np.sign(n[axis]) * forces[p, axis]) for p, n, axis in parts]

    def _leave_held(self, outward: Float[np.ndarray, "probes 3"], path: Path) -> int:
        """Leave out the rows in which balls are held at several depths, if forces fall there."""
        steps = [find_steps(*pair, _STILL * self.radius) for pair in self._branches(outward)]
        fall, rise = sum(step[1] for step in steps), sum(step[2] for step in steps)
        if not 0.0 < _RELAXED * rise < fall or not all(s.ordered for s in self.strokes):
            return 0
        before = sum(map(len, self.pressed))
        self.pressed = [p[rows] for p, (rows, *_) in zip(self.pressed, steps, strict=True)]
        count = before - sum(map(len, self.pressed))
        _log.warning(
            "'%s': forces fall by %.0f %% of their rise while balls are held at a depth; these %d "
            "samples are left out.", path, 100.0 * fall / rise, count,
        )  # fmt: skip
        return count

    def _leave_limited(self, outward: Float[np.ndarray, "probes 3"], path: Path) -> int:
        """Leave out the rows of the loading branches that are at the limit of the force sensor."""
        before, branches = sum(map(len, self.pressed)), self._branches(outward)
        limits = {force.max() for way, force in branches if is_limited(way, force)}
        limited = [k for k, (_, f) in enumerate(branches) if f.max() in limits and np.ptp(f) > 0.0]
        for k in limited:
            self.pressed[k] = self.pressed[k][branches[k][1] < branches[k][1].max()]
        count = before - sum(map(len, self.pressed))
        if limited:
            _log.warning(
                "'%s': %d samples of %d probes are left out, as their force is at the limit of the "
                "sensor (%.3g N): %s. Press less deep there, or use a sensor of a larger range.",
                path, count, len(limited), np.abs(max(limits)), _named(self.names[limited]),
            )  # fmt: skip
        return count

    def _take_motion(
        self, centres: list[Float[np.ndarray, "_ 3"]], last: Float[np.ndarray, "probes 3"]
    ) -> None:
        """Take the direction of the motion as the normal, and origins on it.

        It is that of the second half of the motion: the first may lead to the place.
        """
        normals = np.array([c[np.argmax(_lower_half(c))] - c[-1] for c in centres])
        lengths = np.linalg.norm(normals, axis=1)
        self.normals = normals / np.maximum(lengths, 1e-300)[:, None]
        heights = ((self.origins - last) * self.normals).sum(axis=1)
        self.origins = last + heights[:, None] * self.normals
        self.unit = np.ones(len(normals), dtype=bool)

    def _check_axis(self, path: Path) -> None:
        """Refuse rows whose forces rise in another direction than downwards."""
        pushes = [np.zeros(3)]
        for part in self.parts:
            centres, forces = self.rows.centres_mm[part], self.rows.forces_n[part]
            change = np.linalg.norm(forces - np.median(forces, axis=0), axis=1)
            apart = centres[change.argmax()] - centres
            if change.max() > _PRESSED * np.median(change):
                pushes.append(apart[np.linalg.norm(apart, axis=1).argmax()])
        outward = -np.median(pushes[1:] or pushes, axis=0)
        length = float(np.linalg.norm(outward))
        if outward[2] < _MIN_UP * length:
            raise _wrong_axis(path, outward / length)

    def samples(self, path: Path, left_out: dict[str, int]) -> Samples:
        """Return the samples of probes that can be used."""
        usable = self._usable(path)
        lifted = [stroke.lifted for stroke in self.strokes]
        moved, pressed = sum(stroke.moved for stroke in self.strokes), sum(map(len, self.pressed))
        left_out["before the approach"] = moved
        left_out["at the limit of the force sensor"] = self.limited
        left_out["held while the force falls"] = self.held
        others = moved + pressed + self.limited + self.held
        left_out["lifted or pressed again"] = len(self.rows.labels) - others
        branches = [
            (self._branch(k, self.pressed[k]), self._branch(k, self.parts[k][lifted[k]]))
            for k in range(len(self.names))
        ]
        least = MIN_TRAVEL * self.radius
        lost = np.array([lost_work(*pair, least) for pair in branches])
        advance, force = (np.concatenate([pair[0][i] for pair in branches]) for i in (0, 1))
        times = self.rows.time
        if times is None:
            times = np.arange(float(len(self.rows.labels)))
        probe = np.repeat(np.arange(len(self.names)), [len(p) for p in self.pressed])
        times = times[np.concatenate(self.pressed)]
        samples = Samples(
            self.names, self.normals, self.origins, lost, self.radius, probe, advance, force,
            times, np.ones(len(force)), left_out,
        )  # fmt: skip
        return samples.keep(usable[probe], "of probes that cannot be used")

    def _branch(
        self, k: int, rows: Int[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Return the advances (mm) and forces (N) of rows of a probe."""
        advance = (self.origins[k] - self.rows.centres_mm[rows]) @ self.normals[k]
        return advance, self.rows.forces_n[rows] @ self.normals[k]

    def _usable(self, path: Path) -> Bool[np.ndarray, " probes"]:
        """Return which probes can be used, and name the others."""
        few = np.array([len(rows) < MIN_SAMPLES for rows in self.pressed])
        short, up = MIN_TRAVEL * self.radius, self.normals[:, 2] > _MIN_UP
        faults = {
            f"fewer than {MIN_SAMPLES} samples while the ball is pressed in": few,
            f"a travel of less than {short:.2g} mm": self.travel < short,
            "no unit normal": ~self.unit,
            "a normal that does not point upwards (z)": ~up,
        }
        usable, counts = np.ones(len(self.names), dtype=bool), {}
        for reason, faulty in faults.items():
            name_probes(path, self.names[faulty & usable], reason)
            counts[reason] = int((faulty & usable).sum())
            usable &= ~faulty
        if not usable.any():
            most = max(counts, key=counts.__getitem__)
            if "normal" in most:
                raise _wrong_axis(path, np.median(self.normals, axis=0))
            raise FileError(
                f"'{path}' has no probe that can be used: {counts[most]} of {len(usable)} have "
                f"{most}. All rows of a place have one number of the probe; check it, and the unit "
                "of each of x, y and z."
            )
        unordered = usable & ~np.array([stroke.ordered for stroke in self.strokes])
        if unordered.any():
            self._check_order(path, np.flatnonzero(unordered))
        return usable

    def _check_order(self, path: Path, probes: Int[np.ndarray, " k"]) -> None:
        """Report probes whose rows are sorted by their depth; refuse those with two branches."""
        share = find_mixed([self._branch(k, self.pressed[k]) for k in probes])
        if share:
            raise FileError(
                f"'{path}': the rows of {len(probes)} probes are in no order of time, and their "
                f"forces at one depth differ by about {100.0 * share:.0f} %: rows of a ball that is"
                " lifted are among them. Give a column 'time_s', or leave these rows out."
            )
        _log.warning(
            "'%s': the rows of %d probes are in no order of time, and are taken by their depth. "
            "Give a column 'time_s' if the ball is lifted in some of them.", path, len(probes),
        )  # fmt: skip


def _lower_half(centres: Float[np.ndarray, "p 3"]) -> Bool[np.ndarray, " p"]:
    """Return which rows are nearer to the last than half of the way."""
    apart = np.linalg.norm(centres - centres[-1], axis=1)
    return apart <= 0.5 * apart[0]


def _wrong_axis(path: Path, outward: Float[np.ndarray, "3"]) -> FileError:
    axis = int(np.abs(outward).argmax())
    up = f"{_AXES[axis]}{'+' if outward[axis] > 0 else '-'}"
    return FileError(
        f"'{path}' has no probe that can be used; see the warnings. Normals must point out of the "
        f"object, with z upwards; they are about ({', '.join(f'{x:.2g}' for x in outward)}). Balls "
        "that slide along the surface cannot be used."
        + f" If another axis points out of the object, give it, as format.up={up}."
        * (up != "z+")
    )


def _radius(path: Path, rows: Rows) -> float:
    """Return the distance of the ball's centre from the contacts, mm."""
    if rows.contacts_mm is None:
        raise FileError(
            f"'{path}' has no contacts that tell the radius of the ball; give format.radius_mm."
        )
    _, first = np.unique(rows.labels, return_index=True)
    distances = np.linalg.norm(rows.centres_mm[first] - rows.contacts_mm[first], axis=1)
    distances = distances[np.isfinite(distances) & (distances > 0.0)]
    if not len(distances):
        raise FileError(f"'{path}' has no contact; give format.radius_mm.")
    radius = float(np.median(distances))
    _log.info("The radius of the ball is %.3g mm by the contacts of the file.", radius)
    return radius


def name_probes(path: str | Path, names: np.ndarray, reason: str) -> None:
    """Log a warning about probes that are left out, where there are any."""
    if len(names):
        count = f"{len(names)} probes are" if len(names) > 1 else "1 probe is"
        _log.warning("'%s': %s left out, with %s: %s.", path, count, reason, _named(names))


def _named(names: np.ndarray) -> str:
    """Return names of probes, the first of many."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(f"'{name}'" for name in names[:NAMED]) + more
