"""Changes of the data by errors of the poses of probes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.problem import Evaluation
from tactorch.inverse.shapes.footprint import largest_depth
from tactorch.recording import ProbePose, Recording

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
    for place in _places(recording):
        pattern = np.zeros((sum(evaluation.data.counts), 3))
        for i in place.presses:
            pattern[begins[i] : begins[i] + len(motions[i])] = place.depth_mm * motions[i]
        columns.append(pattern)
    return np.hstack(columns)


@dataclass(eq=False)
class _Place:
    """Presses by one probe, whose positions differ along its axis.

    Attributes:
        pose: Pose of the first.
        depth_mm: Largest depth.
        presses: Their numbers.
    """

    pose: ProbePose
    depth_mm: float
    presses: list[int]

    def has(self, pose: ProbePose) -> bool:
        """Return whether a press is at this place."""
        if pose.probe != self.pose.probe or not np.allclose(pose.rotation, self.pose.rotation):
            return False
        axis, apart = pose.rotation[:, 2], pose.position_mm - self.pose.position_mm
        across = float(np.linalg.norm(apart - (apart @ axis) * axis))
        return across < _SAME_PLACE * self.depth_mm


def _places(recording: Recording) -> list[_Place]:
    places: list[_Place] = []
    for i, press in enumerate(recording.presses):
        if (pose := press.probe) is None:
            continue
        depth = largest_depth(pose, recording.mesh)
        place = next((place for place in places if place.has(pose)), None)
        if place is None:
            places.append(_Place(pose, depth, [i]))
        else:
            place.depth_mm = max(place.depth_mm, depth)
            place.presses.append(i)
    return places
