"""The correction of the discretisation under a finger on a coarse mesh."""

import numpy as np
import pytest

from tactorch.inverse.fields import ShapeField, ShapePrior
from tactorch.inverse.fit.shapes import fit_shapes
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.search.correction import Correction
from tactorch.mesh import TetMesh, box_mesh, face_nodes, refine
from tactorch.recording import MaterialSpec, Press, Recording

RADIUS, PRESSURE = 2.0, 0.03  # mm, MPa
CENTER = np.array([5.2, 4.9])
POINTS = 12  # along the edge of a triangle, for integrals


def _forces(mesh: TetMesh) -> np.ndarray:
    """Integrals of a parabolic pressure times the hat functions of the top."""
    surface = mesh.surface
    top = surface.normals[:, 2] > 0.9
    corners, out = mesh.points[surface.triangles[top]], np.zeros((mesh.n_points, 3))
    n = POINTS
    lattice = [(i + s, j + s) for s, m in ((1 / 3, n), (2 / 3, n - 1))
               for i in range(m) for j in range(m - i)]  # fmt: skip
    for i, j in lattice:
        weights = np.array([1.0 - (i + j) / n, i / n, j / n])
        squares = ((np.einsum("c,tcd->td", weights, corners)[:, :2] - CENTER) ** 2).sum(axis=1)
        load = np.clip(1.0 - squares / RADIUS**2, 0.0, None) * surface.areas[top] / len(lattice)
        np.add.at(out[:, 2], surface.triangles[top], -PRESSURE * load[:, None] * weights)
    return out


def _recording(mesh: TetMesh, observed: np.ndarray) -> Recording:
    """A finger on a uniform block that is held at the bottom, observed at some nodes."""
    shape = (mesh.n_points, 3)
    fixed, seen = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    seen[observed] = True
    displacement = np.where(seen, -0.1, np.nan)
    press = Press(_forces(mesh), seen, displacement, fixed=fixed, noise_mm=0.01)
    return Recording(mesh, (press,), MaterialSpec("neo_hookean", 0.4), check_units=False)


@pytest.mark.slow
def test_the_error_under_a_finger_is_corrected():
    """Nodal forces at edges of 0.4 of the radius: a fifth of the error remains."""
    mesh = box_mesh(10.0, 12, tets_per_cell=5)
    top = face_nodes(mesh, "z+")
    under = top[np.linalg.norm(mesh.points[top, :2] - CENTER, axis=1) < RADIUS]
    field = ShapeField(ShapePrior.of(mesh, 0.2))

    def sizing(points: np.ndarray) -> np.ndarray:
        across = np.linalg.norm(points[:, :2] - CENTER, axis=1) - RADIUS
        return 0.25 + 0.7 * np.hypot(np.maximum(across, 0.0), points[:, 2] - 10.0)

    fine = InverseProblem(
        _recording(refine(mesh, sizing).mesh, under), element="tet10", solver="p_multigrid"
    )
    exact = fine.evaluate(np.full(fine.recording.mesh.n_tets, 0.2))
    problem = InverseProblem(_recording(mesh, under), element="tet10")
    fit, coarse = fit_shapes(problem, field, np.zeros(1), max_iterations=0)
    (offset,) = Correction.of(problem).offsets(fit, coarse)
    error = (exact.reported[0][under] - coarse.reported[0][under]).ravel()
    assert np.linalg.norm(error) > 0.005 * np.linalg.norm(exact.reported[0][under])
    assert np.linalg.norm(error - offset) < 0.25 * np.linalg.norm(error)
