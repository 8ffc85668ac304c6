import pytest

from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import Phantom, make_phantom


@pytest.fixture(scope="session")
def phantom() -> Phantom:
    return make_phantom("cube_shallow_sphere")


@pytest.fixture(scope="session")
def mesh() -> TetMesh:
    """A coarse mesh of the paper's cube."""
    return box_mesh(10.0, 5, tets_per_cell=5)


@pytest.fixture(scope="session")
def fine() -> TetMesh:
    return box_mesh(10.0, 8, tets_per_cell=5)
