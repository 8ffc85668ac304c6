from pathlib import Path

import numpy as np
import pytest

from tactorch.mesh import TetMesh, box_mesh


@pytest.fixture(scope="session")
def mesh() -> TetMesh:
    """A 3 x 2 x 1 mm box whose inner nodes are off the grid."""
    grid = box_mesh((3.0, 2.0, 1.0), (4, 3, 3))
    inner = np.ones(grid.n_points, bool)
    inner[grid.surface.nodes()] = False
    points = np.array(grid.points)
    points[inner] += np.random.default_rng(0).uniform(-0.05, 0.05, (inner.sum(), 3))
    return TetMesh(points, grid.tets)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"
