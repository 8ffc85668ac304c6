"""The audit of the truth must correct wrong labels, and leave right ones and unfit ones alone."""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.simulation import PressPlan, simulate

NAME = "published"


@pytest.fixture(scope="module")
def recording() -> Recording:
    ball = make_phantom("cube_sphere", radius=0.35)
    return simulate(ball, PressPlan(("z+", "x+"), (0.01,)), mesh=box_mesh(10.0, 3))


def test_a_right_truth_is_kept(benchmark: ModuleType, recording: Recording):
    truth, note = benchmark.audited_truth(recording)
    assert truth is recording.truth
    assert note == ""


def test_a_wrong_label_is_corrected_by_the_presses(benchmark: ModuleType, recording: Recording):
    right = recording.truth
    assert right is not None
    wrong = np.where(right > 0.5, 2.0, right)
    truth, note = benchmark.audited_truth(replace(recording, truth=wrong))
    assert np.allclose(truth, right)
    assert "2 -> 1 MPa" in note


def test_a_wrong_material_is_not_taken_for_a_wrong_label(
    benchmark: ModuleType, recording: Recording
):
    other = replace(recording, material=MaterialSpec("neo_hookean", 0.3))
    truth, note = benchmark.audited_truth(other)
    assert np.array_equal(truth, recording.truth)
    assert "another Poisson's ratio or lame factor" in note


def test_without_truth_there_is_nothing_to_audit(benchmark: ModuleType, recording: Recording):
    assert benchmark.audited_truth(replace(recording, truth=None)) == (None, "")
