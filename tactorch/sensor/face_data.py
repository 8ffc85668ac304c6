"""Displacements of the gel's outer face as they are measured, each with its deviation.

Markers measure displacements in the plane at their positions, the depth along z anywhere.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.mesh.closest import closest_points


@dataclass(frozen=True, eq=False)
class FaceData:
    """Displacements of points of the gel's outer face along x, y or z of the sensor.

    Attributes:
        points_mm: Rest positions in the plane, (d, 2), mm.
        axes: Axis of each datum: 0, 1 or 2.
        displacement_mm: Displacements, (d,), mm.
        deviations_mm: Standard deviations, (d,), mm.

    Raises:
        ConfigError: A value is not finite, or a deviation is not positive.
    """

    points_mm: Float[np.ndarray, "d 2"]
    axes: Int[np.ndarray, " d"]
    displacement_mm: Float[np.ndarray, " d"]
    deviations_mm: Float[np.ndarray, " d"]

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

    @cached_property
    def along_z(self) -> Float[np.ndarray, " d"]:
        """One for data along z, zero for others."""
        return (self.axes == 2).astype(float)

    def rows(
        self, points: Float[np.ndarray, "k 3"], triangles: Int[np.ndarray, "t 3"]
    ) -> sp.csr_matrix:
        """Return the map from displacements of the face's nodes (flat, mm) to the data.

        Args:
            points: Nodes of the face at rest, mm.
            triangles: Triangles of the face.
        """
        owners, shares = _locate(points[:, :2], triangles, self.points_mm)
        columns = 3 * triangles[owners] + self.axes[:, None]
        numbers = np.repeat(np.arange(len(self.axes)), 3)
        shape = (len(self.axes), 3 * len(points))
        return sp.csr_matrix((shares.ravel(), (numbers, columns.ravel())), shape=shape)


def _locate(
    nodes: Float[np.ndarray, "k 2"],
    triangles: Int[np.ndarray, "t 3"],
    points: Float[np.ndarray, "d 2"],
) -> tuple[Int[np.ndarray, " d"], Float[np.ndarray, "d 3"]]:
    """Return the triangle of each point with barycentric coordinates; the nearest if outside."""
    flat = np.column_stack([nodes, np.zeros(len(nodes))])
    queries = np.column_stack([points, np.zeros(len(points))])
    closest = closest_points(flat, triangles, queries)
    return closest.triangles, closest.barycentric
