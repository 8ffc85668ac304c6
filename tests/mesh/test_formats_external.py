"""Files that others found to fail, made by their scripts: `-m external`."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import TactorchError
from tactorch.mesh import read_mesh, read_surface
from tactorch.mesh.checks import closed_surface
from tactorch.mesh.geometry import enclosed_volume

pytestmark = pytest.mark.external
IMPORTERS = [
    "two_physical_tags", "untagged_surface_saveall", "parametric_nodes", "abaqus",
    "tet10_and_hexahedra", "surfaces", "large_surface",
]  # fmt: skip
HOSTILE = [
    "gmsh_sparse_tag", "gmsh_claims", "ply_claims", "stl_claims", "abaqus_generates",
    "abaqus_includes", "abaqus_includes_device", "vtu_claims",
]  # fmt: skip


def made(shared: Path, kind: str, names: list[str], folder: Path) -> Path:
    script = shared / "failing-inputs" / kind / "make_inputs.py"
    if not script.is_file():
        pytest.skip(f"no '{script}'")
    subprocess.run([sys.executable, script, folder, *names], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def importers(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(shared_data, "importers", IMPORTERS, tmp_path_factory.mktemp("importers"))


@pytest.fixture(scope="module")
def hostile(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(shared_data, "hostile", HOSTILE, tmp_path_factory.mktemp("hostile"))


@pytest.mark.parametrize(
    ("name", "regions"),
    [
        ("two_physical_tags_v41.msh", [10, 20]),
        ("two_physical_tags_v22.msh", [10, 20]),
        ("untagged_surface_saveall.msh", [10, 20]),
        ("parametric_nodes_v41.msh", [10]),
        ("parametric_nodes_v22.msh", [10]),
        ("abaqus_hybrid_c3d4h.inp", [1]),
        ("abaqus_elset.inp", [1, 2]),
        ("abaqus_c3d10.inp", [1]),
        ("tet10.msh", [10]),
        ("hexahedra.msh", [10]),
    ],
)
def test_meshes(importers: Path, name: str, regions: list[int]) -> None:
    mesh = read_mesh(importers / name)
    assert (mesh.n_points, mesh.n_tets) == (27, 48)
    assert mesh.volumes.sum() == pytest.approx(1000.0)
    assert mesh.regions is not None
    assert np.unique(mesh.regions).tolist() == regions
    if len(regions) == 2:
        np.testing.assert_array_equal(mesh.regions == regions[1], mesh.centroids[:, 0] > 5.0)


def test_surfaces(importers: Path) -> None:
    surface = closed_surface(*read_surface(importers / "vertices_apart_1e-6.obj"))
    assert enclosed_volume(*surface) == pytest.approx(1000.0, rel=1e-5)
    for name in ("points_only.ply", "points_only.obj"):
        with pytest.raises(TactorchError, match="9 points and no faces"):
            read_surface(importers / name)


@pytest.mark.slow
def test_a_surface_of_many_triangles(importers: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tactorch", "mesh", str(importers / "large_surface.stl")]
    options = ["edge_length_mm=4", f"out={tmp_path / 'l.vtu'}", "cache=false"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert "81920 triangles, far finer than edges of 4 mm; it is meshed with" in done.stdout
    assert read_mesh(tmp_path / "l.vtu").volumes.sum() == pytest.approx(33484.0, rel=0.02)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("claims.msh", "rows where"),
        ("claims_v22.msh", "states 1000000000 rows"),
        ("faces_ascii.ply", "states 1000000000 rows of face"),
        ("faces_binary.ply", "states 1000000000 rows of face"),
        ("claims_ascii.ply", "states 1000000000 rows of vertex"),
        ("claims_binary_little_endian.ply", "states 1000000000 rows of vertex"),
        ("claims.stl", "states 4000000000 triangles"),
        ("generates.inp", "the set BIG has 2000000000 elements"),
        ("inside/includes.inp", "not in the folder of the mesh"),
        ("inside/text.inp", "not in the folder of the mesh"),
        ("inside/itself.inp", "includes itself"),
        ("inside/device.inp", "not in the folder of the mesh"),
        ("claims.vtu", "states 10000000000 points where it has 1"),
    ],
)
def test_false_statements(hostile: Path, name: str, message: str) -> None:
    surface = Path(name).suffix in (".ply", ".stl")
    with pytest.raises(TactorchError, match=message):
        (read_surface if surface else read_mesh)(hostile / name)


@pytest.mark.parametrize("name", ["sparse_tag.msh", "sparse_tag_v41.msh"])
def test_tags_that_are_far_apart(hostile: Path, name: str) -> None:
    assert read_mesh(hostile / name).n_tets == 1
