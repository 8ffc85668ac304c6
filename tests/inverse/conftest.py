from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tactorch.inverse import Evaluation, InverseProblem
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="session")
def phantom() -> Phantom:
    return make_phantom("cube_sphere", radius=0.3)


@pytest.fixture(scope="session")
def tiny() -> TetMesh:
    """A 10 mm cube of 40 tetrahedra."""
    return box_mesh(10.0, 2, tets_per_cell=5)


@pytest.fixture(scope="session")
def make_tiny(phantom: Phantom, tiny: TetMesh) -> Callable[..., Recording]:
    """Press the tiny cube; keywords go to `simulate`."""

    def make(
        faces: tuple[str, ...] = ("z+", "x-"),
        pressures: tuple[float, ...] = (0.01,),
        support: str = "springs",
        **settings: Any,
    ) -> Recording:
        plan = PressPlan(faces, pressures, support=support)
        return simulate(phantom, plan, mesh=tiny, samples=4, **settings)

    return make


@pytest.fixture(scope="session")
def recording(make_tiny: Callable[..., Recording]) -> Recording:
    """Two presses on the tiny cube: as many data as an optimizer needs to move."""
    return make_tiny()


@pytest.fixture(scope="session")
def make_cube() -> Callable[..., Recording]:
    """Press a cube of 135 tetrahedra with a large stiff ball; keywords go to `simulate`."""

    def make(faces: tuple[str, ...] = ("z+", "x+", "y-"), **settings: Any) -> Recording:
        ball = make_phantom("cube_sphere", radius=0.45)
        mesh = box_mesh(10.0, 3, tets_per_cell=5)
        return simulate(ball, PressPlan(faces, (0.01,)), mesh=mesh, samples=4, **settings)

    return make


@pytest.fixture(scope="session")
def cube(make_cube: Callable[..., Recording]) -> Recording:
    """Three presses without noise."""
    return make_cube()


@pytest.fixture
def moduli(recording: Recording) -> np.ndarray:
    """A map that is neither the truth nor uniform, MPa."""
    return np.random.default_rng(3).uniform(0.15, 0.6, recording.mesh.n_tets)


@pytest.fixture
def fail_evaluation(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, BaseException], None]:
    """Make the nth evaluation from now on raise an exception."""

    def arrange(nth: int, error: BaseException) -> None:
        original, count = InverseProblem.evaluate, iter(range(1, 10**6))

        def evaluate(self: InverseProblem, *args: Any, **others: Any) -> Evaluation:
            if next(count) == nth:
                raise error
            return original(self, *args, **others)

        monkeypatch.setattr(InverseProblem, "evaluate", evaluate)

    return arrange
