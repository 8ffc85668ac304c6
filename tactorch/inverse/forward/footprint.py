"""The part of the surface that a press loads: nodes with forces, or where its probe touches."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice
from tactorch.recording import Press, ProbePose

_SAMPLES = 16  # points along the edges of triangles near a probe
# Depth of undeformed points within a probe, over the largest, from which they touch it. On a
# half-space a ball at a depth d touches a disc of the radius sqrt(R d) (Hertz), half as deep there.
_TOUCHED = 0.5


def loaded_nodes(press: Press, mesh: TetMesh) -> Bool[np.ndarray, " n"]:
    """Return the nodes with forces, and those of the surface that the probe touches."""
    loaded: np.ndarray = (press.forces != 0.0).any(axis=1)
    if press.probe is not None:
        nodes = mesh.surface.nodes()
        depths = press.probe.depths(mesh.points[nodes])
        touched = depths > _TOUCHED * float(depths.max())
        if not touched.any():  # the probe is between nodes
            touched[press.probe.distances(mesh.points[nodes]).argmin()] = True
        loaded[nodes[touched]] = True
    return loaded


def largest_depth(pose: ProbePose, mesh: TetMesh) -> float:
    """Return the largest depth of the undeformed surface within a probe, mm."""
    return float(pose.depths(_samples_near(pose, mesh)[0]).max(initial=0.0))


class Footprint(NamedTuple):
    """Where a probe touches the undeformed surface."""

    points: Float[np.ndarray, "k 3"]  # of the touched part, mm
    rim: Float[np.ndarray, "r 3"]  # those of them at its rim
    radius_mm: float  # of a disc of its area

    @staticmethod
    def of(pose: ProbePose, mesh: TetMesh) -> "Footprint":
        """Return the footprint of a probe.

        Raises:
            ConfigError: the probe does not touch the surface.
        """
        points, areas = _samples_near(pose, mesh)
        depths = pose.depths(points)
        if not depths.any():
            raise ConfigError(
                f"The probe at {np.round(pose.position_mm, 3).tolist()} mm does not touch the body;"
                " check its position (mm) and the axes."
            )
        touched = depths > _TOUCHED * depths.max()
        radius = float(np.sqrt(areas[touched].sum() / np.pi))
        spacing = 2.0 * float(np.sqrt(areas[touched].max()))
        beside, _ = cKDTree(points[~touched]).query(points[touched])
        return Footprint(points[touched], points[touched][beside < spacing], radius)


def _samples_near(
    pose: ProbePose, mesh: TetMesh
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Return points of the surface triangles near a probe (mm), and the area of each (mm^2)."""
    surface, corners = mesh.surface, mesh.points[mesh.surface.triangles]
    reach = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    near = np.flatnonzero(pose.distances(corners.mean(axis=1)) < reach)
    samples = lattice(_SAMPLES, corners=3)
    points = np.einsum("sc,tcd->tsd", samples, corners[near]).reshape(-1, 3)
    return points, np.repeat(surface.areas[near] / len(samples), len(samples))
