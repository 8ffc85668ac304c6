"""Parts of a contact in which the gel slips on the object.

Coulomb friction limits the traction along the face to the coefficient of friction times the
pressure. In a contact that is sheared, it reaches the limit at the edge first (R. D. Mindlin,
"Compliance of elastic bodies in contact", J. Appl. Mech. 16 (1949), 259-268). There a point of the
gel does not stay with the point of the object that it touched. The forces are not affected, as they
follow from the deformation of the gel.
"""

import numpy as np
from jaxtyping import Bool, Float

_NEAR_LIMIT = 0.9  # tangential over normal force, over the coefficient of friction


def slipping_nodes(
    forces: Float[np.ndarray, "k 3"], in_contact: Bool[np.ndarray, " k"], friction: float
) -> Bool[np.ndarray, " k"]:
    """Return the nodes of a gel's face that slip.

    Args:
        forces: Forces on the gel at the nodes, N, in the sensor frame, whose z axis points out of
            the gel.
        in_contact: Nodes in contact.
        friction: Coefficient of friction.
    """
    along, pressing = np.linalg.norm(forces[:, :2], axis=1), np.maximum(-forces[:, 2], 0.0)
    at_limit = (along > 0.0) & (along >= _NEAR_LIMIT * friction * pressing)
    return np.asarray(in_contact & at_limit)
