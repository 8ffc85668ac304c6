"""Correlated errors of forces and displacements of a press."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tactorch.errors import RecordingError
from tactorch.recording import Press, PressErrors, Recording, append_press
from tactorch.recording.append import digest


def errors(count: int = 4) -> PressErrors:
    rng = np.random.default_rng(0)
    return PressErrors(
        np.array([18, 20, 26]), rng.normal(size=(count, 3, 3)), rng.normal(size=(count, 3, 3))
    )


@pytest.fixture
def press(record: Callable[..., Recording]) -> Press:
    return replace(record().presses[0], errors=errors())


def assert_same(found: PressErrors | None, wanted: PressErrors) -> None:
    assert found is not None
    for name in ("nodes", "forces", "displacement"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def test_they_are_saved_in_a_newer_version(
    record: Callable[..., Recording], press: Press, tmp_path: Path
) -> None:
    replace(record(), presses=(press,)).save(tmp_path / "with.h5")
    record().save(tmp_path / "without.h5")
    assert_same(Recording.load(tmp_path / "with.h5").presses[0].errors, errors())
    assert Recording.load(tmp_path / "without.h5").presses[0].errors is None
    versions = []
    for name in ("with", "without"):
        with h5py.File(tmp_path / f"{name}.h5") as file:
            versions.append(int(file.attrs["version"]))
    assert versions == [10, 6]


def test_a_file_that_grows_gets_a_newer_version_with_them(
    record: Callable[..., Recording], press: Press, tmp_path: Path
) -> None:
    path = tmp_path / "grows.h5"
    record().save(path)
    for number, more in enumerate((replace(press, errors=None), press, press), start=1):
        assert append_press(path, more) == number
        with h5py.File(path) as file:
            assert file.attrs["version"] == (11 if number > 1 else 7)
    presses = Recording.load(path).presses
    assert [p.errors is None for p in presses] == [True, True, False, False]
    assert_same(presses[3].errors, errors())


def test_they_distinguish_presses(press: Press) -> None:
    other = replace(press, errors=errors(3))
    assert digest(press) != digest(other) != digest(replace(press, errors=None))


def test_covariance_of_the_total_force() -> None:
    given = errors()
    totals = np.random.default_rng(1).normal(size=(100_000, 4)) @ given.forces.sum(axis=1)
    np.testing.assert_allclose(given.total_force_covariance, np.cov(totals.T), rtol=0.05, atol=0.05)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"nodes": np.array([1, 1, 2])}, "nodes has a negative or repeated number"),
        ({"nodes": np.array([-1, 1, 2])}, "nodes has a negative or repeated number"),
        ({"forces": np.full((4, 3, 3), np.nan)}, "forces holds 36 values that are NaN"),
    ],
)
def test_wrong_ones_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(RecordingError, match=f"errors: {says}"):
        replace(errors(), **change)


def test_nodes_that_the_mesh_lacks_are_refused(
    record: Callable[..., Recording], press: Press
) -> None:
    far = replace(press, errors=replace(errors(), nodes=np.array([1, 2, 27])), name="far")
    with pytest.raises(RecordingError, match="'far': errors: nodes has 27 but the mesh has 27"):
        replace(record(), presses=(far,))
