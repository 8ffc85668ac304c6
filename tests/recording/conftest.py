from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import MaterialSpec, Press, Recording


@pytest.fixture
def box() -> TetMesh:
    return box_mesh(10.0, 2)


@pytest.fixture
def fields(box: TetMesh) -> dict[str, Any]:
    """A press on top of the box, held by springs below: what Press(**fields) takes."""
    top = box.points[:, 2] == 10.0
    forces = np.zeros((box.n_points, 3))
    forces[top, 2] = -0.1
    springs = np.zeros((box.n_points, 3))
    springs[box.points[:, 2] == 0.0] = 1.0
    observed = np.zeros((box.n_points, 3), dtype=bool)
    observed[top] = True
    displacement = np.full((box.n_points, 3), np.nan)
    displacement[top] = (0.1, 0.0, -0.5)
    return {
        "forces": forces,
        "observed": observed,
        "displacement": displacement,
        "springs": springs,
        "name": "top",
    }


@pytest.fixture
def record(box: TetMesh, fields: dict[str, Any]) -> Callable[..., Recording]:
    """Build a recording of one press; keywords go to the recording."""

    def make(press: dict[str, Any] | None = None, **changes: Any) -> Recording:
        parts: dict[str, Any] = {
            "mesh": box,
            "presses": (Press(**{**fields, **(press or {})}),),
            "material": MaterialSpec("neo_hookean", 0.45),
        }
        return Recording(**{**parts, **changes})

    return make
