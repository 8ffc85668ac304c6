"""What a gel in contact bears."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Contact:
    """Forces on the outer face of a gel, in the sensor's frame.

    Attributes:
        points: Rest positions of the face's nodes, (k, 3), mm.
        displacement: How they moved, (k, 3), mm; the smoothed ones where noise was in mind.
        forces: On the gel at each node, (k, 3), N; what the gel does to the object is the opposite.
        covariance: Of the total force by the noise of the displacements, (3, 3), N^2; None where
            the noise was not given.
    """

    points: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    forces: Float[np.ndarray, "k 3"]
    covariance: Float[np.ndarray, "3 3"] | None = None

    @property
    def total(self) -> Float[np.ndarray, "3"]:
        """Sum of the forces, N."""
        return self.forces.sum(axis=0)
