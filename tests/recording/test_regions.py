"""Regions of the mesh of a recording: files, refinement, growing files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import MeshError, RecordingError
from tactorch.mesh import TetMesh, box_mesh, read_mesh, refine, write_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording, append_press, compact, prolong_recording
from tactorch.simulation import PressPlan, perturb_recording, simulate


@pytest.fixture(scope="module")
def recording() -> Recording:
    mesh = box_mesh(10.0, 2)
    upper = mesh.with_regions((mesh.centroids[:, 2] > 5.0) * 3 + 1)
    return simulate(make_phantom("cube_sphere"), PressPlan(["z+"], [0.01]), mesh=upper)


def version(path: Path) -> int:
    import h5py

    with h5py.File(path) as file:
        return int(file.attrs["version"])


def test_regions_are_stored(recording: Recording, tmp_path: Path) -> None:
    recording.save(tmp_path / "r.h5")
    loaded = Recording.load(tmp_path / "r.h5")
    np.testing.assert_array_equal(loaded.mesh.regions, recording.mesh.regions)
    assert "regions: 1 (24 elements), 4 (24 elements)" in loaded.summary()
    assert version(tmp_path / "r.h5") == 8
    append_press(tmp_path / "r.h5", recording.presses[0])
    assert version(tmp_path / "r.h5") == 9
    compact(tmp_path / "r.h5")
    assert version(tmp_path / "r.h5") == 8
    grown = Recording.load(tmp_path / "r.h5")
    assert len(grown.presses) == 2
    np.testing.assert_array_equal(grown.mesh.regions, recording.mesh.regions)


def test_files_without_regions_keep_the_version_of_earlier_readers(
    recording: Recording, tmp_path: Path
) -> None:
    bare = replace(recording, mesh=recording.mesh.with_regions(None))
    bare.save(tmp_path / "r.h5")
    assert version(tmp_path / "r.h5") == 6
    append_press(tmp_path / "r.h5", bare.presses[0])
    assert version(tmp_path / "r.h5") == 7
    compact(tmp_path / "r.h5")
    assert version(tmp_path / "r.h5") == 6
    assert len(Recording.load(tmp_path / "r.h5").presses) == 2


def test_wrong_regions_of_a_file_are_refused(recording: Recording, tmp_path: Path) -> None:
    import h5py

    recording.save(tmp_path / "r.h5")
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        regions = file["mesh/regions"][()]
        del file["mesh/regions"]
        file["mesh/regions"] = regions[:-1]
    with pytest.raises(RecordingError, match="mesh/regions"):
        Recording.load(tmp_path / "r.h5")


def test_fine_elements_have_the_region_of_their_parent(recording: Recording) -> None:
    fine = refine(recording.mesh, lambda points: np.full(len(points), 3.0))
    np.testing.assert_array_equal(fine.mesh.regions, recording.mesh.regions[fine.parents])
    assert ((fine.mesh.centroids[:, 2] > 5.0) == (fine.mesh.regions == 4)).all()
    np.testing.assert_array_equal(
        prolong_recording(recording, fine).mesh.regions, fine.mesh.regions
    )


def test_wrong_assumptions_keep_the_regions(recording: Recording) -> None:
    perturbed = perturb_recording(recording, size=1.1)
    np.testing.assert_array_equal(perturbed.mesh.regions, recording.mesh.regions)


def test_regions_change_no_hash_and_are_copied(recording: Recording) -> None:
    import pickle

    mesh = recording.mesh
    assert mesh.content_hash() == mesh.with_regions(None).content_hash()
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(mesh)).regions, mesh.regions)
    assert not mesh.regions.flags.writeable


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ([1, 2], "give one number for each of 48"),
        (np.full(48, 0.5), "whole"),
        (["a"] * 48, "whole"),
    ],
)
def test_wrong_regions_are_refused(recording: Recording, regions: object, message: str) -> None:
    mesh = recording.mesh
    with pytest.raises(MeshError, match=message):
        TetMesh.create(mesh.points, mesh.tets, regions=regions)


def test_physical_groups_of_gmsh_are_regions(tmp_path: Path) -> None:
    import meshio

    mesh = box_mesh(10.0, 2)
    groups = np.repeat([7, 8], 24).astype(np.int32)
    content = meshio.Mesh(
        np.array(mesh.points),
        [("triangle", mesh.surface.triangles), ("tetra", np.array(mesh.tets))],
        cell_data={
            name: [np.zeros(len(mesh.surface.triangles), np.int32), groups]
            for name in ("gmsh:physical", "gmsh:geometrical")
        },
    )
    meshio.gmsh.write(str(tmp_path / "m.msh"), content, fmt_version="2.2", binary=True)
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.msh").regions, groups)


def test_files_of_abaqus_have_no_regions(recording: Recording, tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.inp", recording.mesh)
    assert read_mesh(tmp_path / "m.inp").regions is None
