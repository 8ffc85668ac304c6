"""Phantoms from labelled volumes."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError
from tactorch.inverse import INITIALIZATIONS, Bounds, InverseProblem
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.phantoms.files import Labelled, VoxelShape
from tactorch.simulation import PressPlan, simulate


@pytest.fixture
def volume(tmp_path: Path) -> Path:
    labels = np.zeros((7, 7, 6), dtype=np.int16)
    labels[1:-1, 1:-1, 1:-1] = 1
    labels[1:-1, 1:-1, 3:-1] = 3
    path = tmp_path / "layers.npz"
    np.savez(path, labels=labels, spacing_mm=[2.0, 2.0, 2.0])
    return path


def test_moduli_are_those_of_the_labels(volume: Path) -> None:
    phantom = make_phantom("labelled", volume=volume, region_mpa={1: 0.1, 3: 0.3})
    points = np.array([[5.0, 5.0, 3.0], [5.0, 5.0, 8.0], [5.0, 5.0, 30.0]])
    np.testing.assert_allclose(phantom.youngs_at(points), [0.1, 0.3, 0.3])
    assert phantom.to_config()["labels"] == [1, 3]


def test_distances_are_signed(volume: Path) -> None:
    shape = make_phantom("labelled", volume=volume, region_mpa={1: 0.1, 3: 0.3}).body
    assert isinstance(shape, VoxelShape)
    points = np.array([[6.0, 6.0, 5.0], [6.0, 6.0, 2.0], [6.0, 6.0, 0.0]])
    np.testing.assert_allclose(shape.signed_distance(points), [-4.0, -1.0, 1.0], atol=1.0)
    np.testing.assert_allclose(shape.bounds(), [[1.0] * 3, [11.0, 11.0, 9.0]], atol=0.6)


def test_a_volume_that_is_all_body_has_distances(tmp_path: Path) -> None:
    np.savez(tmp_path / "v.npz", labels=np.ones((6, 6, 6), int), spacing_mm=[1.0, 1.0, 1.0])
    shape = make_phantom("labelled", volume=tmp_path / "v.npz", region_mpa={1: 0.1}).body
    points = np.array([[2.0, 2.0, 2.0], [2.0, 2.0, 0.0], [2.0, 2.0, -1.0]])
    np.testing.assert_allclose(shape.signed_distance(points), [-2.5, -0.5, 0.5])


def test_its_mesh_has_the_labels_as_regions(volume: Path) -> None:
    phantom = make_phantom("labelled", volume=volume, region_mpa={1: 0.1, 3: 0.3})
    mesh = phantom.mesh(4.0)
    assert set(mesh.regions) == {1, 3}
    clear = np.abs(mesh.centroids[:, 2] - 5.0) > 1.5
    assert ((mesh.centroids[:, 2] > 5.0) == (mesh.regions == 3))[clear].all()
    np.testing.assert_allclose(
        phantom.on_mesh(mesh)[clear], np.where(mesh.regions == 3, 0.3, 0.1)[clear]
    )
    with pytest.raises(MeshError, match="phantom's body"):
        phantom.on_mesh(box_mesh(10.0, 2))
    with pytest.raises(ConfigError, match="no conforming mesh"):
        phantom.mesh(4.0, conforming=True)


def test_wrong_settings_are_refused(volume: Path) -> None:
    with pytest.raises(ConfigError, match="no modulus for label 3; give one for each of 1, 3"):
        Labelled(volume=volume, region_mpa={1: 0.1}).build()
    with pytest.raises(FileError, match="not found"):
        Labelled(volume=volume.with_name("none.nii"), region_mpa={1: 0.1}).build()


@pytest.mark.slow
def test_a_patch_is_pressed_alike_on_two_meshes(tmp_path: Path) -> None:
    """The region of larger modulus is found stiffer although the presses are of another mesh."""
    labels = np.zeros((16, 16, 12), dtype=np.int16)
    labels[1:-1, 1:-1, 1:-1] = 1
    labels[6:10, 6:10, 5:9] = 2
    np.savez(tmp_path / "v.npz", labels=labels, spacing_mm=[1.0, 1.0, 1.0])
    phantom = make_phantom("labelled", volume=tmp_path / "v.npz", region_mpa={1: 0.1, 2: 0.5})
    plan = PressPlan(["z+"], [0.02], support="fixed", patch_radius_mm=4.0)
    recording = simulate(
        phantom, plan, mesh=phantom.mesh(3.0), fine_mesh=phantom.mesh(2.2), element="tet10",
        samples=4, snr_db=40,
    )  # fmt: skip
    assert not recording.provenance["inverse_crime"]
    start = INITIALIZATIONS.build("regions")(InverseProblem(recording), Bounds())
    regions = recording.mesh.regions
    assert start[regions == 1][0] == pytest.approx(0.1, rel=0.25)
    assert start[regions == 2][0] > 1.3 * start[regions == 1][0]
