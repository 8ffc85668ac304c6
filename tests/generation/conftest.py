from collections.abc import Callable
from typing import Any

import pytest

from tactorch.generation import MeshSizes, PressDraw, Recipe


@pytest.fixture(scope="session")
def make_recipe() -> Callable[..., Recipe]:
    """Makes recipes of samples that take a moment each."""

    def make(**changes: Any) -> Recipe:
        usual = {
            "name": "tiny",
            "count": 5,
            "family": {"name": "inclusions", "count": (1, 1), "shapes": ["ball", "box"]},
            "presses": PressDraw(faces=(("z+",), ("z+", "x+")), steps=(1, 2)),
            "mesh": MeshSizes(relative_edge_length=0.3, fine_relative=0.2),
            "samples": 1,
            "snr_db": (30.0, 40.0),
            "shard": 2,
        }
        return Recipe(**{**usual, **changes})

    return make
