"""The weights that come with tactorch: small, told of, and of use out of the box."""

import json

import numpy as np
import pytest

from tactorch.inverse import Bounds, InverseProblem
from tactorch.inverse.starts import homogeneous
from tactorch.learning.surrogate import SurrogateStart
from tactorch.learning.surrogate.weights import SHIPPED
from tactorch.mesh import Box, Sphere
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def start() -> SurrogateStart:
    return SurrogateStart()


def test_they_are_small_and_say_what_they_were_made_of() -> None:
    assert SHIPPED.stat().st_size < 5e6
    note = json.loads(SHIPPED.with_suffix(".json").read_text())
    recipe = note["dataset"]["recipe"]
    assert recipe["name"] == "warmstart"
    assert recipe["count"] == 3000
    assert len(note["dataset"]["shards"]) == recipe["count"] / recipe["shard"]
    assert any("surrogate" in line for line in note["training"])
    assert note["test part"]["samples"] == 150


@pytest.mark.parametrize("size_mm", [10.0, 40.0])
def test_a_ball_is_seen_at_once(start: SurrogateStart, size_mm: float) -> None:
    """A stiff ball that no training object is like, in a cube of another size too."""
    s = size_mm / 10.0
    ball = Phantom(
        Box((5.0 * s,) * 3, (size_mm,) * 3),
        [(Sphere((6.0 * s, 4.5 * s, 6.5 * s), 2.2 * s), 0.9)],
        0.2,
    )
    plan = PressPlan(("z+", "x+", "y+"), (0.01,), spring_n_per_mm=s)
    recording = simulate(
        ball, plan, mesh=ball.mesh(0.17 * size_mm, generator="structured"),
        fine_mesh=ball.mesh(0.12 * size_mm, generator="structured"), samples=4,
        snr_db=40.0, seed=0,
    )  # fmt: skip
    assert recording.truth is not None
    found = start.foretell(recording)
    assert np.corrcoef(found.youngs, recording.truth)[0, 1] > 0.8
    problem = InverseProblem(recording)
    uniform = homogeneous(problem, Bounds())
    taken = start(problem, Bounds())
    assert problem.evaluate(taken).chi2 < 0.2 * problem.evaluate(uniform).chi2


def test_it_knows_where_it_does_not_know(start: SurrogateStart, recording: Recording) -> None:
    """Deviations are larger far from the pressed sides than near them."""
    found = start.foretell(recording)  # pressed on z+ and x-
    x, _, z = recording.mesh.centroids.T
    near, far = (z > 7.0) | (x < 3.0), (z < 4.0) & (x > 6.0)
    assert found.deviation[far].mean() > 1.2 * found.deviation[near].mean()
