"""Coarse start: a map of few moduli, each shared by a cluster of elements.

The sensitivity matrix has one column per cluster, at one solve per press, so Gauss-Newton is cheap
and recovers large features only. The map is a start for the inversion, as in multilevel inversion
(Liu, 1993).
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import laplacian
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.inverse.monitor import Monitor, StopOptimization, StopReason
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.parameterization import Bounds, Log
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.regularization.base import Quadratic
from tactorch.inverse.starts import NO_TOLERANCE, small_step, uniform_fit
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order

_LLOYD_ROUNDS = 10
_JUMP = 0.5  # expected difference of log-modulus between adjacent clusters
_STEP_TOLERANCE = 0.02  # change of a log-modulus


def clusters(mesh: TetMesh, count: int) -> Int[np.ndarray, " m"]:
    """Group elements into compact clusters, numbered from 0, by Lloyd's method on their centroids.

    The method is deterministic: the first centres are far from each other, and no cluster is empty.
    """
    if not 1 <= count <= mesh.n_tets:
        raise ConfigError(f"groups={count} must be from 1 to the {mesh.n_tets} elements.")
    centroids, volumes = mesh.centroids, mesh.volumes
    middle = np.linalg.norm(centroids - centroids.mean(axis=0), axis=1).argmin()
    centres = centroids[farthest_point_order(centroids, count, int(middle))]
    labels = cKDTree(centres).query(centroids)[1]
    for _ in range(_LLOYD_ROUNDS):
        mass = np.bincount(labels, volumes, minlength=count)
        moments = [np.bincount(labels, volumes * x, minlength=count) for x in centroids.T]
        filled = mass > 0
        centres[filled] = (np.array(moments)[:, filled] / mass[filled]).T
        labels = cKDTree(centres).query(centroids)[1]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


@dataclass(frozen=True)
class CoarseStart(Options):
    """The map of few moduli that fits best, each shared by a cluster of elements."""

    section: ClassVar[str] = "initialization"
    groups: int = option(64, "Number of clusters of elements", gt=0)
    steps: int = option(6, "Limit of Gauss-Newton steps", gt=0)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the map, MPa."""
        mesh = problem.recording.mesh
        labels = clusters(mesh, self.groups)
        # The prior's matrix is the Laplacian of the graph of clusters that share a face.
        ends = np.sort(labels[mesh.adjacency.pairs], axis=1)
        i, j = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0).T
        count = int(labels.max()) + 1
        graph = sp.csr_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
        prior = Quadratic(laplacian(graph + graph.T).tocsr() / _JUMP**2)
        objective = Objective(problem, Log(bounds), prior, weight=1.0, groups=labels)
        small = small_step(_STEP_TOLERANCE)

        def stop_condition(history: list[dict[str, Any]]) -> StopReason | None:
            return StopReason.FITTED if history[-1]["chi2"] <= 1.0 else small(history)

        monitor = Monitor(stop_condition=stop_condition, log=False)
        first = np.log(uniform_fit(problem, bounds).youngs_mpa)
        optimizer = GaussNewton(max_iterations=self.steps, tolerance=NO_TOLERANCE)
        with suppress(StopOptimization):
            optimizer.minimize(objective, np.full(objective.size, first), monitor)
        assert monitor.point is not None
        return monitor.point.youngs
