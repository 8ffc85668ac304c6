"""Tractions that nodal forces stand for."""

import numpy as np
import pytest

from tactorch.fem import ELEMENTS, Discretisation
from tactorch.mesh import box_mesh, face_nodes
from tactorch.mesh.tractions import LoadedSurface

MESH = box_mesh(10.0, 4, tets_per_cell=5)
TOP = face_nodes(MESH, "z+")


def _forces(tractions: np.ndarray) -> np.ndarray:
    """Integrals of a traction that is linear on each triangle of the top times hat functions."""
    indicator = np.zeros((MESH.n_points, 3))
    indicator[TOP] = 1.0
    out: np.ndarray = LoadedSurface.of(MESH.surface, indicator).mass @ tractions
    return out


def test_a_linear_traction_is_recovered() -> None:
    expected = np.zeros((MESH.n_points, 3))
    expected[TOP] = [0.1, 0.2, -0.3]
    expected[TOP, 2] += 0.05 * MESH.points[TOP, 0]
    forces = _forces(expected)
    found = LoadedSurface.of(MESH.surface, forces).tractions(forces)
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_forces_of_a_pressure_are_those_of_thirds_of_the_areas() -> None:
    pressure = np.zeros((MESH.n_points, 3))
    pressure[TOP, 2] = -0.1
    surface = MESH.surface
    top = (surface.normals[:, 2] > 0.9) & np.isin(surface.triangles, TOP).all(axis=1)
    expected = np.zeros(MESH.n_points)
    np.add.at(expected, surface.triangles[top].ravel(), np.repeat(-0.1 * surface.areas[top] / 3, 3))
    np.testing.assert_allclose(_forces(pressure)[:, 2], expected, atol=1e-15)


def test_loads_of_quadratic_elements_do_the_work_of_the_traction() -> None:
    """The virtual work on a quadratic field, against the integral over the square."""
    tractions = np.zeros((MESH.n_points, 3))
    tractions[TOP, 2] = MESH.points[TOP, 0]
    discretisation = Discretisation(MESH, ELEMENTS["tet10"])
    loads = discretisation.consistent_loads(_forces(tractions))
    x, y, _ = discretisation.positions.T
    assert loads[:, 2] @ x**2 == pytest.approx(10.0**4 / 4 * 10.0)
    assert loads[:, 2] @ (x * y) == pytest.approx(10.0**3 / 3 * 50.0)


def test_nothing_loaded_is_no_traction() -> None:
    nothing = np.zeros((MESH.n_points, 3))
    assert not LoadedSurface.of(MESH.surface, nothing).tractions(nothing).any()
    np.testing.assert_array_equal(
        Discretisation(MESH, ELEMENTS["tet10"]).consistent_loads(nothing), 0.0
    )
