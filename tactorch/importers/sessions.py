"""Presses of a continuous session: when a ball is pressed in, from its positions and forces.

A press begins up to `approach_mm` before the force rises, while the ball moves along the later
push, and ends where the ball is deepest. What follows is left out: materials have hysteresis.
"""

import logging
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.config import Options, option
from tactorch.errors import FileError
from tactorch.importers.samples import MIN_SAMPLES

_log = logging.getLogger(__name__)
_MIN_REST = 10  # samples from which offset and noise are estimated
_SIGNIFICANT = 8.0  # standard deviations of a force above which the ball touches
_SMALLEST_N = 1e-3  # of that force
_MERGE_S = 0.1  # loss of contact that does not end a press
_END = 0.98  # of the deepest advance, at which a press ends
_ASIDE = 0.2  # motion aside over motion along, up to which the approach belongs to a press
_PER_PRESS = 64  # samples that remain of a press at most, as means over equal steps of its motion


class Session(NamedTuple):
    """Positions and forces at common times."""

    time_s: Float[np.ndarray, " n"]  # increasing
    centres_mm: Float[np.ndarray, "n 3"]  # of the ball
    forces_n: Float[np.ndarray, "n 3"]  # on the ball, in the same axes


@dataclass(frozen=True, kw_only=True)
class Detection(Options):
    """How presses are found."""

    section: ClassVar[str] = "format"
    contact_n: float | None = option(
        None, "Change of the force that is a contact; null: eight standard deviations of its noise",
        unit="N", gt=0,
    )  # fmt: skip
    rest_s: float = option(0.5, "Time at the begin without contact", unit="s", gt=0)
    approach_mm: float = option(
        2.0, "Motion before the contact that belongs to a press", unit="mm", ge=0
    )


def split_presses(
    session: Session, detection: Detection, source: str
) -> tuple[Int[np.ndarray, " s"], Session]:
    """Return the number of the press of each sample, from 1, and the samples of presses.

    Where a press has many samples, they are averaged over steps of its motion. The forces have no
    offset. `source` is the name of the file in messages.
    """
    offset, contact_n = _rest(session, detection, source)
    forces = session.forces_n - offset
    touches = np.linalg.norm(forces, axis=1) > contact_n
    numbers, rows = [], []
    for begin, end in _intervals(touches, session.time_s):
        press = _press(session.centres_mm, begin, end, detection.approach_mm)
        if len(press) >= MIN_SAMPLES:
            rows.append(press)
            numbers.append(len(rows))
    if not rows:
        raise FileError(
            f"'{source}' has no press: the force changes by up to "
            f"{np.linalg.norm(forces, axis=1).max():.3g} N, and {contact_n:.3g} N is a contact. "
            "Give format.contact_n, and check that the poses are those of the tool."
        )
    _log.info("'%s': %d presses, with forces above %.3g N.", source, len(rows), contact_n)
    parts = [_parts(session.centres_mm, press) for press in rows]
    means = [
        np.array([values[part].mean(axis=0) for press in parts for part in press])
        for values in (session.time_s, session.centres_mm, forces)
    ]
    probe = np.repeat(numbers, [len(press) for press in parts])
    return probe, Session(*means)


def _parts(
    centres: Float[np.ndarray, "n 3"], press: Int[np.ndarray, " k"]
) -> list[Int[np.ndarray, " j"]]:
    """Divide the samples of a press by equal steps along its motion; a stop is in one of them."""
    if len(press) <= _PER_PRESS:
        return list(press[:, None])
    push = centres[press[-1]] - centres[press[0]]
    along = (centres[press] - centres[press[0]]) @ push
    low, span = along.min(), max(float(np.ptp(along)), 1e-300)
    steps = np.minimum((along - low) / span * _PER_PRESS, _PER_PRESS - 1).astype(int)
    return [press[steps == step] for step in np.unique(steps)]


def _rest(
    session: Session, detection: Detection, source: str
) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the force without contact, and the change of it that is a contact, N."""
    rest = session.forces_n[session.time_s <= session.time_s[0] + detection.rest_s]
    if len(rest) < _MIN_REST:
        raise FileError(
            f"'{source}' has {len(rest)} forces in its first {detection.rest_s:g} s, of "
            f"{_MIN_REST} that are needed to know the noise; give a longer format.rest_s."
        )
    offset = np.median(rest, axis=0)
    noise = _norm(1.4826 * np.median(np.abs(rest - offset), axis=0))
    # Second differences are free of a force that rises already.
    white = _norm(np.median(np.abs(np.diff(rest, n=2, axis=0)), axis=0) / (0.6745 * np.sqrt(6.0)))
    half = len(rest) // 2
    drift = _norm(rest[half:].mean(axis=0) - rest[:half].mean(axis=0))
    contact = detection.contact_n or max(_SIGNIFICANT * noise, _SMALLEST_N)
    if drift > (detection.contact_n or max(_SIGNIFICANT * white, _SMALLEST_N)):
        raise FileError(
            f"'{source}': the force changes by {drift:.3g} N in its first {detection.rest_s:g} s, "
            "where no contact is expected; cut the bag before the first press, or give a shorter "
            "format.rest_s."
        )
    return offset, contact


def _norm(values: Float[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(values))


def _intervals(
    touches: Bool[np.ndarray, " n"], time_s: Float[np.ndarray, " n"]
) -> list[tuple[int, int]]:
    """Return the first and the last sample of each contact; short losses do not end one."""
    edges = np.diff(np.concatenate([[False], touches, [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    contacts: list[tuple[int, int]] = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if contacts and time_s[begin] - time_s[contacts[-1][1]] < _MERGE_S:
            contacts[-1] = (contacts[-1][0], end)
        else:
            contacts.append((begin, end))
    return contacts


def _press(
    centres: Float[np.ndarray, "n 3"], begin: int, end: int, approach_mm: float
) -> Int[np.ndarray, " k"]:
    """Return the samples of a press: the approach, and the contact until it is deepest."""
    distance = np.linalg.norm(centres[begin : end + 1] - centres[begin], axis=1)
    deepest = begin + int(np.argmax(distance >= _END * distance.max()))
    travel = float(np.linalg.norm(centres[deepest] - centres[begin]))
    if travel <= 0.0:
        return np.arange(begin, begin)
    push = (centres[deepest] - centres[begin]) / travel
    before = centres[begin] - centres[:begin]
    along = before @ push
    aside = np.linalg.norm(before - along[:, None] * push, axis=1)
    # Going back in time, the ball is ever farther away along the push, and not aside.
    belongs = (along <= approach_mm) & (aside <= _ASIDE * np.maximum(along, travel))
    belongs &= along >= 0.0
    left_out = np.flatnonzero(~belongs)
    first = int(left_out[-1]) + 1 if len(left_out) else 0
    return np.arange(first, deepest + 1)
