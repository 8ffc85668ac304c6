"""The weights that come with tactorch: small, told of, and of use out of the box."""

import json

import numpy as np
import pytest

from tactorch.inverse import Bounds, InverseProblem, homogeneous
from tactorch.learning.surrogate import Prediction, SurrogateStart
from tactorch.learning.surrogate.network import INCLUDED_WEIGHTS, WEIGHT_BITS
from tactorch.mesh import Box, Sphere, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@pytest.fixture(scope="module")
def start() -> SurrogateStart:
    return SurrogateStart()


def test_they_are_small_and_say_what_they_were_made_of() -> None:
    assert INCLUDED_WEIGHTS.stat().st_size < 1e6
    note = json.loads(INCLUDED_WEIGHTS.with_suffix(".json").read_text())
    recipe = note["dataset"]["recipe"]
    assert recipe["name"] == "warmstart"
    assert recipe["count"] == 3000
    assert len(note["dataset"]["shards"]) == recipe["count"] / recipe["shard"]
    assert any("surrogate" in line for line in note["training"])
    assert note["test part"]["samples"] == 150
    assert note["bits per weight"] == WEIGHT_BITS


@pytest.mark.parametrize("size_mm", [10.0, pytest.param(40.0, marks=pytest.mark.slow)])
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
    found = start.predict(recording)
    assert np.corrcoef(found.youngs, recording.truth)[0, 1] > 0.8
    problem = InverseProblem(recording)
    uniform = homogeneous(problem, Bounds())
    taken = start(problem, Bounds())
    assert problem.evaluate(taken).chi2 < 0.2 * problem.evaluate(uniform).chi2


def test_it_knows_where_it_does_not_know(start: SurrogateStart) -> None:
    """A ball in the middle: surer near the pressed side, and with more sides pressed."""
    ball = Phantom(Box((5.0,) * 3, (10.0,) * 3), [(Sphere((5.0,) * 3, 2.2), 1.0)], 0.2)
    mesh, fine = (box_mesh(10.0, n, tets_per_cell=5) for n in (6, 8))

    def pressed(*faces: str) -> tuple[Prediction, Recording]:
        plan = PressPlan(faces, (0.01,))
        recording = simulate(
            ball, plan, mesh=mesh, fine_mesh=fine, samples=4, snr_db=40.0, seed=1
        )  # fmt: skip
        return start.predict(recording), recording

    (one, recording), (five, _) = pressed("z+"), pressed("z+", "x+", "y+", "x-", "y-")
    z, truth = mesh.centroids[:, 2], recording.truth
    assert one.deviation[z < 3.3].mean() > 1.4 * one.deviation[z > 6.7].mean()
    assert one.deviation.mean() > 1.5 * five.deviation.mean()
    off = [np.sqrt(np.mean(np.log(found.youngs / truth) ** 2)) for found in (one, five)]
    assert off[0] > 1.3 * off[1]
