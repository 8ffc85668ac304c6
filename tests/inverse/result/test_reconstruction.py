from dataclasses import replace
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from tactorch.errors import FileError
from tactorch.inverse import GaussNewton, Reconstruction, Settings, invert_map
from tactorch.recording import Recording


@pytest.fixture(scope="module")
def found(recording: Recording) -> Reconstruction:
    return invert_map(recording, Settings(optimizer=GaussNewton(max_iterations=2)))


@pytest.fixture
def file(found: Reconstruction, tmp_path: Path) -> Path:
    return found.save(tmp_path / "reconstruction.h5")


def test_round_trip(found: Reconstruction, file: Path) -> None:
    again = Reconstruction.load(file)
    for name in ("youngs", "displacements"):
        assert getattr(again, name).tobytes() == getattr(found, name).tobytes()
    assert again.mesh.content_hash() == found.mesh.content_hash()
    assert again.mesh.regions is None
    labels = np.arange(found.mesh.n_tets) % 3
    labelled = replace(found, mesh=found.mesh.with_regions(labels))
    kept = Reconstruction.load(labelled.save(file.with_name("labelled.h5")))
    np.testing.assert_array_equal(kept.mesh.regions, labels)
    for name in ("history", "stop_reason", "seconds", "config", "iterations", "misfit_mm2"):
        assert getattr(again, name) == getattr(found, name)
    assert again.iterations == 2


def test_a_long_provenance_fits(found: Reconstruction, tmp_path: Path) -> None:
    """HDF5 attributes hold 64 kB at most."""
    config = {**found.config, "recording": {"notes": "x" * 200_000}}
    path = replace(found, config=config).save(tmp_path / "long.h5")
    assert Reconstruction.load(path).config == config


def test_a_failed_write_leaves_nothing(found: Reconstruction, tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        replace(found, config={"bad": object()}).save(tmp_path / "bad.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("keep", [0, 7, 0.5, 0.95])
def test_a_truncated_file_is_refused(file: Path, keep: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(keep * len(data)) if 0 < keep < 1 else int(keep)])
    with pytest.raises(FileError, match=r"reconstruction\.h5' is (not an HDF5 file|damaged)"):
        Reconstruction.load(file)


def test_other_files_are_refused(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="reconstruction not found"):
        Reconstruction.load(tmp_path / "absent.h5")
    recording.save(tmp_path / "recording.h5")
    with pytest.raises(FileError, match=r"has format .tactorch-recording. where"):
        Reconstruction.load(tmp_path / "recording.h5")
    h5py.File(tmp_path / "empty.h5", "w").close()
    with pytest.raises(FileError, match=r"has format None .* HDF5, but not a reconstruction"):
        Reconstruction.load(tmp_path / "empty.h5")


def test_a_newer_version_asks_for_an_upgrade(file: Path) -> None:
    with h5py.File(file, "r+") as h5:
        h5.attrs["version"] = 3
    with pytest.raises(FileError, match=r"version 3, .*upgrade tactorch"):
        Reconstruction.load(file)


@pytest.mark.parametrize(
    "name", ["youngs", "displacements", "mesh/points", "mesh/tets", "config", "history", "finding"]
)
@pytest.mark.parametrize("damage", ["missing", "short", "group"])
def test_damaged_contents_are_refused(file: Path, name: str, damage: str) -> None:
    with h5py.File(file, "r+") as h5:
        values = h5[name][()]
        del h5[name]
        if damage == "short":
            h5[name] = values[:, :-1] if name == "displacements" else values[:-1]
        if damage == "group":
            h5.create_group(name)
    with pytest.raises(FileError, match=rf"reconstruction\.h5' .*'?{name.split('/')[0]}"):
        Reconstruction.load(file)


@pytest.mark.parametrize("name", ["youngs", "config"])
def test_other_files_are_never_read(file: Path, name: str) -> None:
    other = file.with_name("private.h5")
    with h5py.File(file, "r+") as h5, h5py.File(other, "w") as private:
        h5.copy(name, private)
        del h5[name]
        h5[name] = h5py.ExternalLink(str(other), name)
    with pytest.raises(FileError, match=f"'{name}' is an external link"):
        Reconstruction.load(file)


def test_files_without_checksums_are_still_read(found: Reconstruction, file: Path) -> None:
    """As earlier versions wrote them."""
    old = file.with_name("old.h5")
    with h5py.File(file) as h5, h5py.File(old, "w") as target:
        for name in h5:
            if name in ("finding", "residuals"):
                continue
            if name in ("config", "history", "nuisance"):
                target.create_dataset(name, data=h5[name][()].decode())
            else:
                h5.copy(name, target)
        for name, value in h5.attrs.items():
            target.attrs[name] = value.decode() if isinstance(value, bytes) else value
        target.attrs["version"] = 1
    loaded = Reconstruction.load(old)
    assert loaded.config == found.config
    np.testing.assert_array_equal(loaded.youngs, found.youngs)
    assert loaded.residuals is None
    assert [lump.inclusion.plain() for lump in loaded.lumps] == [
        lump.inclusion.plain() for lump in found.lumps
    ]


def test_vtu_opens_elsewhere(found: Reconstruction, recording: Recording, tmp_path: Path) -> None:
    path = found.write_vtu(tmp_path / "map.vtu", truth=recording.truth)
    mesh = meshio.read(path)
    np.testing.assert_allclose(mesh.points, found.mesh.points)
    np.testing.assert_array_equal(mesh.cells_dict["tetra"], found.mesh.tets)
    np.testing.assert_allclose(mesh.cell_data["youngs_mpa"][0], found.youngs)
    assert recording.truth is not None
    np.testing.assert_allclose(mesh.cell_data["youngs_true_mpa"][0], recording.truth)
    for i, u in enumerate(found.displacements):
        np.testing.assert_allclose(mesh.point_data[f"displacement_{i}_mm"], u)
    plain = meshio.read(found.write_vtu(tmp_path / "plain.vtu"))
    assert set(plain.cell_data) == {"youngs_mpa", "trusted"}


def test_no_history_is_no_iteration(found: Reconstruction) -> None:
    empty = replace(found, history=[])
    assert empty.iterations == 0
    assert np.isnan(empty.misfit_mm2)
