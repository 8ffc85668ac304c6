from collections.abc import Callable

import numpy as np
import pytest

from tactorch.inverse import InverseProblem
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="session")
def make_problem() -> Callable[..., InverseProblem]:
    """A small cube pressed from faces (z+ alone by default)."""

    def make(
        pressure: float = 0.01, divisions: int = 2, faces: tuple[str, ...] = ("z+",)
    ) -> InverseProblem:
        ball = make_phantom("cube_sphere", radius=0.3)
        mesh = box_mesh(10.0, divisions, tets_per_cell=5)
        plan = PressPlan(faces, (pressure,))
        return InverseProblem(simulate(ball, plan, mesh=mesh, samples=2))

    return make


@pytest.fixture
def moduli() -> np.ndarray:
    return np.random.default_rng(3).uniform(0.15, 0.6, 40)
