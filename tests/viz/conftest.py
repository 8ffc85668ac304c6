import numpy as np
import pytest

from tactorch.mesh import TetMesh, box_mesh

CENTRE = np.array([14.0, 6.0, 12.0])
RADIUS = 4.0


@pytest.fixture(scope="session")
def cube() -> TetMesh:
    return box_mesh(20.0, 8)


@pytest.fixture(scope="session")
def sphere_map(cube: TetMesh) -> np.ndarray:
    """1 MPa in a sphere that sits elsewhere on every axis, 0.2 MPa around it."""
    inside = np.linalg.norm(cube.centroids - CENTRE, axis=1) < RADIUS
    return np.where(inside, 1.0, 0.2)
