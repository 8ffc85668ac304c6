"""Generates the dataset of `test_generate.py` into the folder that it is given."""

import sys

from tactorch.generation import MeshSizes, PressDraw, Recipe, generate
from tactorch.inverse import GaussNewton, Settings

if __name__ == "__main__":
    recipe = Recipe(
        name="tiny",
        count=5,
        family={"name": "inclusions", "count": (1, 1), "shapes": ["ball", "box"]},
        presses=PressDraw(faces=(("z+",), ("z+", "x+")), steps=(1, 2)),
        mesh=MeshSizes(relative_edge_length=0.3, fine_relative=0.2),
        samples=1,
        snr_db=(30.0, 40.0),
        shard=2,
        inversion=Settings(GaussNewton(max_iterations=3)),
    )
    generate(recipe, sys.argv[1], workers=2)
