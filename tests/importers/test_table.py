"""Tables of displacements and forces at points, and errors of wrong files."""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError, RecordingError, TactorchError
from tactorch.importers import import_table
from tactorch.importers.loads import consistent_loads
from tactorch.importers.quantities import parse
from tactorch.importers.sheets import read_sheet
from tactorch.importers.table import TableOptions
from tactorch.recording import Press, Recording

from .conftest import write_rows

Columns = dict[str, np.ndarray]


def without(columns: Columns, *names: str) -> Columns:
    return {name: values for name, values in columns.items() if name not in names}


def assert_same(recording: Recording, simulated: Recording) -> None:
    for made, press in zip(recording.presses, simulated.presses, strict=True):
        np.testing.assert_allclose(made.forces, press.forces, atol=1e-12)
        np.testing.assert_allclose(made.displacement, press.displacement, atol=1e-12)
        assert (made.observed == press.observed).all()
        assert (made.fixed == press.fixed).all()


def test_nodes_give_the_presses_back(
    tmp_path: Path, body: Path, rows: Columns, simulated: Recording
) -> None:
    path = write_rows(tmp_path / "a.csv", without(rows, "x_mm", "y_mm", "z_mm"))
    recording = import_table(path, mesh=body, noise_mm=0.01)
    assert_same(recording, simulated)
    assert [press.name for press in recording.presses] == ["1", "2"]
    assert recording.presses[0].noise_mm == 0.01
    assert recording.presses[0].direction == pytest.approx([0.0, 0.0, -1.0])


def test_presses_may_have_rows_anywhere_and_short_names(tmp_path: Path, body: Path) -> None:
    lines = [f"p{i % 1000},{i // 1000},0,0,0.01,0,0,0.1" for i in range(2000)]
    head = "press,node,ux,uy,uz,fx,fy,fz\n"
    (tmp_path / "a.csv").write_text(head + "\n".join(lines))
    presses = TableOptions(mesh=body)._read(read_sheet(tmp_path / "a.csv"), False)
    assert [data.name for data in presses] == [f"p{i}" for i in range(1000)]
    np.testing.assert_array_equal([data.nodes for data in presses], [[0, 1]] * 1000)
    (tmp_path / "a.csv").write_text(head + "\n".join([*lines, f"{'a' * 1001},0,0,0,0,0,0,0"]))
    with pytest.raises(FileError, match="line 2002, column 'press', has 1001 characters"):
        read_sheet(tmp_path / "a.csv")


def test_positions_of_nodes_files_units_and_names(
    tmp_path: Path, body: Path, rows: Columns, simulated: Recording
) -> None:
    """One file a press, in metres and mN, with semicolons and names of its own."""
    for press in (1, 2):
        chosen = rows["press"] == press
        own = {f"{axis}_m": rows[f"{axis}_mm"][chosen] * 1e-3 for axis in "xyz"}
        own |= {f"disp {axis}": rows[f"u{axis}_mm"][chosen] * 1e-3 for axis in "xyz"}
        own |= {f"load_{axis}_mN": rows[f"f{axis}_n"][chosen] * 1e3 for axis in "xyz"}
        write_rows(tmp_path / f"press{press}.csv", own, ";")
    write_rows(tmp_path / "press10.txt", own | {"load_z_mN": 2.0 * own["load_z_mN"]}, "\t")
    columns = {f"u{axis}": f"disp {axis}" for axis in "xyz"}
    columns |= {f"f{axis}": f"load_{axis}_mN" for axis in "xyz"}
    units = {f"u{axis}": "m" for axis in "xyz"}
    recording = import_table(tmp_path, mesh=body, columns=columns, units=units)
    assert [press.name for press in recording.presses] == ["press1", "press2", "press10"]
    assert_same(recording.select([0, 1]), simulated)


