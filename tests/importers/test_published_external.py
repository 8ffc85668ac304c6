"""The importer on the published cases themselves, read in place."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.importers import import_published
from tactorch.recording import Recording

pytestmark = pytest.mark.external


def test_box_3(shared_data: Path, tmp_path: Path) -> None:
    recording = import_published(shared_data / "published-elastography" / "box-3")
    mesh = recording.mesh
    assert (mesh.n_points, mesh.n_tets, len(recording.presses)) == (340, 1130, 12)
    np.testing.assert_allclose(mesh.bounds, [[-5, -5, 0], [5, 5, 10]], atol=1e-9)
    assert mesh.volumes.sum() == pytest.approx(1000.0, rel=1e-6)
    np.testing.assert_allclose(mesh.points, np.round(mesh.points, 3), atol=1e-12)
    for index, press in enumerate(recording.presses):
        assert press.observed.sum() == 174
        assert set(np.unique(press.springs)) == {0.0, 1.0}
        assert np.linalg.norm(press.total_force) == pytest.approx(1.0 + index % 2)
        assert press.step == index % 2
        # What was pressed is what was seen; the files have 1e-17 N in other places.
        pressed = np.abs(press.forces).max(axis=1) > 1e-12
        np.testing.assert_array_equal(press.observed.any(axis=1), pressed)
        assert not (press.held & press.observed).any()
    np.testing.assert_allclose(recording.presses[2].direction, [-1, 0, 0], atol=1e-9)
    assert recording.truth is not None
    assert recording.truth.min() == pytest.approx(0.220, abs=1e-3)
    recording.save(tmp_path / "box-3.h5")
    again = Recording.load(tmp_path / "box-3.h5")
    np.testing.assert_array_equal(
        again.presses[11].displacement, recording.presses[11].displacement
    )


def test_box_torus(shared_data: Path) -> None:
    recording = import_published(
        shared_data / "published-elastography" / "box-torus", relabel_truth={3.0: 1.5}
    )
    assert (recording.mesh.n_points, recording.mesh.n_tets) == (722, 3130)
    assert [press.name for press in recording.presses] == [str(i) for i in range(1, 13)]
    np.testing.assert_allclose(recording.presses[0].direction, [-(0.5**0.5), -(0.5**0.5), 0])
    # Presses 5 to 8 push the top with 0.3, 0.6, 0.9 and 1.2 N.
    assert [press.step for press in recording.presses] == [0, 0, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0]
    assert recording.truth is not None
    levels, counts = np.unique(recording.truth, return_counts=True)
    np.testing.assert_allclose(levels, [0.1, 1.5])
    np.testing.assert_array_equal(counts, [2693, 437])
