import numpy as np
import pytest

from tactorch.mesh import Box, Sphere, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="session")
def recording() -> Recording:
    """Two load steps on each of two sides of a cube with a stiff ball, with noise."""
    ball = Phantom(Box((5.0,) * 3, (10.0,) * 3), [(Sphere((6.0, 4.5, 6.0), 3.0), 1.0)], 0.2)
    mesh = box_mesh(10.0, 4, center_mm=(5.0, 5.0, 5.0), tets_per_cell=5)
    plan = PressPlan(("z+", "x-"), (0.005, 0.01))
    return simulate(ball, plan, mesh=mesh, samples=4, snr_db=40.0, seed=1)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)
