"""A gel pressed on a cube, both in one simulation that shares the nodes where they touch.

That is contact without slip.
"""

from dataclasses import dataclass

import numpy as np

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelModel, GelOptions

GEL = GelLayer(4.0, 0.12, 0.45, size_mm=(10.0, 10.0))


@dataclass
class Pair:
    """Both bodies in equilibrium, the gel's window pushed down."""

    cube: TetMesh
    u_cube: np.ndarray
    on_cube: np.ndarray  # forces of the gel on the cube's nodes
    bottom: np.ndarray
    model: GelModel
    u_gel: np.ndarray  # of its face's nodes, in the sensor's frame, against its window


def sensor_pose(z_mm: float) -> np.ndarray:
    """Looking down on the cube's top: x along y, y along x, z down."""
    pose = np.eye(4)
    pose[:3, :3] = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
    pose[:3, 3] = (5.0, 5.0, z_mm)
    return pose


FIRST = sensor_pose(10.0)


def pressed(depth_mm: float) -> Pair:
    """Push the gel's window down."""
    model = GelModel(GEL, GelOptions(1.0, 3, "tet4"))
    cube = box_mesh(10.0, 10)
    above = model.gel_mesh.mesh.points @ FIRST[:3, :3].T + FIRST[:3, 3]
    top = np.flatnonzero(cube.points[:, 2] > 9.999)
    face = model.gel_mesh.face
    twin = {tuple(np.round(cube.points[i], 6)): i for i in top}
    number = np.arange(len(above)) + cube.n_points
    number[face] = [twin[tuple(np.round(above[i], 6))] for i in face]
    kept = np.setdiff1d(np.arange(len(above)), face)
    number[kept] = cube.n_points + np.arange(len(kept))
    both = TetMesh.create(
        np.concatenate([cube.points, above[kept]]),
        np.concatenate([cube.tets, number[model.gel_mesh.mesh.tets]]),
    )
    youngs = np.full(both.n_tets, 0.2)
    youngs[cube.n_tets :] = 0.12
    hard = np.linalg.norm(cube.centroids - (6.0, 5.0, 7.0), axis=1) < 2.0
    youngs[: cube.n_tets][hard] = 1.0
    fixed, prescribed = np.zeros(both.points.shape, dtype=bool), np.zeros(both.points.shape)
    fixed[both.points[:, 2] < 1e-9] = True
    window = number[model.gel_mesh.window]
    fixed[window] = True
    prescribed[window] = (0.0, 0.0, -depth_mm)
    body = SoftBody(both, make_material("neo_hookean", 0.45))
    still = np.zeros(both.points.shape)
    u = body.equilibrate(youngs, still, Supports(fixed, prescribed)).require().displacement
    alone = SoftBody(cube, make_material("neo_hookean", 0.45))
    bottom = fixed[: cube.n_points]
    own = Supports(bottom | (cube.points[:, 2:] > 9.999), u[: cube.n_points])
    found = alone.equilibrate(youngs[: cube.n_tets], still[: cube.n_points], own).require()
    inner = alone.assembly.internal_force(found.response, youngs[: cube.n_tets])
    on_cube = np.where(cube.points[:, 2:] > 9.999, inner, 0.0)
    u_gel = (u[number[face]] + (0.0, 0.0, depth_mm)) @ FIRST[:3, :3]
    return Pair(cube, u[: cube.n_points], on_cube, bottom, model, u_gel)
