"""Pressers and sessions of a robot without mechanics."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_fakes import DOWN

from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import MaterialSpec
from tactorch.robot import RobotPresser, RobotSession, StopRule
from tactorch.sampling import Patch


@pytest.fixture(scope="session")
def mesh() -> TetMesh:
    return box_mesh(10.0, 5, tets_per_cell=5)


@pytest.fixture(scope="session")
def patches() -> list[Patch]:
    return [Patch(np.array([x, y, 10.0]), DOWN, 2.5) for x, y in [(5, 5), (4, 4), (6, 6), (4, 6)]]


@pytest.fixture(scope="session")
def make_presser(mesh: TetMesh) -> Callable[..., RobotPresser]:
    def make(robot: Any, timeout_seconds: float = 30.0) -> RobotPresser:
        held = mesh.points[:, 2] < 1e-6
        law = MaterialSpec("neo_hookean", 0.45)
        return RobotPresser(robot, mesh, held, law, 0.01, 0.002, timeout_seconds)

    return make


@pytest.fixture
def make_session(
    make_presser: Callable[..., RobotPresser], patches: list[Patch], tmp_path: Path
) -> Callable[..., RobotSession]:
    def make(robot: Any, **options: Any) -> RobotSession:
        stop = options.pop("stop", StopRule())
        return RobotSession(make_presser(robot), patches, tmp_path, stop, **options)

    return make
