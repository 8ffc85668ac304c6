"""Errors that forces and displacements of a press have in common."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import RecordingError
from tactorch.recording.arrays import make_array, require_finite


@dataclass(frozen=True, eq=False)
class PressErrors:
    """Correlated errors of the recorded forces and displacements of a press.

    Forces that are computed from displacements, as those of the gel of a sensor, have errors that
    follow from those of the displacements. The recorded values are the true ones plus a sum of
    patterns, each multiplied by an independent standard normal number.

    Attributes:
        nodes: Numbers of the nodes of the patterns, (l,).
        forces: Errors of the nodal forces, (q, l, 3), N.
        displacement: Errors of the displacements of the nodes, (q, l, 3), mm; those of components
            that are not observed are ignored.

    Raises:
        RecordingError: Shapes differ, a value is not finite, or nodes are negative or repeated.
    """

    nodes: Int[np.ndarray, " l"]
    forces: Float[np.ndarray, "q l 3"]
    displacement: Float[np.ndarray, "q l 3"]

    def __post_init__(self) -> None:
        nodes = make_array(self.nodes, (None,), "errors: nodes", "iu").astype(np.int64)
        object.__setattr__(self, "nodes", nodes)
        shape = (len(np.atleast_1d(self.forces)), len(nodes), 3)
        for name in ("forces", "displacement"):
            array = make_array(getattr(self, name), shape, f"errors: {name}")
            require_finite(array, f"errors: {name}")
            object.__setattr__(self, name, array)
        if len(nodes) and (nodes.min() < 0 or len(np.unique(nodes)) < len(nodes)):
            raise RecordingError(
                "errors: nodes has a negative or repeated number; give each node of the mesh once"
            )

    @property
    def total_force_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of the sum of the nodal forces, (3, 3), N^2."""
        totals = self.forces.sum(axis=1)
        return totals.T @ totals
