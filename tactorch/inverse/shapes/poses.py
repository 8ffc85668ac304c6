"""Changes of the data by errors of the poses of probes."""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.problem import Evaluation
from tactorch.inverse.shapes.footprint import largest_depth
from tactorch.recording import Press, Recording

_SAME_PLACE = 0.1  # distance across the approach, over the probe's depth, at which places differ


def probe_patterns(
    recording: Recording, evaluation: Evaluation
) -> Float[np.ndarray, "data patterns"]:
    """Return the changes of the data by errors of the positions of probes.

    The error at one place is common to its presses, and as large as the largest depth there. The
    unit is the standard deviation of the white noise.

    Args:
        recording: The presses.
        evaluation: Their predictions, and derivatives.
    """
    motions = evaluation.probe_motions()
    begins, columns = evaluation.data.begins, []
    for numbers in _places(recording):
        depth = max(largest_depth(recording.presses[i], recording.mesh) for i in numbers)
        place = np.zeros((sum(evaluation.data.counts), 3))
        for i in numbers:
            place[begins[i] : begins[i] + len(motions[i])] = depth * motions[i]
        columns.append(place)
    return np.hstack(columns)


def _places(recording: Recording) -> list[list[int]]:
    """Return the presses of each place: by one probe, whose positions differ along its axis."""
    places: list[list[int]] = []
    for i, press in enumerate(recording.presses):
        if press.probe is None:
            continue
        for place in places:
            if _is_same(press, recording.presses[place[0]], recording):
                place.append(i)
                break
        else:
            places.append([i])
    return places


def _is_same(first: Press, second: Press, recording: Recording) -> bool:
    assert first.probe is not None
    assert second.probe is not None
    a, b = first.probe, second.probe
    if a.probe != b.probe or not np.allclose(a.rotation, b.rotation):
        return False
    axis = a.rotation[:, 2]
    apart = a.position_mm - b.position_mm
    across = float(np.linalg.norm(apart - (apart @ axis) * axis))
    return across < _SAME_PLACE * largest_depth(first, recording.mesh)
