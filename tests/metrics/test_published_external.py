"""The scores that the authors of the published cases printed, reproduced from their own maps."""

from pathlib import Path

import pytest

from tactorch.importers import import_published
from tactorch.metrics import find_inclusion, pearson, psnr, rmse_mpa, scores, ssim_1d

pytestmark = pytest.mark.external


# reference_scores.txt of each case; the range is that of the authors' fixed scale of colours.
@pytest.mark.parametrize(
    ("case", "range_mpa", "rmse", "similarity", "peak", "correlation"),
    [
        ("box-3", 1.499, 0.089406, 0.894493, 24.488701, 0.903809),
        ("box-torus", 3.999, 0.695870, 0.575985, 15.188466, 0.800183),
    ],
)
def test_reference_scores(
    shared_data: Path,
    case: str,
    range_mpa: float,
    rmse: float,
    similarity: float,
    peak: float,
    correlation: float,
) -> None:
    recording = import_published(shared_data / "published-elastography" / case)
    found, truth = recording.reference, recording.truth
    assert found is not None
    assert truth is not None
    assert rmse_mpa(found, truth) == pytest.approx(rmse, abs=1e-6)
    assert ssim_1d(found, truth, range_mpa=range_mpa) == pytest.approx(similarity, abs=1e-6)
    assert psnr(found, truth, range_mpa=range_mpa) == pytest.approx(peak, abs=1e-6)
    assert pearson(found, truth) == pytest.approx(correlation, abs=1e-6)


def test_the_torus_is_found(shared_data: Path) -> None:
    """A torus of about 1.5 MPa around the axis of the box, 6 mm up, in a body of 0.1 MPa."""
    recording = import_published(
        shared_data / "published-elastography" / "box-torus", relabel_truth={3.0: 1.5}
    )
    mesh, found, truth = recording.mesh, recording.reference, recording.truth
    assert found is not None
    assert truth is not None
    torus = find_inclusion(mesh, truth)
    assert torus is not None
    assert torus.contrast == pytest.approx(15.0)
    assert torus.center_mm == pytest.approx([0, 0, 6], abs=0.1)
    part = find_inclusion(mesh, found)
    assert part is not None
    assert part.side == "stiff"
    assert scores(mesh, found, truth)["position_error_mm"] < 0.5
