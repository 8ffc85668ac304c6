"""The published cases: our mechanics reproduce them, and our inversion beats their authors'."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.importers import import_published
from tactorch.inverse import InverseProblem, invert_map
from tactorch.metrics import pearson, rmse_mpa
from tactorch.recording import Recording

pytestmark = pytest.mark.external


def load(shared_data: Path, case: str) -> Recording:
    relabel = {3.0: 1.5} if case == "box-torus" else None
    return import_published(shared_data / "published-elastography" / case, relabel_truth=relabel)


@pytest.mark.parametrize(("case", "limit"), [("box-3", 2e-5), ("box-torus", 2e-4)])
def test_forward_solve_at_the_truth(shared_data: Path, case: str, limit: float) -> None:
    recording = load(shared_data, case)
    assert recording.truth is not None
    evaluation = InverseProblem(recording).evaluate(recording.truth)
    assert len(recording.presses) == 12
    for press, u in zip(recording.presses, evaluation.displacements, strict=True):
        seen = press.displacement[press.observed]
        error = np.linalg.norm(u[press.observed] - seen) / np.linalg.norm(seen)
        assert error < limit, press.label


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "correlation", "rmse"), [("box-3", 0.99, 0.03), ("box-torus", 0.995, None)]
)
def test_gauss_newton_beats_the_published_reconstruction(
    shared_data: Path, case: str, correlation: float, rmse: float | None
) -> None:
    recording = load(shared_data, case)
    assert recording.truth is not None
    assert recording.reference is not None
    found = invert_map(recording)
    assert found.stop_reason == "the data are fitted to their noise"
    assert pearson(found.youngs, recording.truth) >= correlation
    assert pearson(recording.reference, recording.truth) < correlation - 0.05
    if rmse is not None:
        assert rmse_mpa(found.youngs, recording.truth) <= rmse
