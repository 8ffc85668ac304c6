"""Fields of VTK files, and errors of wrong files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import pyvista

from tactorch.errors import ConfigError, FileError, MeshError, RecordingError, TactorchError
from tactorch.importers import import_vtk
from tactorch.importers.vtk_files import read_vtk
from tactorch.mesh import TetMesh, write_mesh
from tactorch.recording import Recording

Fields = dict[str, np.ndarray]


def fields_of(simulated: Recording, press: int) -> Fields:
    chosen = simulated.presses[press]
    return {"Displacement": chosen.displacement, "nodal_force": chosen.forces}


def write(path: Path, mesh: TetMesh, fields: Fields, scale: float = 1.0) -> Path:
    cells = [("tetra", np.array(mesh.tets))]
    content = meshio.Mesh(scale * np.array(mesh.points), cells, point_data=fields)
    getattr(meshio, path.suffix[1:]).write(str(path), content)
    return path


def write_surface(path: Path, mesh: TetMesh, fields: Fields, **others: Any) -> Path:
    """Write the surface alone, its points in another order."""
    nodes = mesh.surface.nodes()[::-1]
    triangles = np.argsort(nodes)[np.searchsorted(np.sort(nodes), mesh.surface.triangles)]
    points, fields = mesh.points[nodes], {name: values[nodes] for name, values in fields.items()}
    if path.suffix == ".vtp":
        write_vtp(path, points, triangles, fields)
    else:
        meshio.vtu.write(str(path), meshio.Mesh(points, [("triangle", triangles)], fields))
    return path


def write_vtp(path: Path, points: np.ndarray, triangles: np.ndarray, fields: Fields) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    data, places, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    for triangle in triangles:
        cells.InsertNextCell(3, [int(node) for node in triangle])
    data.SetPoints(places)
    data.SetPolys(cells)
    for name, values in fields.items():
        array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    writer.Write()


def assert_same(recording: Recording, simulated: Recording) -> None:
    surface = np.zeros(simulated.mesh.n_points, dtype=bool)
    surface[simulated.mesh.surface.nodes()] = True
    for made, press in zip(recording.presses, simulated.presses, strict=True):
        np.testing.assert_allclose(made.forces, press.forces, atol=1e-6)
        assert (made.observed == press.observed & surface[:, None]).all()
        both = made.observed
        np.testing.assert_allclose(made.displacement[both], press.displacement[both], atol=1e-6)
        assert (made.fixed == press.fixed).all()


@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
def test_the_mesh_and_the_presses_are_those_of_the_files(
    tmp_path: Path, simulated: Recording, suffix: str
) -> None:
    for press in (0, 1):
        write(tmp_path / f"step{press + 9}.{suffix}", simulated.mesh, fields_of(simulated, press))
    recording = import_vtk(tmp_path, noise_mm=0.01)
    assert [press.name for press in recording.presses] == ["step9", "step10"]
    np.testing.assert_allclose(recording.mesh.points, simulated.mesh.points)
    assert_same(recording, simulated)


@pytest.mark.parametrize("suffix", ["vtu", "vtp"])
def test_surfaces_of_any_order_are_taken_to_a_given_mesh(
    tmp_path: Path, simulated: Recording, body: Path, suffix: str
) -> None:
    if suffix == "vtp":
        pytest.importorskip("vtkmodules")
    (tmp_path / "presses").mkdir()
    for press in (0, 1):
        path = tmp_path / "presses" / f"p{press}.{suffix}"
        write_surface(path, simulated.mesh, fields_of(simulated, press))
    assert_same(import_vtk(tmp_path / "presses", mesh=body), simulated)


def test_a_first_file_without_fields_and_one_without_motion_are_no_presses(
    tmp_path: Path, simulated: Recording
) -> None:
    write(tmp_path / "a0.vtu", simulated.mesh, {})
    zero = {name: 0.0 * values for name, values in fields_of(simulated, 0).items()}
    write(tmp_path / "a1.vtu", simulated.mesh, zero)
    write(tmp_path / "a2.vtu", simulated.mesh, fields_of(simulated, 0))
    assert [press.name for press in import_vtk(tmp_path).presses] == ["a2"]


def test_units_and_names_are_settings(tmp_path: Path, simulated: Recording) -> None:
    displacement, force = fields_of(simulated, 0).values()
    fields = {"a": 1e-3 * displacement, "b": 1e3 * force, "u": np.zeros_like(force)}
    path = write(tmp_path / "a.vtu", simulated.mesh, fields, scale=1e-3)
    recording = import_vtk(path, displacement="a", force="b", unit="m", force_unit="mN")
    assert_same(recording, simulated.select([0]))
    assert recording.mesh.diagonal == pytest.approx(simulated.mesh.diagonal)


def test_deformed_points_are_moved_back(tmp_path: Path, simulated: Recording) -> None:
    fields = fields_of(simulated, 0)
    fields["Displacement"] = np.nan_to_num(fields["Displacement"])
    moved = TetMesh.create(simulated.mesh.points + fields["Displacement"], simulated.mesh.tets)
    recording = import_vtk(write(tmp_path / "a.vtu", moved, fields), deformed=True)
    np.testing.assert_allclose(recording.mesh.points, simulated.mesh.points, atol=1e-9)


def test_pressure_and_traction_act_on_the_triangles_of_the_file(
    tmp_path: Path, simulated: Recording, body: Path
) -> None:
    """As simulated: from the top, whose rim has a pressure as well."""
    top = simulated.mesh.points[:, 2] > 9.99
    fields = {"disp": simulated.presses[0].displacement}
    loads = (
        {"contact pressure": np.where(top, 10.0, 0.0)},
        {"Traction": np.where(top[:, None], (0.0, 0.0, -10.0), np.nan)},
    )
    for load in loads:
        path = write_surface(tmp_path / "a.vtu", simulated.mesh, fields | load)
        recording = import_vtk(path, mesh=body, stress_unit="kPa")
        assert_same(recording, simulated.select([0]))


def test_normals_of_an_inward_surface_are_those_of_the_mesh(
    tmp_path: Path, simulated: Recording, body: Path
) -> None:
    mesh = simulated.mesh
    pressure = np.where(mesh.points[:, 2] > 9.99, 0.01, 0.0)
    fields = {"u": simulated.presses[0].displacement, "p": pressure}
    inward = [("triangle", mesh.surface.triangles[:, ::-1])]
    meshio.vtu.write(str(tmp_path / "a.vtu"), meshio.Mesh(mesh.points, inward, fields))
    (press,) = import_vtk(tmp_path / "a.vtu", mesh=body).presses
    np.testing.assert_allclose(press.total_force, [0.0, 0.0, -1.0], atol=1e-12)


def test_other_points_are_readings_and_repeated_points_are_one(tmp_path: Path, body: Path) -> None:
    points = np.array([(1.0, 2.0, 10.0), (4.0, 3.0, 10.0), (4.0, 3.0, 10.0), (7.0, 6.0, 10.0)])
    fields = {
        "u": np.array([(0, 0, -0.1), (0, 0, -0.2), (0, 0, -0.2), (np.nan,) * 3]),
        "f": np.tile((0.0, 0.0, -0.01), (4, 1)),
    }
    cells = [("triangle", np.array([(0, 1, 3), (0, 2, 3)]))]
    meshio.vtu.write(str(tmp_path / "a.vtu"), meshio.Mesh(points, cells, fields))
    (press,) = import_vtk(tmp_path / "a.vtu", mesh=body, noise_mm=0.01).presses
    assert press.surface is not None
    assert len(press.surface.points_mm) == 6
    assert press.total_force == pytest.approx([0.0, 0.0, -0.03])
    for name, what, row in (("u", "displacement", 2), ("f", "force", 1)):
        unlike = fields | {name: fields[name] + np.eye(4)[:, [row]] * 0.01}
        meshio.vtu.write(str(tmp_path / "a.vtu"), meshio.Mesh(points, cells, unlike))
        with pytest.raises(FileError, match=rf"point 2 is at .* point 1, .* another {what}"):
            import_vtk(tmp_path / "a.vtu", mesh=body, noise_mm=0.01)


def test_split_edges_of_a_surface_keep_forces_and_pressures(
    tmp_path: Path, simulated: Recording, body: Path
) -> None:
    """Each triangle has points of its own, as after filters that compute normals."""
    mesh, press = simulated.mesh, simulated.presses[0]
    nodes = mesh.surface.triangles.ravel()
    cells = [("triangle", np.arange(len(nodes)).reshape(-1, 3))]
    pressure = np.where(mesh.points[:, 2] > 9.99, 0.01, 0.0)
    for load in ({"force": press.forces[nodes]}, {"pressure": pressure[nodes]}):
        fields = {"u": press.displacement[nodes], **load}
        meshio.vtu.write(str(tmp_path / "a.vtu"), meshio.Mesh(mesh.points[nodes], cells, fields))
        assert_same(import_vtk(tmp_path / "a.vtu", mesh=body), simulated.select([0]))


def rename(**names: str | None) -> Callable[[Fields], Fields]:
    def change(fields: Fields) -> Fields:
        renamed = {names.get(n.replace(" ", "_"), n): v for n, v in fields.items()}
        return {name: values for name, values in renamed.items() if name is not None}

    return change


def put(name: str, row: int, value: float) -> Callable[[Fields], Fields]:
    def change(fields: Fields) -> Fields:
        changed = fields[name].copy()
        changed[row] = value
        return fields | {name: changed}

    return change


Wrong = tuple[Callable[[Fields], Fields], dict, type[TactorchError], str]
WRONG: dict[str, Wrong] = {
    "no displacement": (
        rename(Displacement="shift"), {}, FileError,
        r"recognised as displacement; its fields are shift, nodal_force.*format.displacement",
    ),
    "no load": (
        rename(nodal_force="stress"), {}, FileError, r"force or traction or pressure.*format.force"
    ),
    "two displacements": (
        lambda f: f | {"U": f["Displacement"]}, {}, FileError, r"several.*Displacement, U"
    ),
    "unknown field": (lambda f: f, {"force": "load"}, FileError, r"no field 'load'.*nodal_force"),
    "scalar displacement": (
        lambda f: f | {"Displacement": f["Displacement"][:, 2]}, {}, FileError,
        r"'Displacement' has the shape \(27,\).*3 numbers",
    ),
    "infinite": (put("nodal_force", 4, np.inf), {}, FileError, r"point 4 has an infinite load"),
    "infinite shift": (put("Displacement", 3, -np.inf), {}, FileError, r"point 3.*displacement"),
    "nothing moves": (
        lambda f: {n: 0.0 * v for n, v in f.items()}, {}, FileError, "no file in which something"
    ),
    "no force": (
        lambda f: f | {"nodal_force": 0.0 * f["nodal_force"]}, {}, RecordingError, "forces are all"
    ),
    "unit": (lambda f: f, {"file_unit": "m"}, FileError, r"point \d+: the point.*check units"),
    "Pa": (
        lambda f: {"u": f["Displacement"], "p": np.full(27, 1e4)}, {}, RecordingError,
        "a pressure in Pa",
    ),
    "unknown unit": (lambda f: f, {"force_unit": "lbf"}, ConfigError, "force_unit"),
    "deformed where unknown": (
        put("Displacement", 26, np.nan), {"deformed": True}, FileError, "displacement is not known"
    ),
}  # fmt: skip


@pytest.mark.parametrize("given", WRONG)
def test_wrong_fields_are_named(
    tmp_path: Path, simulated: Recording, body: Path, given: str
) -> None:
    change, settings, error, words = WRONG[given]
    path = write(tmp_path / "a.vtu", simulated.mesh, change(fields_of(simulated, 0)))
    with pytest.raises(error, match=words):
        import_vtk(path, mesh=body, **settings)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.vtu", b"", "vtu"),
        ("a.vtu", b"<VTKFile", "cannot be read as vtu"),
        ("a.vtk", b"# vtk DataFile Version 3.0\n", "cannot be read as vtk"),
        ("a.vtp", b"<VTKFile", "cannot be read as vtp"),
        ("a.vti", b"x", "unknown suffix"),
        ("none.vtu", None, "none.vtu"),
        ("folder", None, "contains no file"),
    ],
)
def test_wrong_files_are_named(
    tmp_path: Path, body: Path, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    elif name == "folder":
        (tmp_path / name).mkdir()
    with pytest.raises(FileError, match=words):
        import_vtk(tmp_path / name, mesh=body)


def test_a_file_that_is_cut_short_is_named(tmp_path: Path, simulated: Recording) -> None:
    path = write(tmp_path / "a.vtu", simulated.mesh, fields_of(simulated, 0))
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(FileError, match=r"a\.vtu"):
        import_vtk(path)


def test_a_surface_needs_a_mesh(tmp_path: Path, simulated: Recording) -> None:
    path = write_surface(tmp_path / "a.vtu", simulated.mesh, fields_of(simulated, 0))
    with pytest.raises(FileError, match=r"no tetrahedra.*format\.mesh"):
        import_vtk(path)


def test_a_damaged_mesh_is_named(tmp_path: Path, simulated: Recording) -> None:
    cells = [("tetra", np.vstack((simulated.mesh.tets, simulated.mesh.tets[:1])))]
    content = meshio.Mesh(simulated.mesh.points, cells, fields_of(simulated, 0))
    meshio.vtu.write(str(tmp_path / "a.vtu"), content)
    with pytest.raises(MeshError, match=r"a\.vtu.*repeats elements"):
        import_vtk(tmp_path / "a.vtu")


def test_two_files_of_one_press(tmp_path: Path, simulated: Recording) -> None:
    for suffix in ("vtu", "vtk"):
        write(tmp_path / f"a.{suffix}", simulated.mesh, fields_of(simulated, 0))
    with pytest.raises(FileError, match="two files of the press 'a'"):
        import_vtk(tmp_path)


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZMA"])
@pytest.mark.parametrize("encoded", [True, False])
def test_surfaces_of_vtk_in_each_encoding(
    tmp_path: Path, mode: str, compressor: str, encoded: bool
) -> None:
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    surface = pyvista.Plane(i_resolution=2, j_resolution=1).triangulate()
    surface["u"] = np.arange(3.0 * surface.n_points).reshape(-1, 3)
    writer = vtk.vtkXMLPolyDataWriter()
    writer.SetFileName(str(tmp_path / "a.vtp"))
    writer.SetInputData(surface)
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    writer.SetEncodeAppendedData(encoded)
    writer.Write()
    found = read_vtk(tmp_path / "a.vtp")
    np.testing.assert_allclose(found.points, surface.points, atol=1e-6)
    np.testing.assert_array_equal(found.triangles, surface.regular_faces)
    np.testing.assert_allclose(found.fields["u"], surface["u"])


def test_results_written_by_the_library_are_read(tmp_path: Path, simulated: Recording) -> None:
    displacement, force = fields_of(simulated, 0).values()
    data = {"displacement": displacement, "force": force}
    write_mesh(tmp_path / "a.vtu", simulated.mesh, point_data=data)
    assert_same(import_vtk(tmp_path / "a.vtu"), simulated.select([0]))


@pytest.mark.parametrize("stated", ["POINTS 400000000 double", "CELLS 300000000 4"])
def test_a_header_that_states_more_than_the_file_is_refused(tmp_path: Path, stated: str) -> None:
    head = "# vtk DataFile Version 3.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\n"
    (tmp_path / "a.vtk").write_text(f"{head}{stated}\n0 0 0\n")
    with pytest.raises(FileError, match=f"{stated.removesuffix(' double')} take"):
        read_vtk(tmp_path / "a.vtk")
