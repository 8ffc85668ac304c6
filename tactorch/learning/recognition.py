"""Recognition of the inclusion's shape by a trained network (Section V-B)."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from tactorch.learning.recognizer import Recognizer
from tactorch.learning.training import BEST, load_network
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics.segment import check_field


def load_recognizer(path: str | Path) -> Recognizer:
    """Read a trained recognizer: the folder of its run, of one of its splits, or a checkpoint."""
    checkpoint = Path(path)
    if checkpoint.is_dir():
        files = [checkpoint / BEST, *sorted(checkpoint.glob(f"split-*/{BEST}"))]
        checkpoint = next((file for file in files if file.is_file()), files[0])
    advice = "give the run of `tactorch train experiment=recognizer`"
    return load_network(Recognizer, checkpoint, "recognizer", advice)


def recognise(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], recognizer: Recognizer, *, voxels: int = 24
) -> dict[str, float]:
    """Return the probability of each shape, in descending order.

    Only shapes that the recognizer was trained on are considered. The map has `voxels` in each
    direction, 24 by default as in training; the network accepts any number.
    """
    check_field("youngs", youngs, mesh)
    grid = VoxelGrid(mesh, voxels)
    volume = torch.from_numpy(np.log(grid.fill(youngs))).float()[None, None]
    with torch.no_grad():
        probabilities = recognizer.eval()(volume).softmax(dim=1)[0].tolist()
    by_name = dict(zip(recognizer.classes, probabilities, strict=True))
    return dict(sorted(by_name.items(), key=lambda item: -item[1]))
