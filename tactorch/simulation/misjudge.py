"""Recordings as they come out where something beside the moduli is known badly (Fig. 9)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real
from tactorch.recording import Press, Recording


def misjudged(
    recording: Recording,
    *,
    poisson: float = 0.0,
    force_scale: Real = 1.0,
    size: Real | Sequence[Real] = 1.0,
) -> Recording:
    """Return what would have been recorded with wrong beliefs about the object and the sensor.

    The deformed positions that were measured stay as they are; what they are taken for changes.
    A wrong size is about where each press holds the object, since the table is where it is: the
    displacement from the wrong rest shape then holds the difference of the shapes too, as in
    Section V-C2 of the paper.

    Args:
        recording: The recording with the right beliefs.
        poisson: Believed minus true Poisson's ratio.
        force_scale: Reported over true force.
        size: Believed over true size, one for all axes or one each.

    Raises:
        ConfigError: a value cannot be used.
    """
    factors = np.broadcast_to(np.asarray(size, dtype=np.float64), (3,))
    if not (np.all(np.isfinite(factors)) and np.all(factors > 0)):
        raise ConfigError(f"size={size}: give factors above 0, such as 1.1.")
    if not force_scale > 0:
        raise ConfigError(f"force_scale={force_scale}: give a factor above 0, such as 1.2.")
    mesh, material = recording.mesh, recording.material
    believed = TetMesh.create(mesh.points * factors, mesh.tets)
    presses = tuple(
        replace(
            press,
            forces=press.forces * force_scale,
            displacement=press.displacement - _growth(press, mesh.points, factors),
        )
        for press in recording.presses
    )
    beliefs = {"poisson": poisson, "force_scale": force_scale, "size": factors.tolist()}
    return replace(
        recording,
        mesh=believed,
        presses=presses,
        material=replace(material, poisson=material.poisson + poisson),
        provenance={**recording.provenance, "misjudged": beliefs},
        check_units=False,
    )


def _growth(
    press: Press, points: Float[np.ndarray, "n 3"], factors: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Believed minus true rest positions, counted from what holds the object along each axis."""
    held = press.fixed | (press.springs > 0)
    center = points.min(axis=0) / 2 + points.max(axis=0) / 2
    origin = np.array(
        [points[on, a].mean() if (on := held[:, a]).any() else center[a] for a in range(3)]
    )
    return (points - origin) * (factors - 1.0)
