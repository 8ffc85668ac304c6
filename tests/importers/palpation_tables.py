"""Palpations as loggers of robots write them: a ball on a half-space, with air and lifting."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tactorch.fem.contact.pressures import ball_force

RADIUS, MODULUS, NOISE, DEPTH = 3.0, 0.05, 0.004, 1.5
PLANE = MODULUS / (1.0 - 0.45**2)  # of a half-space, as the force of the ball has it
HEIGHT = 2.0  # of the surface
NAMES = ("probe", "x_mm", "y_mm", "z_mm", "fx_n", "fy_n", "fz_n")

Rows = np.ndarray  # probe, x, y, z, fx, fy, fz, time


def path_of(approach: float = 1.0, deepest: float = DEPTH, step: float = 0.05) -> np.ndarray:
    """Depths of a ball that comes from the air."""
    return np.arange(-approach, deepest + 1e-9, step)


def palpation(
    depths: np.ndarray | Callable[[int], np.ndarray] | None = None,
    *,
    side: int = 4,
    lifted: float = 1.0,
    offset: Callable[[int, np.ndarray], np.ndarray | float] = lambda k, time: 0.0,
    tilt: float = 0.0,
    modulus: float = MODULUS,
    seed: int = 0,
) -> Rows:
    """Rows of a palpation of a plane at `HEIGHT`, 4 mm apart, at 50 Hz with 1 s between probes.

    Args:
        depths: Depth of the ball over time, or of each probe.
        side: Number of probes along x and y.
        lifted: Factor of the force while the ball is lifted.
        offset: Offset of the force of probe k at times (s).
        tilt: Motion along x over that along z.
        modulus: Young's modulus, MPa.
        seed: Of the noise.
    """
    rng, rows, clock = np.random.default_rng(seed), [], 0.0
    for k, (i, j) in enumerate(np.ndindex(side, side)):
        depth = depths(k) if callable(depths) else path_of() if depths is None else depths
        time = clock + 0.02 * np.arange(len(depth))
        force = modulus / (1.0 - 0.45**2) * ball_force(depth, RADIUS)
        force *= np.where(np.diff(depth, prepend=depth[0]) < -1e-9, lifted, 1.0)
        row = np.zeros((len(depth), 8))
        row[:, 0], row[:, 7] = k, time
        row[:, 1] = 4.0 * i - tilt * depth
        row[:, 2], row[:, 3] = 4.0 * j, HEIGHT + RADIUS - depth
        row[:, 4:7] = NOISE * rng.standard_normal((len(depth), 3))
        row[:, 6] += force + offset(k, time)
        rows.append(row)
        clock = time[-1] + 1.0
    return np.concatenate(rows)


def write(
    path: Path, rows: Rows, names: Sequence[str] = NAMES, labels: Sequence[str] | None = None
) -> Path:
    """Write a table; with a name for the time, rows have it."""
    lines = [",".join(names)]
    for i, row in enumerate(rows):
        label = f"{int(row[0])}" if labels is None else labels[i]
        lines.append(",".join([label, *(f"{value:.7g}" for value in row[1 : len(names)])]))
    path.write_text("\n".join(lines) + "\n")
    return path
