"""The gel of a sensor and its markers, in a press and in its file."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tactorch.errors import RecordingError
from tactorch.recording import GelReading, Press, Recording, append_press
from tactorch.recording.append import digest
from tactorch.sensor.description import GelLayer


def reading(**changes: np.ndarray) -> GelReading:
    rng = np.random.default_rng(0)
    fields = {
        "layer": GelLayer(4.0, 0.12, 0.45, radius_mm=8.0).numbers,
        "pose": np.diag([1.0, -1.0, -1.0, 1.0]), "first_pose": np.eye(4),
        "markers_mm": rng.normal(size=(5, 2)), "displacement_mm": rng.normal(size=(5, 2)),
        "deviations_mm": np.full(5, 0.002), "uncertain": np.array([0.05, 0.02, 0.001]),
    }  # fmt: skip
    return GelReading(**{**fields, **changes})


@pytest.fixture
def press(record: Callable[..., Recording]) -> Press:
    return replace(record().presses[0], gel=reading())


def assert_same(found: GelReading | None, wanted: GelReading) -> None:
    assert found is not None
    for name, values in vars(wanted).items():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_it_is_saved_in_a_newer_version(
    record: Callable[..., Recording], press: Press, tmp_path: Path
) -> None:
    path = tmp_path / "gel.h5"
    replace(record(), presses=(press,)).save(path)
    assert_same(Recording.load(path).presses[0].gel, reading())
    with h5py.File(path) as file:
        assert file.attrs["version"] == 14


def test_a_file_that_grows_gets_a_newer_version_with_it(
    record: Callable[..., Recording], press: Press, tmp_path: Path
) -> None:
    path = tmp_path / "grows.h5"
    record().save(path)
    for number, more in enumerate((replace(press, gel=None), press, press), start=1):
        assert append_press(path, more) == number
        with h5py.File(path) as file:
            assert file.attrs["version"] == (15 if number > 1 else 7)
    presses = Recording.load(path).presses
    assert [p.gel is None for p in presses] == [True, True, False, False]
    assert_same(presses[3].gel, reading())


def test_other_markers_are_another_press(press: Press) -> None:
    other = replace(press, gel=reading(displacement_mm=np.zeros((5, 2))))
    assert digest(other) != digest(press) != digest(replace(press, gel=None))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"deviations_mm": np.zeros(5)}, "a standard deviation is 0"),
        ({"displacement_mm": np.full((5, 2), np.nan)}, "gel: displacement_mm"),
        ({"layer": np.full(7, np.nan)}, "gel: thickness, Young's modulus"),
        ({"uncertain": np.array([0.1, -0.2, 0.0])}, "uncertain has -0.2"),
    ],
)
def test_refuses(changes: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        reading(**changes)


@pytest.mark.parametrize(
    "layer",
    [
        GelLayer(4.0, 0.12, 0.45, size_mm=(16.0, 12.0)),
        GelLayer(2.5, 0.2, 0.48, radius_mm=6.0, curvature_radius_mm=14.0, material="neo_hookean"),
    ],
)
def test_numbers_give_the_layer_again(layer: GelLayer) -> None:
    assert GelLayer.of_numbers(layer.numbers, layer.material) == layer
