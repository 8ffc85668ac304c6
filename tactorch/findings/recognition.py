"""Which of the shapes that a recognizer knows a map shows (Section V-B)."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from tactorch.learning.recognizer.network import Recognizer
from tactorch.learning.training import BEST, rebuild
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics.checks import check_on_mesh

_VOXELS = 24  # as recognizers are trained by default; the network takes any number


def load_recognizer(path: str | Path) -> Recognizer:
    """Read a trained recognizer: the folder of its run, of one of its splits, or a checkpoint.

    Raises:
        FileError: The checkpoint is missing, damaged or of another network.
    """
    place = Path(path)
    if place.is_dir():
        found = [place / BEST, *sorted(place.glob(f"split-*/{BEST}"))]
        place = next((file for file in found if file.is_file()), found[0])
    advice = "give the run of `tactorch train experiment=recognizer`"
    return rebuild(Recognizer, place, "recognizer", advice)


def recognise(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    recognizer: Recognizer,
    *,
    voxels: int = _VOXELS,
) -> dict[str, float]:
    """Return the probability of each shape, the likeliest first.

    The answer is one of the shapes that the recognizer was trained on, whatever the map shows.

    Args:
        mesh: The body.
        youngs: Moduli, (m,), MPa.
        recognizer: A trained one, see `load_recognizer`.
        voxels: In each direction, as it was trained.

    Raises:
        MeshError: The map is not over the elements of the mesh.
    """
    check_on_mesh(mesh, "youngs", youngs)
    grid = VoxelGrid(mesh, voxels)
    shown = torch.from_numpy(np.log(grid.fill(youngs))).float()[None, None]
    with torch.no_grad():
        chances = recognizer.eval()(shown).softmax(dim=1)[0].tolist()
    named = dict(zip(recognizer.classes, chances, strict=True))
    return dict(sorted(named.items(), key=lambda item: -item[1]))
