"""Coarse to fine: a map of few moduli first, each shared by a cluster of elements.

With x = G z, z one log-modulus a cluster, the Jacobian by z has one column a cluster, each a solve
a press; Gauss-Newton on it is cheap, and sees large parts only. Its map is a start for the
inversion proper, in the manner of multilevel inversion (Liu, 1993).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse.evaluation import Evaluation
from tactorch.inverse.parameterization import Bounds
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.uniform import uniform_fit
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order

_ROUNDS = 10  # of moving cluster centres
_JUMP = 0.5  # deviation of a log-modulus between touching clusters that is expected
_LARGEST_STEP, _HALVINGS, _SETTLED = 1.0, 4, 0.02


def clusters(mesh: TetMesh, count: int) -> Int[np.ndarray, " m"]:
    """Gather elements into compact clusters, numbered from 0: Lloyd's method on centroids.

    Deterministic: the first centres are far from each other, and the last ones are never empty.

    Raises:
        ConfigError: `count` is not between one and the number of elements.
    """
    if not 1 <= count <= mesh.n_tets:
        raise ConfigError(f"groups={count} must be from 1 to the {mesh.n_tets} elements.")
    centroids, volumes = mesh.centroids, mesh.volumes
    middle = np.linalg.norm(centroids - centroids.mean(axis=0), axis=1).argmin()
    centres = centroids[farthest_point_order(centroids, count, int(middle))]
    labels = cKDTree(centres).query(centroids)[1]
    for _ in range(_ROUNDS):
        mass = np.bincount(labels, volumes, minlength=count)
        moments = [np.bincount(labels, volumes * x, minlength=count) for x in centroids.T]
        kept = mass > 0
        centres[kept] = (np.array(moments)[:, kept] / mass[kept]).T
        labels = cKDTree(centres).query(centroids)[1]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True)
class CoarseStart(Options):
    """The map of few moduli that fits best, each shared by a cluster of elements.

    Attributes:
        groups: Number of clusters.
        steps: Limit of Gauss-Newton steps.
    """

    section: ClassVar[str] = "initialization"
    groups: int = option(64, "Number of clusters of elements", gt=0)
    steps: int = option(6, "Limit of Gauss-Newton steps", gt=0)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the map, MPa.

        Raises:
            ConfigError: there are more groups than elements.
            ConvergenceError: no uniform modulus within the bounds carries the presses.
        """
        mesh = problem.recording.mesh
        labels = clusters(mesh, self.groups)
        prior = _touching(mesh, labels) / _JUMP**2
        first = uniform_fit(problem, bounds).youngs_mpa
        z = np.full(labels.max() + 1, np.log(first))
        point = problem.evaluate(np.exp(z)[labels])
        for _ in range(self.steps):
            if point.chi2 <= 1.0:
                break
            moved = _step(problem, bounds, labels, prior, z, point)
            if moved is None:
                break
            settled = np.abs(moved[0] - z).max() < _SETTLED
            z, point = moved
            if settled:
                break
        return point.youngs


def _step(
    problem: InverseProblem,
    bounds: Bounds,
    labels: Int[np.ndarray, " m"],
    prior: sp.csr_matrix,
    z: Float[np.ndarray, " g"],
    point: Evaluation,
) -> tuple[Float[np.ndarray, " g"], Evaluation] | None:
    """One Gauss-Newton step, halved until the objective falls; None if it does not."""
    jacobian = grouped_jacobian(point, labels)
    gradient = jacobian.T @ point.residuals + prior @ z
    curvature = jacobian.T @ jacobian + prior.toarray()
    curvature[np.diag_indices_from(curvature)] *= 1.0 + 1e-9
    step = np.clip(-np.linalg.solve(curvature, gradient), -_LARGEST_STEP, _LARGEST_STEP)
    before = _value(point, prior, z)
    for _ in range(_HALVINGS):
        there = np.clip(z + step, np.log(bounds.lower), np.log(bounds.upper))
        try:
            moduli = np.clip(np.exp(there), bounds.lower, bounds.upper)
            trial = problem.evaluate(moduli[labels], point)
            if _value(trial, prior, there) < before:
                return there, trial
        except ConvergenceError:
            pass
        step = 0.5 * step
    return None


def _value(point: Evaluation, prior: sp.csr_matrix, z: Float[np.ndarray, " g"]) -> float:
    return 0.5 * float(point.residuals @ point.residuals + z @ (prior @ z))


def _touching(mesh: TetMesh, labels: Int[np.ndarray, " m"]) -> sp.csr_matrix:
    """Laplacian of the graph of clusters that share a face."""
    ends = np.sort(labels[mesh.adjacency.pairs], axis=1)
    pairs = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    count = int(labels.max()) + 1
    weights = np.ones(len(pairs))
    graph = sp.csr_matrix((weights, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    graph = graph + graph.T
    return (sp.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph).tocsr()


def grouped_jacobian(
    point: Evaluation, labels: Int[np.ndarray, " m"]
) -> Float[np.ndarray, "data g"]:
    """Return d residuals / d log-modulus of each cluster, one solve a cluster and press."""
    count = int(labels.max()) + 1
    columns = [point.jacobian_times(np.where(labels == g, point.youngs, 0.0)) for g in range(count)]
    return np.column_stack(columns)
