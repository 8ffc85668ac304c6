"""Wrong input: each gets one message that names what is wrong, status 2, and leaves no result.

`pytest tests/cli/test_bad_input.py --bad-input-table` prints the inputs with their messages.
"""

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tactorch.mesh import TetMesh, box_mesh, read_mesh, write_mesh, write_surface
from tactorch.recording import Recording

Spoil = Callable[[Path], object]


@dataclass(frozen=True)
class Case:
    """A wrong input: what it is, words of its message, how it comes about."""

    given: str
    words: tuple[str, ...]
    spoil: Spoil = lambda path: None
    settings: tuple[str, ...] = ()


def cases(*all_cases: Case) -> Any:
    return pytest.mark.parametrize("case", all_cases, ids=lambda case: case.given)


def check(case: Case, done: Any, places: list[Path], table: list[tuple[str, str]]) -> None:
    """Assert status and message of one command, without the folders of this machine."""
    assert done.status == 2, done.out + done.err
    message = done.err.strip()
    assert message.startswith("tactorch ")
    assert "Traceback" not in message
    assert len(message.splitlines()) == 1
    for place in sorted(places, key=lambda p: -len(str(p))):
        message = message.replace(f"{place}/", "").replace(str(place), ".")
    for word in case.words:
        assert word in message, message
    table.append((case.given, message.split("error: ", 1)[-1]))


# ---------------------------------------------------------------- files of others


def text(name: str, change: Callable[[str], str]) -> Spoil:
    """Change the text of a file of the published case."""

    def spoil(folder: Path) -> None:
        (folder / name).write_text(change((folder / name).read_text()))

    return spoil


def numbers(name: str, change: Callable[[np.ndarray], Any]) -> Spoil:
    """Change the numbers of a file of the published case."""

    def spoil(folder: Path) -> None:
        np.savetxt(folder / name, change(np.loadtxt(folder / name)), fmt="%.17g")

    return spoil


def mesh(change: Callable[[TetMesh], Any]) -> Spoil:
    """Put another mesh into the published case."""

    def spoil(folder: Path) -> None:
        import meshio

        points, cells = change(read_mesh(folder / "mesh.msh", unit="m"))
        meshio.gmsh.write(str(folder / "mesh.msh"), meshio.Mesh(points * 1e-3, cells))

    return spoil


def two_parts(m: TetMesh) -> tuple[np.ndarray, list[Any]]:
    points = np.vstack((m.points, m.points + 100))
    return points, [("tetra", np.vstack((m.tets, m.tets + m.n_points)))]


def flat_element(m: TetMesh) -> tuple[np.ndarray, list[Any]]:
    points = m.points.copy()
    points[:, 2] = np.where(points[:, 2] > 6, 5, points[:, 2])
    return points, [("tetra", m.tets)]


def lonely_node(m: TetMesh) -> tuple[np.ndarray, list[Any]]:
    return np.vstack((m.points, [[20, 20, 20]])), [("tetra", m.tets)]


def nan_node(m: TetMesh) -> tuple[np.ndarray, list[Any]]:
    points = m.points.copy()
    points[3, 1] = np.nan
    return points, [("tetra", m.tets)]


def only_surface(m: TetMesh) -> tuple[np.ndarray, list[Any]]:
    return m.points, [("triangle", m.surface.triangles)]


def in_millimetres(folder: Path) -> None:
    mesh(lambda m: (m.points * 1e3, [("tetra", m.tets)]))(folder)
    for number in (1, 2):
        numbers(f"presses/pnt{number}.txt", lambda x: x * 1e3)(folder)


def second(change: Callable[[float], object]) -> Callable[[np.ndarray], list[object]]:
    """Change the second of the numbers."""
    return lambda x: [x[0], change(x[1]), *x[2:]]


FORCE, POSITIONS, SPRINGS, SEEN = (f"presses/{name}1.txt" for name in ("force", "pnt", "A-", "B-"))


