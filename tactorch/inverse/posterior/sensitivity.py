"""The credibility metric of the paper (eq. 15, Fig. 3)."""

from functools import reduce

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, TactorchError
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.posterior.gaussian import Field
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice

_SUBDIVISIONS = 11  # sample points along an edge of an element


def credibility(evaluation: Evaluation) -> Field:
    """Return the credibility L(j) = max_i |M_ij| of each element (eq. 15), mm/MPa.

    M = S du/de is the sensitivity matrix (eq. 14). The row i runs over observed degrees of freedom:
    x, y and z displacements are separate rows. One press's rows are in memory at a time. L over
    `mesh.volumes` (mm/MPa/mm^3) is independent of the element size.
    """
    rows = (press.matrix() for press in evaluation.sensitivities)
    return reduce(np.maximum, (np.abs(matrix).max(axis=0, initial=0.0) for matrix in rows))


def layer_profile(
    mesh: TetMesh, values: Field, axis: int = 2, layers: int = 10
) -> tuple[Float[np.ndarray, " layers"], Float[np.ndarray, " layers"]]:
    """Integrate a metric over equal layers of the bounding box (Fig. 3).

    An element in several layers is divided among them by sample points of equal volume.

    Args:
        mesh: The body, mm.
        values: Metric of each element.
        axis: Normal of the layers: 0, 1 or 2.
        layers: Number of layers.

    Returns:
        Centres of the layers (mm), integral over each (unit of the metric times mm^3).
    """
    if axis not in (0, 1, 2):
        raise ConfigError(f"axis is {axis}; give 0, 1 or 2 for x, y or z.")
    if layers < 1:
        raise ConfigError(f"layers is {layers}; give at least 1.")
    if len(values) != mesh.n_tets:
        raise TactorchError(
            f"values: {len(values)} for a mesh of {mesh.n_tets} tetrahedra; give one each."
        )
    low, high = mesh.bounds[:, axis]
    edges = np.linspace(low, high, layers + 1)
    weights = lattice(_SUBDIVISIONS, margin=0.25)
    heights = mesh.points[mesh.tets, axis] @ weights.T
    index = np.clip(np.searchsorted(edges, heights, side="right") - 1, 0, layers - 1)
    share = np.repeat(values * mesh.volumes / len(weights), len(weights))
    sums = np.bincount(index.ravel(), weights=share, minlength=layers)
    return 0.5 * (edges[1:] + edges[:-1]), sums
