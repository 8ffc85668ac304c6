"""Directions from which presses are seen."""

import numpy as np
from jaxtyping import Float

from tactorch.recording import Press
from tactorch.viz.slicing import AXES


def push_direction(press: Press) -> Float[np.ndarray, "3"]:
    """Return the unit vector of a push: as stated, of the probe, or of the total force."""
    if press.direction is not None:
        return press.direction
    if press.probe is not None:
        return -press.probe.rotation[:, 2]
    size = float(np.linalg.norm(press.total_force))
    return press.total_force / size if size > 0 else np.array([0.0, 0.0, -1.0])


def plane_across(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Return two unit vectors normal to a direction, close to axes of the object."""
    main = int(np.argmax(np.abs(direction)))
    first = np.eye(3)[(main + 1) % 3]
    first = first - (first @ direction) * direction
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    second *= np.sign(second[(main + 2) % 3]) or 1.0
    return np.stack([first, second])


def axis_name(vector: Float[np.ndarray, "3"]) -> str:
    """Return the name of a direction in the axes of the object."""
    main = int(np.argmax(np.abs(vector)))
    exact = abs(abs(vector[main]) - 1.0) < 1e-3
    return AXES[main] if exact else f"about {AXES[main]}"
