"""The importer on a tiny case in the published format, written here: one cube of six elements."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError, RecordingError, TactorchError
from tactorch.importers import import_published
from tactorch.mesh import box_mesh

N = 8
GMSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
{n_nodes}
{nodes}
$EndNodes
$Elements
{n_tets}
{tets}
$EndElements
"""


def lines(values: np.ndarray) -> str:
    return "".join(f"{value!r}\n" for value in np.asarray(values, dtype=float).ravel().tolist())


def diagonal(indices: list[int], value: float) -> str:
    return "".join(f"{i} {i} {value}\n" for i in indices)


def dofs(nodes: np.ndarray) -> list[int]:
    return [3 * int(node) + axis for node in nodes for axis in range(3)]


def write_press(folder: Path, number: int, force: float, points_m: np.ndarray) -> None:
    """Press the top down with `force` N in all, moving it by 0.1 mm per newton."""
    top = points_m[:, 2] > 0.005
    forces = np.zeros((N, 3))
    forces[top, 2] = -force / top.sum()
    deformed = np.where(top[:, None], points_m - (0, 0, 1e-4 * force), points_m)
    (folder / f"force{number}.txt").write_text(lines(forces))
    (folder / f"pnt{number}.txt").write_text(lines(deformed))
    (folder / f"A-{number}.txt").write_text(diagonal(dofs(np.flatnonzero(~top)), 1000.0))
    (folder / f"B-{number}.txt").write_text(diagonal(dofs(np.flatnonzero(top)), 1.0))


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A cube of 10 mm, off the micrometre grid by 0.3 um, pressed with 2, 1 and 3 N."""
    mesh = box_mesh((10.0, 10.0, 10.0), 1)
    points_m = mesh.points / 1000
    nodes = [f"{i + 1} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate((points_m + 3e-7).tolist())]
    tets = [
        f"{i + 1} 4 2 1 1 " + " ".join(str(node + 1) for node in tet)
        for i, tet in enumerate(mesh.tets.tolist())
    ]
    folder = tmp_path / "cube"
    (folder / "presses").mkdir(parents=True)
    (folder / "mesh.msh").write_text(
        GMSH.format(n_nodes=N, nodes="\n".join(nodes), n_tets=len(tets), tets="\n".join(tets))
    )
    for number, force in ((1, 2.0), (2, 1.0), (10, 3.0)):
        write_press(folder / "presses", number, force, points_m)
    (folder / "youngs_true.txt").write_text(lines(np.array([1e5] * 4 + [3e6] * 2)))
    (folder / "youngs_reference_result.txt").write_text(lines(np.full(6, 2e5)))
    return folder


def test_reads_in_mm_newton_and_mpa(case: Path) -> None:
    recording = import_published(case)
    np.testing.assert_array_equal(recording.mesh.bounds, [[0, 0, 0], [10, 10, 10]])
    np.testing.assert_allclose(recording.truth, [0.1] * 4 + [3.0] * 2)
    np.testing.assert_allclose(recording.reference, 0.2)
    assert recording.material.poisson == 0.49
    assert recording.material.parameters == {"lame_factor": 0.5}
    press = recording.presses[0]
    top = recording.mesh.points[:, 2] == 10
    np.testing.assert_allclose(press.total_force, [0, 0, -2])
    np.testing.assert_array_equal(press.observed, np.repeat(top[:, None], 3, axis=1))
    np.testing.assert_allclose(press.displacement[top], [[0, 0, -0.2]] * 4, atol=1e-12)
    np.testing.assert_array_equal(press.springs, np.where(top[:, None], 0.0, 1.0) * np.ones(3))
    np.testing.assert_array_equal(press.direction, [0, 0, -1])
    assert not press.fixed.any()
    assert press.noise_mm is None


def test_presses_come_by_number_and_steps_by_force(case: Path) -> None:
    presses = import_published(case).presses
    assert [press.name for press in presses] == ["1", "2", "10"]
    assert [press.step for press in presses] == [1, 0, 2]


def test_other_supports_start_steps_anew(case: Path) -> None:
    springs = case / "presses" / "A-1.txt"
    springs.write_text(springs.read_text().replace("1000.0", "900.0"))
    assert [press.step for press in import_published(case).presses] == [0, 0, 1]


def test_rounding_is_an_option(case: Path) -> None:
    rest = import_published(case, round_rest_m=None)
    np.testing.assert_allclose(rest.mesh.points[0], [3e-4] * 3)
    seen = rest.presses[0].displacement[rest.presses[0].observed].reshape(-1, 3)
    np.testing.assert_allclose(seen, [[-3e-4, -3e-4, -0.2003]] * 4)
    with pytest.raises(ConfigError, match=r"round_rest_m=0\.0: give a number above 0, or null"):
        import_published(case, round_rest_m=0.0)


def test_material_and_noise_are_options(case: Path) -> None:
    recording = import_published(case, poisson=0.48, lame_factor=1.0, noise_mm=0.01)
    assert recording.material.poisson == 0.48
    assert recording.material.parameters == {"lame_factor": 1.0}
    assert recording.presses[2].noise_mm == 0.01


def test_truth_and_reference_may_be_absent(case: Path) -> None:
    (case / "youngs_true.txt").unlink()
    (case / "youngs_reference_result.txt").unlink()
    recording = import_published(case)
    assert recording.truth is None
    assert recording.reference is None
    with pytest.raises(FileError, match=r"relabel_truth is given, but '.*youngs_true\.txt'"):
        import_published(case, relabel_truth={3.0: 1.5})


def test_relabels_truth(case: Path) -> None:
    truth = import_published(case, relabel_truth={3.0001: 1.5}).truth
    np.testing.assert_allclose(truth, [0.1] * 4 + [1.5] * 2)
    with pytest.raises(RecordingError, match=r"no element of .* has 2 MPa; .* 0\.1, 3 MPa"):
        import_published(case, relabel_truth={2.0: 1.5})


def test_relabelling_exchanges(case: Path) -> None:
    truth = import_published(case, relabel_truth={3.0: 0.1, 0.1: 3.0}).truth
    np.testing.assert_allclose(truth, [3.0] * 4 + [0.1] * 2)


def test_provenance_names_the_case_but_no_folder(case: Path, tmp_path: Path) -> None:
    recording = import_published(case, relabel_truth={3.0: 1.5})
    assert recording.provenance == {
        "importer": "published",
        "inverse_crime": True,
        "case": "cube",
        "presses": [1, 2, 10],
        "round_rest_m": 1e-6,
        "relabel_truth": [[3.0, 1.5]],
    }
    recording.save(tmp_path / "cube.h5")
    assert type(recording).load(tmp_path / "cube.h5").provenance == recording.provenance


def test_press_from_two_sides_has_no_direction(case: Path) -> None:
    forces = np.zeros((N, 3))
    forces[-1, 2], forces[-2, 2] = 1.0, -1.0
    (case / "presses" / "force1.txt").write_text(lines(forces))
    assert import_published(case).presses[0].direction is None


def edit(name: str, old: str, new: str) -> Callable[[Path], object]:
    def change(case: Path) -> None:
        text = (case / name).read_text()
        assert old in text
        (case / name).write_text(text.replace(old, new, 1))

    return change


def append(name: str, text: str) -> Callable[[Path], object]:
    return lambda case: (case / name).write_text((case / name).read_text() + text)


def remove(name: str) -> Callable[[Path], object]:
    return lambda case: (case / name).unlink()


FORCE, PNT, A, B = (f"presses/{part}1.txt" for part in ("force", "pnt", "A-", "B-"))


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        (remove("mesh.msh"), FileError, r"mesh of the published case not found: '.*mesh\.msh'"),
        (edit("mesh.msh", "$Nodes", "$Nods"), FileError, r"mesh\.msh' "),
        (edit("mesh.msh", "\n1 4 2 1 1 1 ", "\n1 4 2 1 1 2 "), MeshError, r"mesh\.msh'"),
        (remove(PNT), FileError, r"press 1 lacks '.*pnt1\.txt' \(deformed positions\)"),
        (remove(FORCE), FileError, r"press 1 lacks '.*force1\.txt'"),
        (remove(A), FileError, r"press 1 lacks '.*A-1\.txt' \(springs\)"),
        (remove(B), FileError, r"press 1 lacks '.*B-1\.txt'"),
        (append(FORCE, "0.5\n"), FileError, r"force1\.txt' holds 25 numbers; nodal .* needs 24"),
        (edit(PNT, "0.0\n", ""), FileError, r"pnt1\.txt' holds 23 numbers; .* 8 nodes"),
        (edit(PNT, "0.01\n", "nan\n"), FileError, r"pnt1\.txt' line 8 has 'nan'"),
        (edit(FORCE, "-0.5\n", "inf\n"), FileError, r"force1\.txt' line 6 has 'inf'"),
        (edit(FORCE, "-0.5\n", "1,5\n"), FileError, r"force1\.txt' line 6 has '1,5'"),
        (edit(A, "1 1 ", "1 2 "), FileError, r"A-1\.txt' line 2 is off the diagonal \(1, 2\)"),
        (append(A, "24 24 1\n"), FileError, r"A-1\.txt' line 13 names .* 24 24, .* \(0 to 23"),
        (append(A, "-1 -1 1\n"), FileError, r"A-1\.txt' line 13 names degree of freedom -1"),
        (append(A, "3.5 3.5 1\n"), FileError, r"A-1\.txt' line 13 names degree of freedom 3\.5"),
        (append(A, "0 0 5\n"), FileError, r"A-1\.txt' line 13 repeats .* 0 of line 1"),
        (append(A, "3 3\n"), FileError, r"A-1\.txt' line 13 is '3 3'; 'row col value'"),
        (edit(A, "0 0 1000", "0 0 -1000"), FileError, r"A-1\.txt' line 1 has the negative value"),
        (edit(A, "0 0 1000.0", "0 0 nan"), FileError, r"A-1\.txt' line 1 has 'nan'"),
        (edit(B, " 1.0", " 2.0"), FileError, r"B-1\.txt' has the value 2"),
        (lambda case: (case / B).write_text(""), RecordingError, "press '1': observed is empty"),
        (lambda case: (case / A).write_text(""), RecordingError, "press '1': nothing holds"),
        (
            lambda case: (case / FORCE).write_text("0\n" * 24),
            RecordingError,
            "press '1': forces are all 0",
        ),
        (append("youngs_true.txt", "5\n"), FileError, r"youngs_true\.txt' holds 7 .* needs 6"),
        (edit("youngs_true.txt", "100000.0", "0.0"), RecordingError, "truth is 0 MPa at element 0"),
        (
            append("youngs_reference_result.txt", "x\n"),
            FileError,
            r"youngs_reference_result\.txt' line 7 has 'x'",
        ),
        (
            lambda case: (case / FORCE).write_bytes(b"\xff\xfe\x00"),
            FileError,
            r"force1\.txt' is not a text file",
        ),
        (
            lambda case: (case / "presses/force01.txt").write_text(""),
            FileError,
            "have the same press number",
        ),
    ],
)
def test_refuses_by_file_and_line(
    case: Path, change: Callable[[Path], object], error: type[TactorchError], says: str
) -> None:
    change(case)
    with pytest.raises(error, match=says):
        import_published(case)


def test_refuses_empty_and_missing_folders(case: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="published case not found"):
        import_published(tmp_path / "other")
    for path in (case / "presses").iterdir():
        path.unlink()
    with pytest.raises(FileError, match="holds no press"):
        import_published(case)
    (case / "presses").rmdir()
    with pytest.raises(FileError, match="presses of the published case not found"):
        import_published(case)


def test_another_unit_is_noticed(case: Path) -> None:
    text = (case / "mesh.msh").read_text()
    (case / "mesh.msh").write_text(text.replace("0.0100003", "1.0"))
    with pytest.raises(FileError, match=r"pnt1\.txt' holds deformed positions 0\.0\d* m across"):
        import_published(case)
    (case / "mesh.msh").write_text(text.replace("0.0100003", "10.0"))
    with pytest.raises(FileError, match=r"mesh\.msh' is 17\.3 m across"):
        import_published(case)


def test_moduli_in_another_unit_are_noticed(case: Path) -> None:
    (case / "youngs_true.txt").write_text("0.2\n" * 6)
    with pytest.raises(FileError, match=r"youngs_true\.txt' has a median of 0\.2 Pa.*from MPa"):
        import_published(case)


def test_unit_check_is_an_option(case: Path) -> None:
    (case / "youngs_true.txt").write_text("1e9\n" * 6)
    with pytest.raises(RecordingError, match=r"truth: its median is 1e\+03 MPa"):
        import_published(case)
    assert import_published(case, check_units=False).truth is not None