def test_points_between_nodes_become_readings_and_shared_forces(
    tmp_path: Path, body: Path, rows: Columns
) -> None:
    columns = {
        "x": np.array([1.0, 4.1, 7.0]), "y": np.array([2.3, 3.3, 8.0]),
        "z": np.array([10.05, 10.0, 9.95]), "uz": np.array([-0.1, -0.2, np.nan]),
        "u_n": np.array([np.nan, np.nan, -0.3]), "fz": np.array([-0.01, -0.02, np.nan]),
        "fx": np.array([np.nan, 0.001, np.nan]),
    }  # fmt: skip
    path = write_rows(tmp_path / "a.csv", columns)
    (press,) = import_table(path, mesh=body, noise_mm=0.02).presses
    assert not press.observed.any()
    assert press.surface is not None
    np.testing.assert_allclose(press.surface.displacement_mm, [-0.1, -0.2, -0.3])
    np.testing.assert_allclose(press.surface.directions, [(0, 0, 1)] * 3, atol=1e-12)
    np.testing.assert_allclose(press.surface.deviations_mm, 0.02)
    np.testing.assert_allclose(press.forces.sum(axis=0), [0.001, 0.0, -0.03], atol=1e-12)
    # The moment about any axis is that of the forces at the nearest points of the surface.
    mesh = import_table(path, mesh=body, noise_mm=0.02).mesh
    at = np.array([(1.0, 2.3, 10.0), (4.1, 3.3, 10.0)])
    forces = np.array([(0.0, 0.0, -0.01), (0.001, 0.0, -0.02)])
    np.testing.assert_allclose(
        np.cross(mesh.points, press.forces).sum(axis=0), np.cross(at, forces).sum(axis=0), atol=1e-9
    )


def test_a_given_normal_and_noise_are_used(tmp_path: Path, body: Path) -> None:
    slanted = np.array([0.6, 0.0, 0.8])
    columns = {
        "x": np.array([1.0]), "y": np.array([2.0]), "z": np.array([10.0]),
        "u_n_um": np.array([-300.0]), "nx": slanted[:1] * 1.1, "ny": slanted[1:2],
        "nz": slanted[2:] * 1.1, "fz": np.array([-0.01]), "noise_um": np.array([5.0]),
    }  # fmt: skip
    (press,) = import_table(write_rows(tmp_path / "a.csv", columns), mesh=body).presses
    assert press.surface is not None
    np.testing.assert_allclose(press.surface.directions, [slanted])
    np.testing.assert_allclose(press.surface.displacement_mm, [-0.3])
    np.testing.assert_allclose(press.surface.deviations_mm, [0.005])


