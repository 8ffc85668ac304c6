"""Errors of the poses of sensor, object and probes."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import orth

from tactorch.inverse.errors.base import ContactMotion, MeasuredPresses
from tactorch.inverse.forward.footprint import largest_depth
from tactorch.inverse.forward.palpation import is_palpation
from tactorch.recording import ProbePose, Recording

_LEAST = 0.001  # that of the discretisation after its correction
_SAME_PLACE = 0.1  # distance across the approach, over the probe's depth, at which places differ
_LEVI_CIVITA = np.stack([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])


class RigidMotion(ContactMotion):
    """Rigid motions of each contact, over the displacements observed there."""

    name = "pose"

    def fields(
        self, points: Float[np.ndarray, "data 3"], axes: Float[np.ndarray, "data 3"]
    ) -> Float[np.ndarray, "data k"]:
        """Return translations and rotations about the mean of the points.

        Rotations are scaled to the size of the translations.
        """
        offsets = points - points.mean(axis=0)
        turns = np.einsum("kij,dj,di->dk", _LEVI_CIVITA, offsets, axes)
        fields = orth(np.hstack([axes, turns / max(np.abs(offsets).max(), 1e-12)]), rcond=1e-6)
        n_axes = int(axes.any(axis=0).sum())  # a translation moves one of them
        return np.asarray(fields * np.sqrt(len(points) / n_axes))


class Pose(RigidMotion):
    """Rigid motions of each contact, and of probes at each place, over the largest depth there."""

    elements, proposal, levels = "linear", "poses wrong by {:.1%}", (0.002, 0.01, 0.05)
    noted = 0.005  # above what remains of the discretisation
    note = (
        "The object or the sensor moves as a whole beside the recorded forces and supports, by "
        "about {:.0%} of the displacements; the intervals of the lumps account for it. "
        "Check the supports and the pose of the sensor."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return what remains of the discretisation; places of a palpation are exact."""
        if is_palpation(presses.problem.recording):
            return None
        return 0.0 if presses.corrections_mm is None else _LEAST

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        recording, contacts = presses.problem.recording, super().patterns(presses)
        if not recording.has_probes:
            return contacts
        motions, places = presses.evaluation.probe_motions(), _places(recording)
        parts = [{i: depth * motions[i] for i in place} for place, depth in places]
        return np.hstack([contacts, presses.joined(parts)])


def _places(recording: Recording) -> list[tuple[list[int], float]]:
    """Return presses by one probe at positions along its axis, and their largest depth, mm."""
    poses = {i: press.probe for i, press in enumerate(recording.presses) if press.probe is not None}
    depths = {i: largest_depth(pose, recording.mesh) for i, pose in poses.items()}
    places: list[list[int]] = []
    for i, pose in poses.items():
        for place in places:
            if _is_along(pose, poses[place[0]], _SAME_PLACE * max(depths[k] for k in place)):
                place.append(i)
                break
        else:
            places.append([i])
    return [(place, max(depths[k] for k in place)) for place in places]


def _is_along(pose: ProbePose, first: ProbePose, apart_mm: float) -> bool:
    if pose.probe != first.probe or not np.allclose(pose.rotation, first.rotation):
        return False
    axis, apart = pose.rotation[:, 2], pose.position_mm - first.position_mm
    return float(np.linalg.norm(apart - (apart @ axis) * axis)) < apart_mm
