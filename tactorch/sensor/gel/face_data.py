"""Displacements of the gel's outer face as they are measured, with their errors.

Markers measure displacements in the plane at their positions, the depth along z anywhere. Depth is
integrated from slopes, so that its error is mostly smooth, and steep slopes at the edge of a
contact, which are measured less well, shift all of the contact.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular
from scipy.spatial.distance import cdist

from tactorch.errors import ConfigError
from tactorch.mesh.closest import closest_points
from tactorch.sensor.gel.face import EdgeDistance

# Parts of the deviation of the depth: independent at each point, and smooth.
_ROUGH, _SMOOTH = 0.4, 0.5
_LENGTH = 0.25  # of the covariance of the smooth part, over the extent of the data
_STEP = 0.1  # error of the level of a contact, over the range of the depth
_NEAR, _WIDENED = 1.1, 5.0  # distance from an edge, over the size of elements; factor there
_MIN_VARIANCE = 1e-4  # of a mode of the smooth part, over that of the first


@dataclass(frozen=True, eq=False)
class FaceData:
    """Displacements of points of the gel's outer face along x, y or z of the sensor.

    Attributes:
        points_mm: Rest positions in the plane, (d, 2), mm.
        axes: Axis of each datum: 0, 1 or 2.
        displacement_mm: Displacements, (d,), mm.
        deviations_mm: Standard deviations of independent errors, (d,), mm.
        patterns_mm: Errors that data have in common, (d, p), each of unit deviation, mm; or None.

    Raises:
        ConfigError: A value is not finite, or a deviation is not positive.
    """

    points_mm: Float[np.ndarray, "d 2"]
    axes: Int[np.ndarray, " d"]
    displacement_mm: Float[np.ndarray, " d"]
    deviations_mm: Float[np.ndarray, " d"]
    patterns_mm: Float[np.ndarray, "d p"] | None = None

    def __post_init__(self) -> None:
        for name in ("points_mm", "displacement_mm", "deviations_mm"):
            if not np.isfinite(getattr(self, name)).all():
                raise ConfigError(f"{name} of the gel's face is not finite; leave such data out.")
        if len(self.axes) and self.deviations_mm.min() <= 0.0:
            raise ConfigError("deviations_mm of the gel's face must be positive.")

    @staticmethod
    def of(
        markers_mm: Float[np.ndarray, "m 2"],
        in_plane_mm: Float[np.ndarray, "m 2"],
        marker_noise_mm: float,
        points_mm: Float[np.ndarray, "p 2"],
        along_z_mm: Float[np.ndarray, " p"],
        depth_noise_mm: float,
    ) -> "FaceData":
        """Return the data of markers and of depths; those that are NaN are left out.

        Args:
            markers_mm: Rest positions of the markers.
            in_plane_mm: Their displacements along x and y.
            marker_noise_mm: Standard deviation of these.
            points_mm: Rest positions of points of known depth.
            along_z_mm: Their displacements along z.
            depth_noise_mm: Standard deviation of these.
        """
        seen, known = np.isfinite(in_plane_mm).all(axis=1), np.isfinite(along_z_mm)
        at, count = markers_mm[seen], int(seen.sum())
        return FaceData(
            np.concatenate([at, at, points_mm[known]]),
            np.repeat([0, 1, 2], [count, count, int(known.sum())]),
            np.concatenate([*in_plane_mm[seen].T, along_z_mm[known]]),
            np.repeat([marker_noise_mm, depth_noise_mm], [2 * count, int(known.sum())]),
        )

    def with_depth_errors(self, distance: EdgeDistance, edge_mm: float) -> "FaceData":
        """Return the data with errors as those of integrated slopes, and of a discretised gel.

        The stated deviations of the depth become independent and smooth errors, the latter as a
        Gaussian process with a Matern covariance of smoothness 3/2, and one of the level of the
        contact. Deviations near its edge are increased, since elements there do not follow the
        singular field (a gel with exact data had up to 4 % too much force otherwise); `edge_mm` is
        the length of the edges of elements there.
        """
        depth = self.axes == 2
        away, points = distance(self.points_mm), self.points_mm[depth]
        widened = np.where(np.abs(away) < _NEAR * edge_mm, _WIDENED, 1.0)
        if not depth.any():
            return replace(self, deviations_mm=self.deviations_mm * widened)
        length = _LENGTH * float(np.ptp(points, axis=0).max()) or 1.0
        apart = np.sqrt(3.0) * cdist(points, points) / length
        values, vectors = np.linalg.eigh((1.0 + apart) * np.exp(-apart))
        kept = values > _MIN_VARIANCE * values[-1]
        smooth = _SMOOTH * self.deviations_mm[depth, None] * vectors[:, kept] * values[kept] ** 0.5
        level = _STEP * float(np.ptp(self.displacement_mm[depth])) * (away[depth] >= 0.0)
        patterns = np.zeros((len(depth), kept.sum() + 1))
        patterns[depth] = np.column_stack([smooth, level])
        deviations = self.deviations_mm * np.where(depth, _ROUGH, 1.0) * widened
        return replace(self, deviations_mm=deviations, patterns_mm=patterns)

    def whiten(self, values: Float[np.ndarray, "d *k"]) -> Float[np.ndarray, "d *k"]:
        """Return data, or derivatives of them, whose errors are independent, of unit deviation."""
        whitened = solve_triangular(self._root, values.reshape(len(values), -1), lower=True)
        return np.asarray(whitened).reshape(values.shape)

    @cached_property
    def _root(self) -> Float[np.ndarray, "d d"]:
        """Lower triangular root of the covariance, mm."""
        covariance = np.diag(self.deviations_mm**2)
        if self.patterns_mm is not None:
            covariance += self.patterns_mm @ self.patterns_mm.T
        return np.linalg.cholesky(covariance)

    @cached_property
    def along_z(self) -> Float[np.ndarray, " d"]:
        """One for data along z, zero for others."""
        return (self.axes == 2).astype(float)

    def rows(
        self, points: Float[np.ndarray, "k 3"], triangles: Int[np.ndarray, "t 3"]
    ) -> sp.csr_matrix:
        """Return the map from displacements of the face's nodes (flat, mm) to the data.

        Data outside of the triangles of the face are those of the nearest one.
        """
        flat, queries = (np.pad(at[:, :2], ((0, 0), (0, 1))) for at in (points, self.points_mm))
        closest = closest_points(flat, triangles, queries)
        columns = 3 * triangles[closest.triangles] + self.axes[:, None]
        numbers = np.repeat(np.arange(len(self.axes)), 3)
        shape = (len(self.axes), 3 * len(points))
        shares = closest.barycentric.ravel()
        return sp.csr_matrix((shares, (numbers, columns.ravel())), shape=shape)
