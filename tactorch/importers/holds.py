"""The part of a grasp in which the gripper holds: where force and width belong together.

A robot reports widths at a lower rate than forces and later, so that rows of a moving gripper pair
a force with the width of an earlier time. Where the width is constant in rows of nearly the
largest force, these widths were reported while the gripper held, too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import Options, option
from tactorch.errors import FileError
from tactorch.importers.quantities import FORCES, LENGTHS
from tactorch.importers.sheets import read_sheet

#: Units of the columns of a grasp.
GRASP_UNITS = {"time": {"s": 1.0, "ms": 1e-3}, "force": FORCES, "width": LENGTHS}
_NAMES = {"time": "time_s", "force": "force_n", "width": "width_mm"}
_WINDOW_S = 0.1  # over which rates are taken
_QUIET = 0.15  # rate of the width over the largest of the closing gripper, below which it holds
# Force over the largest, above which it is firm: a width of another time is then that of a force
# which differs by a tenth at most.
_FIRM = 0.9
_MIN_ROWS = 4
_LAGS_S = 1.0  # largest lag of the widths
_MAX_N, _MAX_MM = 2e3, 1e3  # beyond which a unit is wrong


class GraspRows(NamedTuple):
    """Rows of a table of a grasp."""

    path: Path
    time_s: Float[np.ndarray, " k"]
    force_n: Float[np.ndarray, " k"]
    width_mm: Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Hold:
    """A closed gripper that does not move.

    Attributes:
        name: Name of its table.
        force_n, width_mm: Medians, N and mm.
        force_deviation_n, width_deviation_mm: Standard deviations of the rows.
        creep_mm: Change of the width from the first to the last row.
        lag_s: Time by which widths are later than forces.
        time_s: First and last time.
    """

    name: str
    force_n: float
    width_mm: float
    force_deviation_n: float
    width_deviation_mm: float
    creep_mm: float
    lag_s: float
    time_s: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class GraspColumns(Options):
    """Columns of a table of time, force and width of a gripper."""

    columns: dict[str, str] | None = option(
        None, "Columns of quantities that have other names, such as {width: gripper_width_mm}"
    )
    units: dict[str, str] | None = option(
        None, "Units of quantities, if not those of the names, such as {width: m}"
    )

    def hold(self, path: Path) -> Hold:
        """Return the longest time in which the gripper holds an object.

        Raises:
            FileError: the table cannot be used, or the gripper holds nothing; names the file.
        """
        sheet = read_sheet(path, "grasp")
        found = sheet.assigned(self.columns, self.units, GRASP_UNITS, _NAMES, "grasp")
        values = np.stack([found[n][1] * sheet.numbers(found[n][0]) for n in _NAMES])
        return find_hold(GraspRows(path, *values[:, np.isfinite(values).all(axis=0)]))


def find_hold(grasp: GraspRows) -> Hold:
    """Return the longest part of a grasp in which the width is constant and the force firm."""
    _check(grasp)
    path, time_s, force_n, width_mm = grasp
    rate = np.abs(_rate(time_s, width_mm))
    closing = rate[: int(width_mm.argmin()) + 1].max()
    first, last = _longest((rate <= _QUIET * closing) & (force_n >= _FIRM * force_n.max()))
    if last - first < _MIN_ROWS:
        raise FileError(
            f"'{path}': the width is constant in less than {_MIN_ROWS} rows of nearly the largest "
            "force; a moving gripper pairs forces with widths of another time. Hold the object for "
            "a second at the largest force."
        )
    rows = slice(first, last)
    return Hold(
        path.stem, float(np.median(force_n[rows])), float(np.median(width_mm[rows])),
        float(force_n[rows].std()), float(width_mm[rows].std()),
        float(width_mm[last - 1] - width_mm[first]), _lag(grasp),
        (float(time_s[first]), float(time_s[last - 1])),
    )  # fmt: skip


def _check(grasp: GraspRows) -> None:
    path, time_s, force_n, width_mm = grasp
    if len(time_s) <= _MIN_ROWS:
        raise FileError(
            f"'{path}': {len(time_s)} rows have a time, a force and a width; more than {_MIN_ROWS} "
            "are needed."
        )
    if (np.diff(time_s) <= 0.0).any():
        last = float(time_s[int((np.diff(time_s) <= 0.0).argmax())])
        raise FileError(f"'{path}': time does not rise after {last:g} s; remove repeated rows.")
    if not np.ptp(width_mm):
        raise FileError(f"'{path}': the width is {width_mm[0]:g} mm in all rows.")
    if force_n.max() <= 0.0:
        raise FileError(
            f"'{path}': the largest force is {force_n.max():.3g} N; forces of a closing gripper "
            "are positive: change their sign."
        )
    if force_n.max() > _MAX_N or np.abs(width_mm).max() > _MAX_MM:
        raise FileError(
            f"'{path}': forces reach {force_n.max():.3g} N and widths "
            f"{np.abs(width_mm).max():.3g} mm; state the units as in "
            '"format.units={force: mN, width: um}".'
        )


def _rate(time_s: Float[np.ndarray, " k"], values: Float[np.ndarray, " k"]) -> np.ndarray:
    """Return the change of values over a window about each time, 1/s."""
    half = 0.5 * _WINDOW_S
    later, earlier = (np.clip(time_s + sign * half, time_s[0], time_s[-1]) for sign in (1, -1))
    change = np.interp(later, time_s, values) - np.interp(earlier, time_s, values)
    return np.asarray(change / (later - earlier))


def _lag(grasp: GraspRows) -> float:
    """Return by how much later widths fall than forces rise, by their cross-correlation, s."""
    _, time_s, force_n, width_mm = grasp
    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    rise, fall = (
        _rate(even, sign * np.interp(even, time_s, values))
        for sign, values in ((1.0, force_n), (-1.0, width_mm))
    )
    steps = np.arange(min(int(_LAGS_S / step), len(even) - 2) + 1)
    products = [float(rise[: len(rise) - k] @ fall[k:]) for k in steps]
    return float(step * steps[int(np.argmax(products))])


def _longest(chosen: Bool[np.ndarray, " k"]) -> tuple[int, int]:
    """Return the first row of the longest run of chosen rows, and the one after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])