def test_tractions_and_pressure_are_consistent_loads(
    tmp_path: Path,
    body: Path,
    rows: Columns,
    simulated: Recording,
    caplog: pytest.LogCaptureFixture,
) -> None:
    top = rows["z_mm"] > 9.99
    pressed = without(rows, "fx_n", "fy_n", "fz_n") | {
        "tz_kpa": np.where(top, -10.0 * rows["press"], np.nan)
    }
    pressed["tz_kpa"] = pressed["tz_kpa"].astype(float)
    (first, second) = import_table(write_rows(tmp_path / "a.csv", pressed), mesh=body).presses
    np.testing.assert_allclose(first.total_force, [0, 0, -1.0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(first.forces, simulated.presses[0].forces, atol=1e-12)
    np.testing.assert_allclose(second.forces, simulated.presses[1].forces, atol=1e-12)
    area = {"area_cm2": np.where(top, 0.25, np.nan), "p_kpa": np.where(top, 10.0, np.nan)}
    by_area = without(rows, "fx_n", "fy_n", "fz_n") | area
    assert "sharp edge" not in caplog.text
    press = import_table(write_rows(tmp_path / "b.csv", by_area), mesh=body).presses[0]
    assert "other points have a pressure" in caplog.text
    assert "give nx, ny and nz, or forces" in caplog.text
    at_top = press.forces[simulated.mesh.points[:, 2] > 9.99]
    np.testing.assert_allclose(np.linalg.norm(at_top, axis=1), 0.25)
    caplog.clear()
    up = {"nx": 0.0 * top, "ny": 0.0 * top, "nz": 1.0 + 0.0 * top}
    press = import_table(write_rows(tmp_path / "c.csv", by_area | up), mesh=body).presses[0]
    assert "sharp edge" not in caplog.text
    at_top = press.forces[simulated.mesh.points[:, 2] > 9.99]
    np.testing.assert_allclose(at_top, np.tile((0.0, 0.0, -0.25), (len(at_top), 1)), atol=1e-12)


def test_consistent_loads_sum_to_traction_times_area(simulated: Recording) -> None:
    mesh = simulated.mesh
    everywhere = np.tile((0.0, 0.0, 2.0), (mesh.n_points, 1))
    loads = consistent_loads(mesh.points, mesh.surface.triangles, everywhere)
    np.testing.assert_allclose(loads.sum(axis=0), [0.0, 0.0, 1200.0])
    np.testing.assert_allclose(loads[:, 2], 2.0 * mesh.vertex_areas)


def test_supports_come_from_columns_or_a_side(
    tmp_path: Path, body: Path, rows: Columns, simulated: Recording
) -> None:
    held = rows["x_mm"] < 0.01
    columns = {f"fixed_{axis}": held.astype(int) for axis in "xyz"}
    path = write_rows(tmp_path / "a.csv", rows | columns)
    press = import_table(path, mesh=body).presses[0]
    assert (press.fixed[:, 0] == (simulated.mesh.points[:, 0] < 0.01)).all()
    springs = {f"spring_{axis}_n_per_m": np.where(held, 2000.0, 0.0) for axis in "xyz"}
    press = import_table(write_rows(tmp_path / "b.csv", rows | springs), mesh=body).presses[0]
    assert not press.fixed.any()
    assert set(press.springs.ravel()) == {0.0, 2.0}
    plain = write_rows(tmp_path / "c.csv", rows)
    press = import_table(plain, mesh=body, support="y+", spring_n_per_mm=3.0).presses[0]
    assert ((press.springs == 3.0).all(axis=1) == (simulated.mesh.points[:, 1] > 9.99)).all()


def test_parquet_and_nodes_from_one(
    tmp_path: Path, body: Path, rows: Columns, simulated: Recording
) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    from_one = without(rows, "x_mm", "y_mm", "z_mm") | {"node": rows["node"] + 1}
    table = {name: [None if v != v else v for v in c.tolist()] for name, c in from_one.items()}
    parquet.write_table(pyarrow.table(table), tmp_path / "a.parquet")
    assert_same(import_table(tmp_path / "a.parquet", mesh=body, first_node=1), simulated)


def test_names_of_presses_in_parquet_are_kept_apart_and_required(
    tmp_path: Path, body: Path
) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    def names(*presses: float | str | None) -> list[str]:
        values = {"press": presses, "node": [26, 25], "uz": [-0.1, -0.1], "fz": [-0.1, -0.1]}
        parquet.write_table(pyarrow.table(values), tmp_path / "a.parquet")
        return [press.name for press in import_table(tmp_path / "a.parquet", mesh=body).presses]

    assert names(1234567.0, 1234568.0) == ["1234567", "1234568"]
    assert names(0.12345671, 0.12345672) == ["0.12345671", "0.12345672"]
    for missing in (None, float("nan")):
        with pytest.raises(FileError, match="row 1 names no press"):
            names(1.0, missing)
    with pytest.raises(FileError, match="row 1 names no press"):
        names("a", None)


def test_parquet_without_pyarrow_names_the_extra(
    tmp_path: Path, body: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"tactorch\[tables\]"):
        import_table(tmp_path / "a.parquet", mesh=body)


@pytest.mark.parametrize(
    ("name", "quantity", "factor"),
    [
        ("ux", "ux", 1.0), ("UX_mm", "ux", 1.0), ("u_n", "u_n", 1.0), ("u_n_um", "u_n", 1e-3),
        ("fx_n", "fx", 1.0), ("fx_mN", "fx", 1e-3), ("p_kPa", "p", 1e-3), ("x_m", "x", 1e3),
        ("spring_x_n_per_m", "spring_x", 1e-3), ("area_m2", "area", 1e6),
    ],
)  # fmt: skip
def test_names_state_quantity_and_unit(name: str, quantity: str, factor: float) -> None:
    assert parse(name) == (quantity, factor)
    assert parse(f"{name}_x") is None


def change(**columns: object) -> Callable[[Columns], Columns]:
    """Return a function that replaces a cell (row, value) of columns, or drops them."""

    def spoil(rows: Columns) -> Columns:
        spoilt = {name: list(values) for name, values in rows.items()}
        for name, given in columns.items():
            if given is None:
                del spoilt[name]
            else:
                row, value = given
                spoilt[name][row] = value
        return spoilt

    return spoil


def pointed(rows: Columns) -> Columns:
    return without(rows, "node")


Wrong = tuple[Callable[[Columns], Columns], dict, type[TactorchError], str]
WRONG: dict[str, Wrong] = {
    "text in a number": (change(ux_mm=(3, "soft")), {}, FileError, r"line 5.*'ux_mm'.*'soft'"),
    "infinite": (change(fz_n=(3, "inf")), {}, FileError, r"line 5.*'fz_n'.*'inf'"),
    "no place": (
        change(node=None, z_mm=None), {}, FileError, r"no column 'node' and lacks z.*x_mm, y_mm"
    ),
    "no displacement": (change(ux_mm=None, uy_mm=None, uz_mm=None), {}, FileError, r"displacement"),
    "no force": (change(fx_n=None, fy_n=None, fz_n=None), {}, FileError, r"column of a force"),
    "node beyond": (change(node=(2, 27)), {}, FileError, r"line 4 names node 27.*27 \(0 to 26\)"),
    "broken node": (change(node=(2, 1.5)), {}, FileError, r"line 4 names node 1.5"),
    "negative node": (change(node=(2, -1)), {}, FileError, r"line 4 names node -1"),
    "node twice": (change(node=(3, 0)), {}, FileError, r"line 5 has node 0.*press '1'.*line 2"),
    "row without a place": (
        lambda rows: change(x_mm=(4, ""))(pointed(rows)), {}, FileError, r"line 6 has neither"
    ),
    "point far away": (
        lambda rows: change(x_mm=(4, 60.0))(pointed(rows)), {}, FileError,
        r"line 6: the point \(60.*50 mm from the surface.*1 of 26",
    ),
    "metres": (
        lambda rows: {n: c * 1e3 if n[0] in "xyz" else c for n, c in pointed(rows).items()}, {},
        FileError, r"check units",
    ),
    "nameless press": (change(press=(5, "")), {}, FileError, r"line 7 names no press"),
    "normal of no unit length": (
        lambda rows: rows | {n: np.full(52, 2.0) for n in ("nx", "ny", "nz")}, {}, FileError,
        r"line 2 has a normal of length 3.46",
    ),
    "reading without noise": (
        lambda rows: change(x_mm=(8, 2.7), y_mm=(8, 2.2), z_mm=(8, 10.0))(pointed(rows)), {},
        FileError, r"line 10.*format.noise_mm",
    ),
    "traction without area": (
        lambda rows: change(x_mm=(0, 2.7), y_mm=(0, 2.2), z_mm=(0, 10.0))(pointed(rows))
        | {"tz": [-0.01] * 52},
        {"noise_mm": 0.1}, FileError, r"line 2.*'area'",
    ),
    "support without a node": (
        lambda rows: change(x_mm=(8, 2.7), y_mm=(8, 2.2), z_mm=(8, 0.0))(pointed(rows))
        | {"fixed_z": [0.0] * 8 + [1.0] * 44},
        {"noise_mm": 0.1}, FileError, r"line 10.*fixed or on springs.*no node",
    ),
    "unlike noise": (
        lambda rows: rows | {"noise": np.linspace(0.1, 0.2, 52)}, {}, FileError, r"noise.*differs"
    ),
    "two units": (lambda rows: rows | {"ux_m": rows["ux_mm"]}, {}, ConfigError, "both have"),
    "no quantity": (lambda r: r, {"columns": {"vx": "ux_mm"}}, ConfigError, "'vx' is unknown"),
    "unknown column": (lambda r: r, {"columns": {"ux": "dx"}}, ConfigError, r"no column 'dx'"),
    "unknown unit": (lambda r: r, {"units": {"ux": "ell"}}, ConfigError, "'ell'.*mm, cm"),
    "unit that is not read": (
        lambda rows: {n.replace("ux_mm", "ux [ft]"): c for n, c in rows.items()}, {}, ConfigError,
        r"'ux \[ft\]' has the unit 'ft', which is none of mm, .*format\.units={ux: mm}",
    ),
    "unknown material": (lambda r: r, {"material": "wood"}, ConfigError, r"wood.*neo_hookean"),
    "no force at all": (
        lambda rows: rows | {f"f{a}_n": np.zeros(52) for a in "xyz"}, {}, RecordingError,
        r"a.csv.*press '1'.*forces are all 0",
    ),
    "kN": (lambda r: r | {"fz_n": r["fz_n"] * 1e6}, {}, RecordingError, r"a.csv.*mN"),
    "no supports": (lambda r: r, {"support": None}, RecordingError, r"nothing holds"),
    "steps of one press": (lambda r: r | {"step": np.arange(52)}, {}, FileError, r"steps 0, 1"),
}  # fmt: skip


@pytest.mark.parametrize("given", WRONG)
def test_wrong_rows_are_named(tmp_path: Path, body: Path, rows: Columns, given: str) -> None:
    spoil, settings, error, words = WRONG[given]
    path = write_rows(tmp_path / "a.csv", spoil(rows))
    with pytest.raises(error, match=words):
        import_table(path, mesh=body, **settings)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"", "empty"),
        ("a.csv", b"node,ux,fx\n", "no rows"),
        ("a.csv", b"node,ux,fx\n1,2\n", "line 2 has 2 cells"),
        ("a.csv", b"node,node,fx\n1,2,3\n", "two columns 'node'"),
        ("a.csv", b"\xff\xfe\x00", "not a table"),
        ("a.xlsx", b"node", "unknown suffix"),
        ("a.parquet", b"node", "Parquet"),
        ("none.csv", None, "none.csv"),
        ("folder", None, "contains no table"),
    ],
)
def test_wrong_files_are_named(
    tmp_path: Path, body: Path, name: str, content: bytes | None, words: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    elif name == "folder":
        path.mkdir()
    with pytest.raises(FileError, match=words):
        import_table(path, mesh=body)


def test_a_mesh_is_needed(tmp_path: Path, rows: Columns) -> None:
    from tactorch.importers import FORMATS

    path = write_rows(tmp_path / "a.csv", rows)
    with pytest.raises(ConfigError, match=r"format\.mesh is required"):
        FORMATS.build("table")(path=path)
    with pytest.raises((FileError, MeshError), match=r"no\.vtu"):
        import_table(path, mesh=tmp_path / "no.vtu")


def test_two_files_of_one_press(tmp_path: Path, body: Path, rows: Columns) -> None:
    folder = tmp_path / "presses"
    folder.mkdir()
    one = {name: values[rows["press"] == 1] for name, values in rows.items() if name != "press"}
    write_rows(folder / "a.csv", one)
    write_rows(folder / "a.txt", one)
    with pytest.raises(FileError, match="'a' in two files"):
        import_table(folder, mesh=body)


def test_an_interior_node_may_be_observed(body: Path, tmp_path: Path, simulated: Recording) -> None:
    inner = np.setdiff1d(np.arange(simulated.mesh.n_points), simulated.mesh.surface.nodes())
    x, y, z = simulated.mesh.points[inner].T
    columns = {"x": x, "y": y, "z": z, "uz": 0.0 * x - 0.1, "fz": 0.0 * x - 0.1}
    press: Press
    (press,) = import_table(write_rows(tmp_path / "a.csv", columns), mesh=body).presses
    assert press.observed[inner, 2].all()
    assert press.observed.sum() == len(inner)