@cases(
    Case(
        "mesh file missing",
        ("mesh.msh' is not a file", "holds: presses"),
        lambda f: (f / "mesh.msh").unlink(),
    ),
    Case(
        "file of deformed nodes missing",
        ("press 1 lacks", "pnt1.txt", "add it, or remove"),
        lambda f: (f / POSITIONS).unlink(),
    ),
    Case(
        "no presses at all",
        ("presses' holds no press",),
        lambda f: [p.unlink() for p in (f / "presses").iterdir()],
    ),
    Case("folder given is a file", ("'case/mesh.msh' is not a folder",), settings=("mesh.msh",)),
    Case(
        "force file cut short",
        ("force1.txt' holds 60 numbers", "needs 81", "cut short"),
        text(FORCE, lambda t: "\n".join(t.splitlines()[:60])),
    ),
    Case(
        "force on a missing node",
        ("force1.txt' holds 84 numbers", "each of the 27 nodes"),
        text(FORCE, lambda t: t + "0\n0\n-1\n"),
    ),
    Case(
        "force NaN",
        ("force1.txt' line 2", "'nan'", "not a finite number"),
        numbers(FORCE, second(lambda _: np.nan)),
    ),
    Case(
        "NaN in a deformed position",
        ("pnt1.txt' line 2", "'nan'", "leave out the press"),
        numbers(POSITIONS, second(lambda _: np.nan)),
    ),
    Case(
        "text among the numbers", ("pnt1.txt' line 1 has 'x0'",), text(POSITIONS, lambda t: "x" + t)
    ),
    Case(
        "deformed positions in mm, mesh in m",
        ("pnt1.txt'", "metres", "convert"),
        numbers(POSITIONS, lambda x: x * 1e3),
    ),
    Case(
        "mesh and positions in mm where metres belong",
        ("mesh.msh' is 17.3 m across", "in metres", "convert"),
        in_millimetres,
    ),
    Case(
        "forces in mN",
        ("press '1'", "mN", "Convert to N and mm"),
        numbers(FORCE, lambda x: x * 1e3),
    ),
    Case(
        "springs off the diagonal",
        ("A-1.txt' line 1 is off the diagonal", "only the diagonal"),
        text(SPRINGS, lambda t: "0 1 1000\n" + t),
    ),
    Case(
        "spring on a missing node",
        ("A-1.txt' line 1 names degree of freedom 81", "counted from 1"),
        text(SPRINGS, lambda t: "81 81 1000\n" + t),
    ),
    Case(
        "spring given twice",
        ("A-1.txt' line 2 repeats",),
        text(SPRINGS, lambda t: t.splitlines()[0] + "\n" + t),
    ),
    Case(
        "negative spring",
        ("A-1.txt' line 1 has the negative value -1000",),
        text(SPRINGS, lambda t: t.replace(" 1000", " -1000", 1)),
    ),
    Case(
        "no fixed nodes",
        ("press '1'", "nothing holds the object", "Fix more"),
        text(SPRINGS, lambda t: ""),
    ),
    Case(
        "held in one node only",
        ("nothing holds the object; it can turn",),
        text(SPRINGS, lambda t: "\n".join(f"{i} {i} 1000" for i in range(3))),
    ),
    Case("nothing observed", ("observed is empty",), text(SEEN, lambda t: "")),
    Case(
        "observed marked by 2",
        ("B-1.txt' has the value 2", "has the value 1"),
        text(SEEN, lambda t: t.replace(" 1\n", " 2\n", 1)),
    ),
    Case(
        "mesh in two parts",
        ("mesh.msh'", "2 disconnected parts", "merge the nodes"),
        mesh(two_parts),
    ),
    Case("flat elements", ("mesh.msh'", "degenerate"), mesh(flat_element)),
    Case(
        "node of no element",
        ("mesh.msh'", "no tetrahedron uses 1 of 28 nodes (27)"),
        mesh(lonely_node),
    ),
    Case("NaN in a node", ("mesh.msh'", "finite"), mesh(nan_node)),
    Case(
        "surface for a mesh", ("mesh.msh'", "no tetrahedra", "tetrahedralize"), mesh(only_surface)
    ),
    Case(
        "mesh file of another format",
        ("mesh.msh' cannot be read as gmsh", "its suffix says"),
        lambda f: (f / "mesh.msh").write_text("solid cube\nendsolid\n"),
    ),
    Case(
        "truth of another mesh",
        ("youngs_true.txt' holds 39 numbers", "each of the 40"),
        numbers("youngs_true.txt", lambda x: x[1:]),
    ),
    Case(
        "modulus of zero",
        ("truth is 0 MPa at element 1", "moduli are above 0"),
        numbers("youngs_true.txt", second(lambda _: 0.0)),
    ),
    Case(
        "truth in MPa where Pa belongs",
        ("youngs_true.txt' has a median of 0.36 Pa", "convert from MPa"),
        numbers("youngs_true.txt", lambda x: x * 1e-6),
    ),
    Case(
        "Poisson's ratio 0.5", ("poisson is 0.5", "0.49 to 0.499"), settings=("format.poisson=0.5",)
    ),
    Case(
        "relabelling of a modulus that is not there",
        ("no element of", "7 MPa", "its moduli are"),
        settings=("format.relabel_truth={7.0: 1.0}",),
    ),
    Case(
        "unknown format",
        ("format=matlab is unknown", "choose one of grasp, palpation, published"),
        settings=("format=matlab",),
    ),
    Case(
        "output below a file",
        ("nothing can be written into 'case/mesh.msh'", "a.h5", "choose another folder"),
        settings=("out=case/mesh.msh/a.h5",),
    ),
    Case(
        "output is a folder",
        ("out=case is a folder", "give the name of a file"),
        settings=("out=case",),
    ),
)
def test_import_refuses(
    case: Case, tactorch: Any, published: Path, tmp_path: Path, table: list[tuple[str, str]]
) -> None:
    case.spoil(published)
    path = published
    settings = [s.replace("case", str(published)) for s in case.settings]
    if settings and "=" not in settings[0]:
        path, settings = published / settings[0], []
    done = tactorch("import", f"path={path}", "out=new.h5", *settings)
    check(case, done, [tmp_path], table)
    assert [p.name for p in Path().iterdir()] == [p for p in ("outputs",) if Path(p).exists()]
    assert not list(tmp_path.rglob("*.part*"))


