"""Archives of arrays."""

from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from tactorch.files import natural_key, read_arrays, write_arrays


def savez_before_2_2(file: Any, **arrays: Any) -> None:
    """Write arrays as NumPy 2.0 and 2.1 do: every keyword is an array."""
    with ZipFile(file, "w") as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w") as part:
                np.lib.format.write_array(part, np.asarray(values))


def test_options_of_numpy_are_not_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np, "savez", savez_before_2_2)
    write_arrays(tmp_path / "a.npz", {"x": np.arange(3)})
    with np.load(tmp_path / "a.npz") as stored:
        assert list(stored) == ["x"]


def test_stored_options_of_numpy_are_not_read(tmp_path: Path) -> None:
    savez_before_2_2(tmp_path / "a.npz", x=np.arange(3), allow_pickle=False)
    assert list(read_arrays(tmp_path / "a.npz", "map", "compute it again.")) == ["x"]


@pytest.mark.parametrize("compressed", [False, True])
def test_python_objects_are_refused(compressed: bool, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="array 'x' holds Python objects"):
        write_arrays(tmp_path / "a.npz", {"x": np.array([{}])}, compressed=compressed)
    assert not list(tmp_path.iterdir())


def test_names_are_sorted_by_their_numbers() -> None:
    names = ["press10.csv", "a².csv", "press2.csv", "2.csv", "press2b.csv"]
    ordered = sorted(map(Path, names), key=natural_key)
    assert [path.name for path in ordered] == [
        "2.csv", "a².csv", "press2.csv", "press2b.csv", "press10.csv",
    ]  # fmt: skip
