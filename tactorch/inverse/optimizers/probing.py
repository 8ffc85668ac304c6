"""The size of J^T J without J: random signs sent through its transpose."""

import numpy as np

from tactorch.inverse.objective import Point
from tactorch.inverse.optimizers.weight import RegularizationSchedule

_PROBES, _SEED = 8, 20240607
_RULE = 30.0  # as in `weight.ruling_weight`


def data_trace(point: Point, probes: int = _PROBES) -> float:
    """Estimate the trace of J^T J by one solve a press and probe.

    For signs s of the data, the mean of |J^T s|^2 is the trace of J J^T (Hutchinson, 1990). The
    signs are the same every time, so that a resumed run is the same run.
    """
    rng = np.random.default_rng(_SEED)
    size = len(point.evaluation.residuals)
    images = (point.transpose_times(rng.choice((-1.0, 1.0), size)) for _ in range(probes))
    return float(np.mean([image @ image for image in images]))


def start_cooling(point: Point, state: dict[str, float], trace: float) -> RegularizationSchedule:
    """`RegularizationSchedule.start` with the first weight from an estimated trace of J^T J."""
    if point.objective.weight is not None or "weight" in state:
        return RegularizationSchedule.start(point, state)
    prior = float(point.penalty_curvature.diagonal().sum())
    first = _RULE * trace / prior if prior > 0 else 0.0  # a single element has no jumps
    return RegularizationSchedule(first, first, fixed=first == 0.0)
