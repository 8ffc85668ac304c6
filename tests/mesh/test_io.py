import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError
from tactorch.importers.vtk_files import read_vtk
from tactorch.mesh import (
    Box,
    Cylinder,
    TetMesh,
    box_mesh,
    read_mesh,
    read_surface,
    write_mesh,
    write_surface,
)

MESHES = ["msh", "vtu", "inp"]
SURFACES = ["stl", "obj", "ply"]

# gmsh 4.1: nodes numbered with gaps and out of order, a point, a line and triangles besides the
# two tetrahedra, the second of them inverted.
GMSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
1 1 1 1
1 0 0 0 0
1 0 0 0 1 0 0 0 0
1 0 0 0 1 1 1 0 0
1 0 0 0 1 1 1 0 0
$EndEntities
$Nodes
2 5 2 11
0 1 0 2
7
2
0 0 0
0.01 0 0
3 1 0 3
11
5
9
0 0.01 0
0.01 0.01 0.01
0 0 0.01
$EndNodes
$Elements
4 5 1 5
0 1 15 1
1 7
1 1 1 1
2 7 2
2 1 2 1
3 7 11 2
3 1 4 2
4 7 2 11 9
5 2 11 5 9
$EndElements
"""


@pytest.fixture
def gmsh(tmp_path: Path) -> Path:
    path = tmp_path / "object.msh"
    path.write_text(GMSH)
    return path


def with_extra_nodes(mesh: TetMesh, path: Path) -> Path:
    points = np.vstack(([(0.5, 0.5, 0.5)], mesh.points, [(0.7, 0.5, 0.5)]))
    meshio.vtu.write(str(path), meshio.Mesh(points, [("tetra", mesh.tets + 1)]))
    return path


@pytest.mark.parametrize("suffix", MESHES)
def test_mesh_round_trip_is_exact(mesh: TetMesh, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh.{suffix}"
    write_mesh(path, mesh)
    assert read_mesh(path).content_hash() == mesh.content_hash()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["msh", "vtu"])
def test_fields_are_written(mesh: TetMesh, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh.{suffix}"
    youngs = np.linspace(0.1, 1.0, mesh.n_tets)
    inside = youngs > 0.5
    write_mesh(path, mesh, {"youngs": youngs, "inside": inside}, {"displacement": mesh.points})
    content = meshio.vtu.read(str(path)) if suffix == "vtu" else meshio.gmsh.read(str(path))
    np.testing.assert_array_equal(content.cell_data["youngs"][0].ravel(), youngs)
    np.testing.assert_array_equal(content.cell_data["inside"][0].ravel(), inside)
    np.testing.assert_array_equal(content.point_data["displacement"], mesh.points)


def test_gmsh_keeps_the_order_and_the_tets_only(gmsh: Path) -> None:
    mesh = read_mesh(gmsh, unit="m")
    expected = [(0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 10), (0, 0, 10)]
    np.testing.assert_allclose(mesh.points, expected)
    np.testing.assert_array_equal(np.sort(mesh.tets, axis=1), [(0, 1, 2, 4), (1, 2, 3, 4)])
    np.testing.assert_allclose(mesh.volumes, [1000 / 6, 1000 / 3])


@pytest.mark.parametrize(("unit", "mm"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0)])
def test_units(tmp_path: Path, unit: str, mm: float) -> None:
    path = tmp_path / "mesh.vtu"
    write_mesh(path, box_mesh(0.5, 1, center_mm=(1, 0, 0)))
    assert read_mesh(path, unit).diagonal == pytest.approx(0.5 * np.sqrt(3) * mm)
    vertices, triangles = Box(size_mm=0.5).surface()
    write_surface(tmp_path / "box.obj", vertices, triangles)
    np.testing.assert_allclose(read_surface(tmp_path / "box.obj", unit)[0], vertices * mm)


def test_implausible_size_names_the_likely_unit(gmsh: Path, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"object\.msh' is 0\.01732 mm.* unit='m' \(17\.32 mm\)"):
        read_mesh(gmsh)
    write_mesh(tmp_path / "large.vtu", box_mesh(20.0, 1))
    with pytest.warns(UserWarning, match=r"large\.vtu' is 3\.464e\+04 mm .*unit='mm' \(34\.64 mm"):
        read_mesh(tmp_path / "large.vtu", "m")
    write_surface(tmp_path / "tiny.stl", *Box(size_mm=1e-6).surface())
    with pytest.warns(UserWarning, match=r"tiny\.stl' .*Check the unit and scale"):
        read_surface(tmp_path / "tiny.stl")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_mesh(gmsh, "m")


def test_unreferenced_nodes_are_named_or_dropped(
    mesh: TetMesh, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = with_extra_nodes(mesh, tmp_path / "extra.vtu")
    with pytest.raises(MeshError, match=r"extra\.vtu': .* 2 of 82 nodes \(0, 81\).*write_mesh"):
        read_mesh(path, drop_unreferenced=False)
    assert read_mesh(path, drop_unreferenced=True).content_hash() == mesh.content_hash()
    assert not caplog.text
    write_mesh(tmp_path / "new.vtu", read_mesh(path))
    assert "2 of 82 nodes (0, 81); they are left out" in caplog.text
    again = read_mesh(tmp_path / "new.vtu", drop_unreferenced=False)
    assert again.content_hash() == mesh.content_hash()


def test_unusable_mesh_names_the_file(tmp_path: Path) -> None:
    points = np.vstack((np.zeros(3), np.eye(3)))
    points[3] = (0.2, 0.2, 0.0)
    path = tmp_path / "flat.vtu"
    meshio.vtu.write(str(path), meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]))
    with pytest.raises(MeshError, match=r"flat\.vtu': .*degenerate"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("kind", "width", "message"),
    [
        ("triangle", 3, "no tetrahedra, only triangle.*tetrahedralize"),
    ],
)
def test_other_cells_are_named(tmp_path: Path, kind: str, width: int, message: str) -> None:
    path = tmp_path / "other.vtu"
    points = np.random.default_rng(0).random((width, 3))
    meshio.vtu.write(str(path), meshio.Mesh(points, [(kind, np.arange(width)[None])]))
    with pytest.raises(MeshError, match=message):
        read_mesh(path)


@pytest.mark.parametrize("suffix", MESHES + SURFACES)
@pytest.mark.parametrize("damage", ["empty", "half", "text", "binary"])
def test_damaged_files_are_named(
    mesh: TetMesh,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    suffix: str,
    damage: str,
) -> None:
    path = tmp_path / f"file.{suffix}"
    if suffix in MESHES:
        write_mesh(path, mesh)
    else:
        write_surface(path, *Cylinder((0, 0, 0), 3, 4).surface(12))
    content = path.read_bytes()
    path.write_bytes(
        {
            "empty": b"",
            "half": content[: len(content) // 2],
            "text": b"hello world\n" * 30,
            "binary": bytes(range(256)) * 10,
        }[damage]
    )
    with pytest.raises((FileError, MeshError), match=rf"file\.{suffix}'"):
        read_mesh(path) if suffix in MESHES else read_surface(path)
    assert capfd.readouterr() == ("", "")


def test_a_reader_that_exits_is_caught(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(path: str) -> None:
        print("cannot go on")
        raise SystemExit(1)

    (tmp_path / "object.vtk").write_text("# vtk")
    monkeypatch.setattr(meshio.vtk, "read", leave)
    with pytest.raises(FileError, match=r"object\.vtk' cannot be read as vtk: cannot go on"):
        read_vtk(tmp_path / "object.vtk")


@pytest.mark.parametrize("read", [read_mesh, read_surface])
def test_missing_and_unknown_files(tmp_path: Path, read) -> None:
    with pytest.raises(FileError, match=r"not found: .*absent\.msh"):
        read(tmp_path / "absent.msh")
    (tmp_path / "mesh.xyz").write_text("0 0 0")
    with pytest.raises(FileError, match=r"mesh\.xyz' has the unknown suffix '\.xyz'; use one of"):
        read(tmp_path / "mesh.xyz")
    with pytest.raises(ConfigError, match="Unknown length unit 'inch'; choose one of mm, cm, m"):
        read(tmp_path / "mesh.xyz", "inch")


def test_writing_refuses_what_it_cannot_keep(mesh: TetMesh, tmp_path: Path) -> None:
    values = np.ones(mesh.n_tets)
    with pytest.raises(FileError, match=r"\.inp files cannot hold fields"):
        write_mesh(tmp_path / "a.inp", mesh, {"youngs": values})
    with pytest.raises(MeshError, match=r"cell_data 'youngs' must have 216 rows .* \(215,\)"):
        write_mesh(tmp_path / "a.vtu", mesh, {"youngs": values[:-1]})
    with pytest.raises(MeshError, match=r"point_data 'name' must have 80 rows"):
        write_mesh(tmp_path / "a.vtu", mesh, point_data={"name": ["a"] * 80})
    with pytest.raises(FileError, match=r"unknown suffix '\.stl'"):
        write_mesh(tmp_path / "a.stl", mesh)
    with pytest.raises(FileError, match=r"unknown suffix '\.vtu'"):
        write_surface(tmp_path / "a.vtu", *Box().surface())
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match=r"cannot write '.*a\.vtu'"):
        write_mesh(tmp_path / "file" / "a.vtu", mesh)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_failed_writing_leaves_the_old_file(
    mesh: TetMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mesh.vtu"
    write_mesh(path, mesh)
    before = path.read_bytes()

    def fail(path: str, content: meshio.Mesh) -> None:
        Path(path).write_text("half")
        raise meshio.WriteError("disk full")

    monkeypatch.setattr(meshio.vtu, "write", fail)
    with pytest.raises(FileError, match=r"mesh\.vtu' cannot be written as vtu: disk full"):
        write_mesh(path, mesh)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.vtu"]


@pytest.mark.parametrize("suffix", SURFACES)
def test_surface_round_trip(tmp_path: Path, suffix: str) -> None:
    vertices, triangles = Cylinder((0, 0, 0), 3, 4).surface(12)
    path = tmp_path / f"rod.{suffix}"
    write_surface(path, vertices, triangles)
    found, faces = read_surface(path)
    assert found.shape == vertices.shape
    tolerance = 1e-6 if suffix == "stl" else 0.0  # STL holds single precision
    np.testing.assert_allclose(found[faces], vertices[triangles], atol=tolerance, rtol=0)


def test_ascii_stl_and_merging(tmp_path: Path) -> None:
    vertices, triangles = Box(size_mm=2.0).surface()
    path = tmp_path / "box.stl"
    meshio.stl.write(str(path), meshio.Mesh(vertices, [("triangle", triangles)]))
    assert path.read_bytes().startswith(b"solid")
    found, faces = read_surface(path)
    assert found.shape == (8, 3)
    np.testing.assert_array_equal(found[faces], vertices[triangles])


def test_lines_in_stl_files_are_dropped(tmp_path: Path) -> None:
    """Marching cubes leaves triangles of no area, which become lines when vertices are merged."""
    vertices, triangles = Box(size_mm=2.0).surface()
    double = np.vstack((vertices, vertices[:1]))
    lines = [(0, 1, len(vertices)), (len(vertices), 2, 0)]
    path = tmp_path / "box.stl"
    cells = [("triangle", np.vstack((triangles, lines)))]
    meshio.stl.write(str(path), meshio.Mesh(double, cells))
    found, faces = read_surface(path)
    np.testing.assert_array_equal(found[faces], vertices[triangles])
    meshio.stl.write(str(path), meshio.Mesh(double, [("triangle", np.array(lines))]))
    with pytest.raises(MeshError, match="all its triangles are points or lines"):
        read_surface(path)


def test_obj_as_others_write_it(tmp_path: Path) -> None:
    """Colours after coordinates, texture indices, quadrangles, repeated and unused vertices."""
    path = tmp_path / "scan.obj"
    path.write_text(
        "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 1 0 0\nv 0 1 0 1 0 0\nv 0 0 1 1 0 0\n"
        "v 9 9 9 1 0 0\nv -0 0 0 1 0 0\nvt 0 0\n"
        "# a comment\no scan\nf 1/1 4/1/1 3//1 2/1\nf 7 2 5 # 1\nf 2 3 5\nf -5 -4 -3\nf 4 7 5\n"
    )
    vertices, triangles = read_surface(path)
    expected = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    np.testing.assert_array_equal(vertices, expected)
    faces = [(0, 3, 2), (0, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    np.testing.assert_array_equal(triangles, faces)


@pytest.mark.parametrize("line", ["v 1 2", "v 1 2 x", "f 1 2 0", "f 1 2 -9", "f 1 2 a"])
def test_obj_line_that_makes_no_sense_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "scan.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{line}\n")
    with pytest.raises(FileError, match=r"scan\.obj' cannot be read as obj: line 5: "):
        read_surface(path)


def test_surfaces_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "points.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(MeshError, match=r"points\.obj': 3 points and no faces: a cloud of"):
        read_surface(path)
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 1 0\nf 1 2 3 4 9\n")
    with pytest.raises(FileError, match=r"points\.obj.* not one of 5"):
        read_surface(path)
    path.write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"points\.obj': vertices hold NaN"):
        read_surface(path)


@pytest.mark.external
@pytest.mark.parametrize(
    ("case", "nodes", "tets"), [("box-3", 340, 1130), ("box-torus", 722, 3130)]
)
def test_published_meshes(shared_data: Path, case: str, nodes: int, tets: int) -> None:
    path = shared_data / "published-elastography" / case / "mesh.msh"
    mesh = read_mesh(path, unit="m")
    assert (mesh.n_points, mesh.n_tets) == (nodes, tets)
    assert mesh.volumes.sum() == pytest.approx(1000.0, rel=1e-3)
    content = meshio.gmsh.read(str(path))
    np.testing.assert_array_equal(mesh.points, content.points * 1000.0)
    in_file = content.cells_dict["tetra"]
    np.testing.assert_array_equal(np.sort(mesh.tets, axis=1), np.sort(in_file, axis=1))


def test_header_without_end_is_refused(tmp_path: Path) -> None:
    """The reader of .ply waits for the end of the header for ever."""
    path = tmp_path / "cut.ply"
    write_surface(path, *Box(size_mm=10.0).surface())
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(FileError, match="header has no end"):
        read_surface(path)


def test_absurd_node_tag_is_refused(tmp_path: Path) -> None:
    """Nodes are found by their tags, and no array is as long as the largest."""
    path = tmp_path / "flipped.msh"
    write_mesh(path, box_mesh(10.0, 1))
    content = bytearray(path.read_bytes())
    tags = content.index(b"$Nodes\n") + 7 + 32 + 20
    content[tags + 4] ^= 0x80  # 2^39
    path.write_bytes(content)
    with pytest.raises(FileError, match="there is no node 1"):
        read_mesh(path)
