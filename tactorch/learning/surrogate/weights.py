"""Trained weights: those of tactorch and those of other runs."""

import io
from pathlib import Path
from typing import Any

import torch

from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.learning.surrogate.network import Surrogate
from tactorch.learning.training import read_checkpoint, rebuild

#: The surrogate of tactorch; surrogate.json states how it was made.
SHIPPED = Path(__file__).with_name("surrogate.pt")
_EXPORTED = ("state_dict", "hyper_parameters")


def load_surrogate(path: Path) -> Surrogate:
    """Make a surrogate from a checkpoint, or from weights that `export` wrote; in evaluation mode.

    Raises:
        FileError: The file is missing, damaged or of another model.
    """
    if path == SHIPPED and not path.is_file():
        raise FileError(
            f"the surrogate's weights are missing from this installation ('{path}'); reinstall"
            " tactorch, or make them with train/surrogate.py and give initialization.weights=FILE."
        )
    advice = "give the best.ckpt of a run of `tactorch train model=surrogate data=warmstart`"
    return rebuild(Surrogate, path, "surrogate", advice)


def export(checkpoint: Path, path: Path) -> None:
    """Write a checkpoint's weights alone, in half precision: a fifth or so of its size.

    Raises:
        FileError: The checkpoint is missing or damaged.
    """
    content: dict[str, Any] = {
        k: v for k, v in read_checkpoint(checkpoint).items() if k in _EXPORTED
    }
    content["state_dict"] = {k: v.half() for k, v in content["state_dict"].items()}
    memory = io.BytesIO()
    torch.save(content, memory)
    with atomic_path(path) as temporary:
        temporary.write_bytes(memory.getvalue())
