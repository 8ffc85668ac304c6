"""What presses say of each place of a body: images of signal over noise, and of what they resolve.

About a uniform body the residuals r of the presses have unit variance (whitened by all errors of
the data), and derivatives J w by the log-modulus of a voxel w. With Q an orthonormal basis of the
derivatives by the parameters of the uniform body, and P = 1 - Q Q^T, the image is

    signal = -(J w)^T P r / |P J w|,    sensitivity = |P J w|:

the gradient of half the squared misfit over the root of the diagonal of its Gauss-Newton Hessian,
and that root. The signal is the score statistic of Rao (Proc. Camb. Phil. Soc. 44 (1948), 50-57)
for an inclusion at the voxel: normal with unit variance where there is none, and about c |P J w|
for one of the log-contrast c. Both have no unit, so that bodies and presses of any size, number and
kind can be compared.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import Model
from tactorch.mesh import VoxelGrid
from tactorch.mesh.closest import closest_points
from tactorch.recording import Recording

_COUNT = 16  # voxels along each side of the bounding box
_BLOCK = 512  # voxels whose responses are held at once
_LEAST = 1e-9  # sensitivity over the largest one, below which presses say nothing of a voxel


@dataclass(frozen=True, eq=False)
class PhysicsImage:
    """Signal over noise and sensitivity of the presses on a body, on a grid of voxels.

    Attributes:
        grid: The voxels; each stands for a change of the log-modulus that falls linearly from its
            centre to those of its neighbours.
        signal: Signal over noise; positive where the body is stiffer; 0 outside.
        sensitivity: Standard deviations by which the data change for a unit of the log-modulus of
            a voxel, beyond what another uniform body would explain; 0 outside.
        contacts_mm: Points of the surface that the presses load, mm.
        youngs_mpa: Young's modulus of the uniform body, MPa.
        chi2: Mean squared whitened residual of the uniform body; 1 where it explains the presses.
    """

    grid: VoxelGrid
    signal: Float[np.ndarray, "v v v"]
    sensitivity: Float[np.ndarray, "v v v"]
    contacts_mm: Float[np.ndarray, "c 3"]
    youngs_mpa: float
    chi2: float

    @staticmethod
    def of(problem: SearchProblem, model: Model, count: int = _COUNT) -> "PhysicsImage":
        """Return the image of the presses of a search about one of its models."""
        reduced, data = problem.reduced, problem.data(model.errors)
        recording = reduced.recording
        grid = VoxelGrid(recording.mesh, count)
        residuals = data.whiten(problem.raw(model).residuals)
        basis, _ = np.linalg.qr(data.whiten(problem.jacobian(model)))
        remaining = residuals - basis @ (basis.T @ residuals)
        gradient, squares = np.zeros((2, count**3))
        weights = grid.element_weights.tocsc()
        for begin in range(0, count**3, _BLOCK):
            block = slice(begin, begin + _BLOCK)
            responses = np.asarray(reduced.rates @ weights[:, block].toarray())
            responses = data.whiten(responses * data.scale[:, None])
            gradient[block] = remaining @ responses
            explained = basis.T @ responses
            squares[block] = (responses**2).sum(axis=0) - (explained**2).sum(axis=0)
        sensitivity = np.sqrt(np.maximum(squares, 0.0))
        seen = grid.inside.ravel() & (sensitivity > _LEAST * sensitivity.max())
        signal = np.where(seen, -gradient / np.where(seen, sensitivity, 1.0), 0.0)
        return PhysicsImage(
            grid,
            signal.reshape(grid.shape),
            np.where(seen, sensitivity, 0.0).reshape(grid.shape),
            loaded_points(recording),
            float(np.exp(model.fit.field.physical(model.fit.z)[0])),
            float(np.mean(residuals**2)),
        )

    @cached_property
    def wall_distance(self) -> Float[np.ndarray, "v v v"]:
        """Distance of each voxel from the surface, over the cube root of the body's volume.

        It is negative outside.
        """
        mesh, at = self.grid.mesh, self.grid.centres.reshape(-1, 3)
        distances = closest_points(mesh.points, mesh.surface.triangles, at).distances
        signs = np.where(self.grid.inside, 1.0, -1.0)
        return signs * distances.reshape(self.grid.shape) / self._size_mm

    @cached_property
    def contact_distance(self) -> Float[np.ndarray, "v v v"]:
        """Distance of each voxel from the nearest contact, over the cube root of the volume."""
        distances, _ = cKDTree(self.contacts_mm).query(self.grid.centres.reshape(-1, 3))
        return np.asarray(distances).reshape(self.grid.shape) / self._size_mm

    @property
    def _size_mm(self) -> float:
        return float(np.cbrt(self.grid.mesh.volumes.sum()))

    @property
    def peak_mm(self) -> Float[np.ndarray, "3"]:
        """Centre of the voxel of the strongest signal, mm."""
        strongest = np.unravel_index(np.abs(self.signal).argmax(), self.grid.shape)
        return np.asarray(self.grid.centres[strongest])


def loaded_points(recording: Recording) -> Float[np.ndarray, "c 3"]:
    """Return the nodes that presses load, and the points next to their probes, mm."""
    mesh = recording.mesh
    loaded = np.zeros(mesh.n_points, dtype=bool)
    for press in recording.presses:
        loaded |= (press.forces != 0.0).any(axis=1) | (press.prescribed != 0.0).any(axis=1)
    places = [p.probe.position_mm for p in recording.presses if p.probe is not None]
    places += [p.gel.pose[:3, 3] for p in recording.presses if p.gel is not None]
    distinct = np.unique(np.reshape(places, (-1, 3)), axis=0)
    touched = closest_points(mesh.points, mesh.surface.triangles, distinct).points
    return np.concatenate([mesh.points[loaded], touched])
