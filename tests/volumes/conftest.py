"""Small labelled volumes."""

from pathlib import Path

import numpy as np
import pytest


def block(shape: tuple[int, int, int] = (14, 14, 10), radius: float = 2.6) -> np.ndarray:
    """A block of label 1 with a ball of label 2; one layer of background around."""
    labels = np.zeros(shape, dtype=np.int16)
    labels[1:-1, 1:-1, 1:-1] = 1
    centre = (np.array(shape) - 1.0) / 2.0
    offsets = np.indices(shape).transpose(1, 2, 3, 0) - centre
    labels[np.linalg.norm(offsets, axis=-1) < radius] = 2
    return labels


@pytest.fixture(scope="session")
def block_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The block with voxels of 1 mm."""
    path = tmp_path_factory.mktemp("volumes") / "block.npz"
    np.savez(path, labels=block(), spacing_mm=[1.0, 1.0, 1.0])
    return path
