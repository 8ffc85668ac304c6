"""Bodies from labelled volumes: volume kept, regions, holes, pieces and edges."""

import logging
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import TetMesh, read_mesh
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.geometry import enclosed_volume
from tactorch.volumes import Body, BodySettings, LabelVolume, read_body
from tactorch.volumes.surface import smooth_surface

from .conftest import block


def ball(radius: float, size: int = 24) -> np.ndarray:
    offsets = np.indices((size,) * 3).transpose(1, 2, 3, 0) - (size - 1) / 2.0
    return np.linalg.norm(offsets, axis=-1) < radius


def centroid(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Centroid of the solid within a surface, from the tetrahedra of its triangles and a point."""
    origin = vertices.mean(axis=0)
    corners = vertices[triangles] - origin
    volumes = np.linalg.det(corners)
    return np.asarray(
        origin + (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / 4 / volumes.sum()
    )


@settings(max_examples=25)
@given(
    radius=st.floats(2.5, 9.0),
    detail=st.floats(0.0, 2.0),
    sizes=st.tuples(*[st.sampled_from([0.5, 1.0, 2.0])] * 3),
    angle=st.floats(-180.0, 180.0),
    flip=st.booleans(),
)
def test_the_surface_is_closed_and_keeps_the_volume(
    radius: float, detail: float, sizes: tuple[float, float, float], angle: float, flip: bool
) -> None:
    affine = np.eye(4)
    turn = Rotation.from_euler("xyz", [angle, 20.0, 5.0], degrees=True).as_matrix()
    affine[:3, :3] = turn @ np.diag(sizes) @ np.diag([-1.0 if flip else 1.0, 1.0, 1.0])
    mask = ball(radius)
    vertices, triangles = smooth_surface(mask, affine, detail)
    _, outward = closed_surface(vertices, triangles)
    np.testing.assert_array_equal(triangles, outward)
    volume = mask.sum() * np.prod(sizes)
    assert enclosed_volume(vertices, triangles) == pytest.approx(volume, rel=5e-3)
    centre = affine[:3, :3] @ np.full(3, 11.5)
    tolerance = 0.1 * max(*sizes, detail)
    np.testing.assert_allclose(centroid(vertices, triangles), centre, atol=tolerance)


def test_the_surface_of_a_ball_is_smooth() -> None:
    vertices, _ = smooth_surface(ball(9.0), np.eye(4), 0.0)
    radii = np.linalg.norm(vertices - 11.5, axis=1)
    equal = (3.0 * ball(9.0).sum() / (4.0 * np.pi)) ** (1 / 3)
    assert np.abs(radii - equal).max() < 0.35  # steps of voxels are of 1
    assert radii.std() < 0.12


@pytest.fixture(scope="module")
def body(block_file: Path) -> Body:
    return read_body(block_file)


@pytest.fixture(scope="module")
def mesh(body: Body) -> TetMesh:
    return body.mesh(3.0)


def test_the_mesh_keeps_the_volume_and_the_place(mesh: TetMesh) -> None:
    assert mesh.volumes.sum() == pytest.approx(12 * 12 * 8, rel=0.02)
    np.testing.assert_allclose(mesh.bounds, [[0.5] * 3, [12.5, 12.5, 8.5]], atol=0.3)


def test_elements_have_the_label_of_most_of_their_volume(body: Body, mesh: TetMesh) -> None:
    assert set(mesh.regions) == {1, 2}
    centre = np.array([6.5, 6.5, 4.5])
    distance = np.linalg.norm(mesh.centroids - centre, axis=1)
    assert (mesh.regions[distance < 1.2] == 2).all()
    assert (mesh.regions[distance > 4.0] == 1).all()
    lattice = np.random.default_rng(0).dirichlet(np.ones(4), (mesh.n_tets, 200))
    points = np.einsum("msc,mcd->msd", lattice, mesh.points[mesh.tets])
    share = (body.labels_at(points.reshape(-1, 3)) == 2).reshape(mesh.n_tets, 200).mean(axis=1)
    # Shares of the 20 points of an element differ from those of 200 by up to 0.15.
    clear = np.abs(share - 0.5) > 0.25
    assert ((share > 0.5) == (mesh.regions == 2))[clear].all()


def test_holes_are_filled_or_kept(tmp_path: Path) -> None:
    labels = block()
    labels[labels == 2] = 0
    np.savez(tmp_path / "v.npz", labels=labels, spacing_mm=[1.0, 1.0, 1.0])
    assert read_body(tmp_path / "v.npz").volume_mm3 == 12 * 12 * 8
    open_body = read_body(tmp_path / "v.npz", BodySettings(fill_holes=False))
    assert open_body.volume_mm3 == np.count_nonzero(labels)
    vertices, triangles = closed_surface(*open_body.surface())
    assert enclosed_volume(vertices, triangles) == pytest.approx(open_body.volume_mm3, rel=5e-3)


def test_the_largest_piece_is_kept_on_demand(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    labels = block()
    labels[:, :, 3] = 0
    np.savez(tmp_path / "v.npz", labels=labels, spacing_mm=[1.0, 1.0, 1.0])
    with caplog.at_level(logging.WARNING):
        kept = read_body(tmp_path / "v.npz", BodySettings(keep_largest=True))
    assert kept.volume_mm3 == 12 * 12 * 5
    assert "1 of 2 pieces are left out, 29 % of the voxels" in caplog.text


def test_an_open_body_is_closed_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    labels = block()[1:, :, :-1]
    np.savez(tmp_path / "v.npz", labels=labels, spacing_mm=[1.0, 1.0, 1.0])
    with caplog.at_level(logging.WARNING):
        opened = read_body(tmp_path / "v.npz")
    assert "start of axis 0, end of axis 2" in caplog.text
    vertices, triangles = closed_surface(*opened.surface())
    assert enclosed_volume(vertices, triangles) == pytest.approx(12 * 12 * 8, rel=5e-3)
    np.testing.assert_allclose(vertices.min(axis=0), [-0.5, 0.5, 0.5], atol=0.2)


def test_names_of_labels_are_settings(block_file: Path) -> None:
    volume = read_body(block_file, BodySettings(labels={1: "tissue"})).volume
    assert volume.name(1) == "1 (tissue)"
    # The ball, which is not of the body, is a hole of it, and filled.
    assert volume.numbers.tolist() == [1]


def test_edge_lengths_below_voxels_and_meshes_that_are_too_large_are_refused(body: Body) -> None:
    with pytest.raises(ConfigError, match=r"edge_length_mm=0\.8 is below the voxels .* 1 mm"):
        body.mesh(0.8)
    with pytest.raises(ConfigError, match=r"about 9\.8e\+03 elements .* raise max_elements"):
        body.mesh(1.0, max_elements=1000)


def test_parts_thinner_than_the_elements_are_refused() -> None:
    labels = np.zeros((40, 16, 16), dtype=np.int32)
    labels[2:14, 2:14, 2:14] = labels[26:38, 2:14, 2:14] = 1
    labels[14:26, 8, 8] = 1
    dumbbell = Body(LabelVolume(labels, np.eye(4), source="two.nii"))
    with pytest.raises(MeshError, match=r"'two\.nii': the smoothing .* detaches 1 thin part"):
        dumbbell.mesh(6.0)


def test_a_mesh_of_another_volume_is_refused(body: Body, mesh: TetMesh) -> None:
    smaller = TetMesh.create(0.98 * mesh.points, mesh.tets)
    with pytest.raises(MeshError, match="more than 2% apart"):
        body.check_volume(smaller)


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_regions_survive_a_file(tmp_path: Path, mesh: TetMesh, suffix: str) -> None:
    from tactorch.mesh import write_mesh

    write_mesh(tmp_path / f"body{suffix}", mesh)
    read = read_mesh(tmp_path / f"body{suffix}")
    np.testing.assert_array_equal(read.regions, mesh.regions)
    assert read.regions.dtype == np.int64
