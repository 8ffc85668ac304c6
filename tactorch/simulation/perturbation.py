"""Recordings with wrong assumptions about the object and the sensor (Fig. 9 of the paper)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real
from tactorch.recording import Press, Recording


def perturb_recording(
    recording: Recording,
    *,
    poisson: float = 0.0,
    force_scale: Real = 1.0,
    size: Real | Sequence[Real] = 1.0,
) -> Recording:
    """Return the recording of the same deformed positions under wrong assumptions.

    The assumed size is relative to the support of each press, whose position is known. The
    displacement from the wrong rest shape includes the difference of the shapes (Section V-C2).

    Args:
        recording: Recording with the correct assumptions.
        poisson: Error of Poisson's ratio: assumed minus true value.
        force_scale: Ratio of the reported to the true force.
        size: Ratio of the assumed to the true size, one value or one for each axis.

    Returns:
        The recording with the errors noted in its provenance.
    """
    factors = np.broadcast_to(np.asarray(size, dtype=np.float64), (3,))
    if not (np.all(np.isfinite(factors)) and np.all(factors > 0)):
        raise ConfigError(f"size={size}: give factors above 0, such as 1.1.")
    if not force_scale > 0:
        raise ConfigError(f"force_scale={force_scale}: give a factor above 0, such as 1.2.")
    mesh, material = recording.mesh, recording.material
    presses = tuple(
        replace(
            press,
            forces=press.forces * force_scale,
            displacement=press.displacement - _shape_difference(press, mesh.points, factors),
        )
        for press in recording.presses
    )
    errors = {"poisson": poisson, "force_scale": force_scale, "size": factors.tolist()}
    return replace(
        recording,
        mesh=TetMesh.create(mesh.points * factors, mesh.tets),
        presses=presses,
        material=replace(material, poisson=material.poisson + poisson),
        provenance={**recording.provenance, "perturbation": errors},
        check_units=False,
    )


def _shape_difference(
    press: Press, points: Float[np.ndarray, "n 3"], factors: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Assumed minus true rest positions, relative to the supported nodes along each axis."""
    origin = points.min(axis=0) / 2 + points.max(axis=0) / 2
    for axis, supported in enumerate((press.fixed | (press.springs > 0)).T):
        if supported.any():
            origin[axis] = points[supported, axis].mean()
    return (points - origin) * (factors - 1.0)
