"""Recordings under wrong beliefs."""

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import InverseProblem, Nuisance
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, perturb_recording, simulate


@pytest.fixture(scope="module")
def recording() -> Recording:
    ball = make_phantom("cube_sphere")
    plan = PressPlan(("z+", "x-"), (0.01,))
    return simulate(ball, plan, mesh=ball.mesh(relative_edge_length=0.3))


def test_nuisance_values_undo_every_wrong_belief(recording: Recording) -> None:
    size = np.array([1.1, 0.95, 1.2])
    wrong = perturb_recording(recording, poisson=0.02, force_scale=1.2, size=size.tolist())
    values = Nuisance(0.45, force_scale=1 / 1.2, rest_scale=1 / size)
    truth = recording.truth
    assert truth is not None
    believed = InverseProblem(wrong).evaluate(truth)
    undone = InverseProblem(wrong).evaluate(truth, nuisance=values)
    assert undone.misfit_mm2 < 1e-16 < 1e-3 < believed.misfit_mm2


def test_an_enlarged_object_seems_softer(recording: Recording) -> None:
    """As Section V-C2 has it: more compression to the same deformed surface."""
    top = recording.presses[0]
    wrong = perturb_recording(recording, size=1.1).presses[0]
    down = recording.mesh.points[:, 2] > 9.99
    assert wrong.displacement[down, 2].mean() == pytest.approx(
        top.displacement[down, 2].mean() - 1.0, abs=0.01
    )


def test_no_wrong_belief_changes_nothing(recording: Recording) -> None:
    same = perturb_recording(recording)
    np.testing.assert_array_equal(same.mesh.points, recording.mesh.points)
    for a, b in zip(same.presses, recording.presses, strict=True):
        np.testing.assert_array_equal(a.displacement, b.displacement)
        np.testing.assert_array_equal(a.forces, b.forces)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"size": 0.0}, "size=0.0"), ({"size": (1, -1, 1)}, "size="), ({"force_scale": -1}, "force")],
)
def test_factors_that_cannot_be_are_refused(
    recording: Recording, wrong: dict[str, object], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        perturb_recording(recording, **wrong)