# ---------------------------------------------------------------- recordings


def h5(name: str, change: Callable[[Any], Any]) -> Spoil:
    """Change a dataset of the recording."""

    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            values = change(file[name][()])
            del file[name]
            if values is not None:
                file[name] = values

    return spoil


def attribute(name: str, value: object, group: str = "/") -> Spoil:
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            file[group].attrs[name] = value

    return spoil


def cut(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def nan_where_seen(values: np.ndarray) -> np.ndarray:
    values[tuple(np.argwhere(np.isfinite(values))[0])] = np.nan
    return values


def swapped(tets: np.ndarray) -> np.ndarray:
    tets[0] = tets[0][[0, 1, 3, 2]]
    return tets


def text_file(path: Path) -> None:
    path.write_text("1 2 3\n")


def other_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["u"] = np.zeros(3)


ONE = "presses/0000"


@cases(
    Case("recording missing", ("recording not found", "case.h5' is not a file"), Path.unlink),
    Case(
        "recording not given",
        ("'recording' is missing", "recording=..."),
        settings=("recording=???",),
    ),
    Case("HDF5 cut short", ("case.h5' is damaged or cut short", "copy it again"), cut),
    Case("not HDF5", ("case.h5' is not an HDF5 file",), text_file),
    Case("HDF5 of another kind", ("not a recording of tactorch", "format None"), other_hdf5),
    Case("newer version", ("version 99", "upgrade tactorch"), attribute("version", 99)),
    Case("other units", ("is in units 'm, N, Pa'", "convert"), attribute("units", "m, N, Pa")),
    Case(
        "dataset missing",
        (f"lacks dataset '{ONE}/forces'", "write the recording again"),
        h5(f"{ONE}/forces", lambda x: None),
    ),
    Case(
        "arrays of another mesh",
        (f"'{ONE}/displacement' has shape (26, 3)", "(27, 3) is needed"),
        h5(f"{ONE}/displacement", lambda x: x[1:]),
    ),
    Case(
        "numbers that are text",
        ("dtype object", "float64 is needed"),
        h5(f"{ONE}/forces", lambda x: x.astype(str).astype("S").astype(h5py.string_dtype())),
    ),
    Case(
        "NaN in an observed displacement",
        (f"'{ONE}' is not valid", "displacement", "repair or l"),
        h5(f"{ONE}/displacement", nan_where_seen),
    ),
    Case(
        "infinite force",
        (f"'{ONE}' is not valid", "forces holds 81 values"),
        h5(f"{ONE}/forces", lambda x: x + np.inf),
    ),
    Case(
        "metres for millimetres in the mesh",
        ("metres given for millimetres", "by 1000"),
        h5("mesh/points", lambda x: x * 1e-3),
    ),
    Case(
        "metres for millimetres in the displacement",
        ("no displacement exceeds", "metres given for millimetres", "Multiply displacements"),
        lambda path: [h5(f"presses/000{i}/displacement", lambda x: x * 1e-3)(path) for i in (0, 1)],
    ),
    Case(
        "micrometres for millimetres in the displacement",
        ("more than the whole object", "micrometres given for millimetres"),
        h5(f"{ONE}/displacement", lambda x: x * 1e3),
    ),
    Case("inverted element", ("'mesh' is not a valid mesh", "inverted"), h5("mesh/tets", swapped)),
    Case(
        "element of a missing node",
        ("'mesh' is not a valid mesh", "outside 0..26"),
        h5("mesh/tets", lambda x: np.where(x == 26, 27, x)),
    ),
    Case(
        "truth in kPa",
        ("truth: its median is 360 MPa", "kPa given for MPa"),
        h5("truth", lambda x: x * 1e3),
    ),
    Case(
        "no force in a press",
        ("forces are all 0", "leave the press out"),
        h5(f"{ONE}/forces", lambda x: x * 0),
    ),
    Case(
        "Poisson's ratio 0.5 in the file",
        ("poisson is 0.5",),
        attribute("poisson", 0.5, "material"),
    ),
    Case("unknown material", ("rubber", "neo_hookean"), attribute("name", "rubber", "material")),
    Case(
        "start outside the bounds",
        ("start_mpa spans 500 to 500", "[0.001, 100]"),
        settings=("initialization.start_mpa=500",),
    ),
    Case(
        "reversed bounds",
        ("bounds [10", "need 0 < lower < upper"),
        settings=("bounds.lower=10", "bounds.upper=1"),
    ),
    Case("lower bound zero", ("bounds.lower=0", "above 0"), settings=("bounds.lower=0",)),
    Case(
        "noise that is no number",
        ("noise.relative='abc'", "give a number"),
        settings=("noise.relative=abc",),
    ),
    Case("noise of zero", ("noise.relative=0", "above 0, below 1"), settings=("noise.relative=0",)),
    Case("group given one value", ("bounds=3", "give bounds.KEY=VALUE"), settings=("bounds=3",)),
    Case(
        "half an iteration",
        ("max_iterations=2.5", "a whole number"),
        settings=("optimizer.max_iterations=2.5",),
    ),
    Case("no iteration", ("max_iterations=0", "above 0"), settings=("optimizer.max_iterations=0",)),
    Case(
        "negative weight of the prior",
        ("weight=-1", "at least 0"),
        settings=("regularization.weight=-1",),
    ),
    Case(
        "unknown error of the model",
        ("model_error='mesh'", "give auto, none or discretisation"),
        settings=("model_error=mesh",),
    ),
    Case(
        "share of the model's error above one",
        ("residual_model_error_fraction=2", "0 to 1"),
        settings=("model_error=discretisation", "residual_model_error_fraction=2"),
    ),
    Case(
        "unknown misfit",
        ("misfit=l1 is unknown", "adaptive, huber, squares"),
        settings=("misfit=l1",),
    ),
    Case(
        "deviation of zero for an unknown",
        ("nuisance.poisson=0", "above 0, or null"),
        settings=("nuisance.poisson=0",),
    ),
    Case(
        "unknown that is no number",
        ("nuisance.rest_scale='yes'", "give a number above 0, or null"),
        settings=("nuisance.rest_scale=yes",),
    ),
    Case(
        "NaN for a setting",
        ("start_mpa=nan", "a number or homogeneous"),
        settings=("initialization.start_mpa=nan",),
    ),
    Case("no time", ("max_seconds=-1", "above 0"), settings=("max_seconds=-1",)),
    Case(
        "unknown setting",
        ("unknown setting 'optimizer.max_iter'", "'optimizer.max_iterations'?"),
        settings=("optimizer.max_iter=3",),
    ),
    Case(
        "unknown option of a group",
        ("optimizer=adam is unknown", "gauss_newton, lbfgs, newton_cg, tnc"),
        settings=("optimizer=adam",),
    ),
    Case("unknown element", ("hex8", "tet4"), settings=("element=hex8",)),
    Case(
        "run to compare with missing",
        ("compare: reconstruction not found", "'nowhere'"),
        settings=("compare=[nowhere]",),
    ),
    Case(
        "run folder below a file",
        ("run folder cannot be made or written", "choose another run_dir"),
        settings=("run_dir=CASE/run",),
    ),
)
def test_invert_refuses(
    case: Case, tactorch: Any, recording: Path, tmp_path: Path, table: list[tuple[str, str]]
) -> None:
    case.spoil(recording)
    given = [s.replace("CASE", str(recording)) for s in case.settings]
    done = tactorch("invert", f"recording={recording}", "run_dir=run", *given)
    check(case, done, [tmp_path, recording.parent], table)
    left = {p.name for p in Path("run").iterdir()} if Path("run").exists() else set()
    assert left <= {".hydra", "invert.log"}


# ---------------------------------------------------------------- simulations and the rest

TINY = ("mesh=coarse", "mesh.relative_edge_length=0.35", "mesh.fine_relative=null", "press=top")


@cases(
    Case(
        "inclusion outside the phantom",
        ("phantom: inclusions[0]", "mm out of the body", "move or shrink"),
        settings=("phantom.depth=0.05",),
    ),
    Case(
        "load that collapses the object",
        ("z+", "collapses the object", "MPa"),
        settings=("press.p_max_mpa=50", "press.steps=1", "check_units=false"),
    ),
    Case(
        "pressure in kPa",
        ("press.p_max_mpa=20 is", "times Young's modulus", "20 kPa is 0.02", "check_units=false"),
        settings=("press.p_max_mpa=20",),
    ),
    Case(
        "pressures in Pa",
        ("press.p_max_mpa=20000 is", "20000 Pa is 0.02"),
        settings=("press.pressures_mpa=[10000,20000]",),
    ),
    Case(
        "modulus in Pa",
        ("Young's modulus is 2.4e+05 MPa", "Pa or kPa given for MPa?"),
        settings=("phantom.youngs_mpa=200000", "phantom.inclusion_mpa=1000000"),
    ),
    Case(
        "signal-to-noise ratio that is no number",
        ("snr_db='abc'", "a number, or null"),
        settings=("snr_db=abc",),
    ),
    Case(
        "negative number of load steps",
        ("press.steps=-2", "at least 1"),
        settings=("press.steps=-2",),
    ),
    Case("unknown side", ("press.faces=['top']", "z+"), settings=("press.faces=[top]",)),
    Case(
        "one side for a list of sides", ("press.faces='z+'", "[A,B]"), settings=("press.faces=z+",)
    ),
    Case(
        "patch beside the object",
        ("patch", "mm"),
        settings=("press.patch_radius_mm=1", "press.patch_centers_mm=[[50,50,0]]"),
    ),
    Case(
        "unknown way to hold",
        ("press.support='glue'", "springs, fixed or roller"),
        settings=("press.support=glue",),
    ),
    Case(
        "negative modulus",
        ("phantom.inclusion_mpa=-1", "above 0"),
        settings=("phantom.inclusion_mpa=-1",),
    ),
    Case(
        "edge length of a hundredth of a micrometre",
        ("edge length", "check the units"),
        settings=("mesh.edge_length_mm=1e-5",),
    ),
    Case("negative seed", ("seed=-1", "at least 0"), settings=("seed=-1",)),
    Case(
        "unknown parameter of the material",
        ("material.c3", "poisson, second_fraction"),
        settings=("material=mooney_rivlin", "+material.c3=1"),
    ),
)
def test_simulate_refuses(
    case: Case, tactorch: Any, tmp_path: Path, table: list[tuple[str, str]]
) -> None:
    done = tactorch("simulate", *TINY, "run_dir=run", *case.settings)
    check(case, done, [tmp_path], table)
    left = {p.name for p in Path("run").iterdir()} if Path("run").exists() else set()
    assert left <= {".hydra", "simulate.log"}


def of_other_mesh(path: Path) -> None:
    found = Recording.load(path)
    finer = box_mesh(10.0, 3, tets_per_cell=5)
    press = found.presses[0]
    n = finer.n_points
    seen = np.zeros((n, 3), dtype=bool)
    seen[-1] = True
    other = type(press)(
        forces=np.full((n, 3), -0.01), observed=seen, displacement=np.full((n, 3), -0.1),
        springs=np.ones((n, 3)),
    )  # fmt: skip
    Recording(finer, (other,), found.material).save(path)


def of_turned_mesh(path: Path) -> None:
    """Same number of elements, other places."""
    h5("mesh/points", lambda x: x * 1.01)(path)


def checkpoint(change: Callable[[Path], object]) -> Spoil:
    return lambda run: change(run / "checkpoint.npz")


@cases(
    Case(
        "checkpoint cut short", ("checkpoint.npz' cannot be read", "start again"), checkpoint(cut)
    ),
    Case(
        "checkpoint that is text",
        ("checkpoint.npz' cannot be read", "start again"),
        checkpoint(text_file),
    ),
    Case(
        "checkpoint of another parameterization",
        ("another parameterization", "Resume with"),
        settings=("parameterization=identity",),
    ),
    Case(
        "recording of a resumed run has another mesh",
        ("for 40 moduli", "has 135", "another mesh"),
        settings=("recording=OTHER",),
    ),
    Case(
        "recording of a resumed run is another object of as many elements",
        ("another mesh",),
        settings=("recording=TURNED",),
    ),
    Case(
        "settings of the run damaged",
        ("overrides.yaml' is not valid YAML", "repair it"),
        lambda run: (run / ".hydra" / "overrides.yaml").write_text("- ["),
    ),
    Case(
        "resumed folder of another command",
        ("run of simulate", "tactorch simulate"),
        lambda run: [
            p.write_text(p.read_text().replace("name: invert", "name: simulate"))
            for p in [run / ".hydra" / "hydra.yaml"]
        ],
    ),
)
def test_resume_refuses(
    case: Case,
    tactorch: Any,
    finished_run: Path,
    recording_file: Path,
    recording: Path,
    tmp_path: Path,
    table: list[tuple[str, str]],
) -> None:
    run = Path(shutil.copytree(finished_run, tmp_path / "run"))
    case.spoil(run)
    if "recording=OTHER" in case.settings:
        of_other_mesh(recording)
    if "recording=TURNED" in case.settings:
        of_turned_mesh(recording)
    given = [s if s.startswith("param") else f"recording={recording}" for s in case.settings]
    done = tactorch("invert", f"resume={run}", "optimizer.max_iterations=2", *given)
    check(case, done, [tmp_path, recording_file.parent], table)


@cases(
    Case(
        "run to score missing", ("reconstruction not found", "nowhere"), settings=("run=nowhere",)
    ),
    Case("scores without truth", ("contains no truth",), h5("truth", lambda x: None)),
    Case("scores against another mesh", ("different meshes", "that was inverted"), of_turned_mesh),
    Case(
        "recording given as a run",
        ("but not a reconstruction", "tactorch-recording"),
        settings=("run=RECORDING",),
    ),
    Case(
        "reconstruction cut short",
        ("reconstruction.h5' is damaged or cut short", "copy it again"),
        settings=("run=CUT",),
    ),
)
def test_evaluate_refuses(
    case: Case,
    tactorch: Any,
    finished_run: Path,
    recording: Path,
    tmp_path: Path,
    table: list[tuple[str, str]],
) -> None:
    run = Path(shutil.copytree(finished_run, tmp_path / "run"))
    case.spoil(recording)
    cut_run = Path(shutil.copytree(run, tmp_path / "cut"))
    cut(cut_run / "reconstruction.h5")
    places = {"RECORDING": str(recording), "CUT": str(cut_run)}
    given = case.settings[0] if case.settings else f"run={run}"
    for name, place in places.items():
        given = given.replace(name, place)
    done = tactorch("evaluate", given, f"recording={recording}")
    check(case, done, [tmp_path], table)
    assert not list(tmp_path.rglob("scores.json"))


@cases(
    Case(
        "unknown source of a demo",
        ("source='video'", "give simulated or published"),
        settings=("source=video",),
    ),
    Case(
        "demo on a case that is not named", ("needs path=FOLDER",), settings=("source=published",)
    ),
)
def test_demo_refuses(
    case: Case, tactorch: Any, tmp_path: Path, table: list[tuple[str, str]]
) -> None:
    check(case, tactorch("demo", *case.settings), [tmp_path], table)


def test_mesh_files_of_another_kind_are_named(tmp_path: Path) -> None:
    from tactorch.errors import TactorchError

    cube = box_mesh(10.0, 1)
    write_surface(tmp_path / "surface.stl", cube.points, cube.surface.triangles)
    write_mesh(tmp_path / "solid.vtu", cube)
    (tmp_path / "solid.vtu").rename(tmp_path / "solid.inp")
    for name in ("surface.stl", "solid.inp"):
        with pytest.raises(TactorchError, match=name):
            read_mesh(tmp_path / name)


@pytest.mark.parametrize("moment", ["write", "rename"])
def test_killed_while_saving_leaves_the_old_file_whole(
    recording: Path, moment: str, table: list[tuple[str, str]]
) -> None:
    before = recording.read_bytes()
    die = "lambda *_: os.kill(os.getpid(), signal.SIGKILL)"
    where = {"write": "storage.write_press", "rename": "files.os.replace"}[moment]
    code = (
        "import os, signal, sys\n"
        "import tactorch.files as files, tactorch.recording.storage as storage\n"
        "from tactorch.recording import Recording\n"
        "recording = Recording.load(sys.argv[1])\n"
        f"{where} = {die}\n"
        "recording.save(sys.argv[1])\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(recording)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert recording.read_bytes() == before
    Recording.load(recording)
    table.append((f"killed while saving (at the {moment})", "(none: the file of before is whole)"))
