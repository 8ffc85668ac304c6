"""fTetWild gives a different mesh each time: nothing here depends on its counts."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, MeshError
from tactorch.files import cache_folder
from tactorch.mesh import (
    FACE_NAMES,
    Box,
    Cylinder,
    TetMesh,
    box_mesh,
    meshing,
    select_face,
    tetrahedralize,
)

VERTICES, TRIANGLES = Box((5, 5, 5), 10.0).surface()
BOX = box_mesh(10.0, 3)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replace fTetWild by a structured mesh, and record the edge length of each run."""
    lengths: list[float] = []

    def run(points, faces, length, epsilon, coarsen):
        lengths.append(length)
        return np.array(BOX.points), np.array(BOX.tets)

    monkeypatch.setattr(meshing, "_run_tetwild", run)
    monkeypatch.setattr(meshing, "fit_edge_length", once)
    return lengths


def once(mesher, vertices, triangles, length_mm, progress):
    """Replace the search for the edge length, which test_edge_length.py tests."""
    return mesher(length_mm, 0.1 * length_mm)


def replace_result(monkeypatch: pytest.MonkeyPatch, points: object, tets: object) -> None:
    result = np.asarray(points, float), np.asarray(tets)
    monkeypatch.setattr(meshing, "_run_tetwild", lambda *_: result)
    monkeypatch.setattr(meshing, "fit_edge_length", once)


@pytest.mark.slow
def test_box_for_real(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mesh = tetrahedralize(VERTICES, TRIANGLES[:, ::-1], relative_edge_length=0.2)
    assert mesh.volumes.sum() == pytest.approx(1000.0, rel=1e-2)
    lengths = np.linalg.norm(np.diff(mesh.points[mesh.edges], axis=1)[:, 0], axis=1)
    assert 0.3 < lengths.mean() / (0.2 * mesh.diagonal) < 1.1
    for name in FACE_NAMES:
        assert mesh.surface.areas[select_face(mesh, name)].sum() == pytest.approx(100, rel=2e-2)
    assert os.listdir(tmp_path) == ["cache"], "fTetWild's own files must not be left behind"
    again = tetrahedralize(VERTICES, TRIANGLES[:, ::-1], relative_edge_length=0.2)
    assert again.content_hash() == mesh.content_hash()


@pytest.mark.slow
def test_cylinder_for_real(cache: Path) -> None:
    vertices, triangles = Cylinder((0, 0, 0), 5, 8).surface(12)
    unused = np.vstack(([(99, 99, 99)], vertices))
    mesh = tetrahedralize(unused, triangles + 1, edge_length_mm=4, cache=False)
    prism = 6 * 25 * np.sin(np.pi / 6) * 8
    assert mesh.volumes.sum() == pytest.approx(prism, rel=2e-2)
    assert not cache.exists()


def test_default_edge_length_is_a_tenth_of_the_diagonal(cache: Path, runs: list[float]) -> None:
    tetrahedralize(VERTICES, TRIANGLES)
    tetrahedralize(VERTICES, TRIANGLES, edge_length_mm=3)
    # A vertex that no triangle uses is no part of the object.
    tetrahedralize(np.vstack((VERTICES, (99, 99, 99))), TRIANGLES, relative_edge_length=0.05)
    np.testing.assert_allclose(runs, [np.sqrt(3.0), 3.0, np.sqrt(3.0) / 2])


def test_cache_answers_equal_inputs_only(cache: Path, runs: list[float]) -> None:
    first = tetrahedralize(VERTICES, TRIANGLES)
    same = tetrahedralize(VERTICES.tolist(), TRIANGLES.astype(np.int32), runs[0])
    assert len(runs) == 1
    assert same.content_hash() == first.content_hash()
    tetrahedralize(VERTICES, TRIANGLES, epsilon=2e-3)
    tetrahedralize(VERTICES, TRIANGLES, 2.0)
    tetrahedralize(VERTICES + 1e-9, TRIANGLES)
    tetrahedralize(VERTICES, TRIANGLES[::-1])
    assert len(runs) == 5
    tetrahedralize(VERTICES, TRIANGLES, cache=False)
    assert len(runs) == 6
    assert len(list((cache / "meshes").iterdir())) == 5


def damage_truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:200])


def damage_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)


def damage_content(path: Path) -> None:
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays["points"] = arrays["points"] * 2
    np.savez(path, **arrays)


def damage_mesh(path: Path) -> None:
    np.savez(path, points=np.zeros((4, 3)), tets=np.array([[0, 1, 2, 3]]), content_hash="x")


def damage_missing(path: Path) -> None:
    np.savez(path, points=BOX.points)


def damage_empty(path: Path) -> None:
    path.write_bytes(b"")


def damage_text(path: Path) -> None:
    path.write_text("not a mesh")


@pytest.mark.parametrize(
    "damage",
    [
        damage_truncate,
        damage_byte,
        damage_content,
        damage_mesh,
        damage_missing,
        damage_empty,
        damage_text,
    ],
)
def test_damaged_cache_is_rebuilt(
    cache: Path, runs: list[float], caplog: pytest.LogCaptureFixture, damage
) -> None:
    expected = tetrahedralize(VERTICES, TRIANGLES).content_hash()
    (stored,) = (cache / "meshes").iterdir()
    damage(stored)
    with caplog.at_level(logging.WARNING):
        assert tetrahedralize(VERTICES, TRIANGLES).content_hash() == expected
    assert str(stored) in caplog.text
    assert tetrahedralize(VERTICES, TRIANGLES).content_hash() == expected
    assert len(runs) == 2


def test_unwritable_cache_is_not_fatal(
    cache: Path, runs: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    cache.write_text("a file where the folder should be")
    assert tetrahedralize(VERTICES, TRIANGLES).n_tets == BOX.n_tets
    assert "could not be cached" in caplog.text


def test_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("TACTORCH_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "tactorch"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "tactorch"
    monkeypatch.setenv("TACTORCH_CACHE", "~/elsewhere")
    assert cache_folder() == Path.home() / "elsewhere"


def test_stray_points_and_orientation_are_put_right(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.vstack(([(0, 0, 0)], BOX.points, [(1, 1, 1)]))
    replace_result(monkeypatch, points, BOX.tets[:, [1, 0, 2, 3]].astype(np.int32) + 1)
    mesh = tetrahedralize(VERTICES, TRIANGLES, cache=False)
    np.testing.assert_array_equal(mesh.points, BOX.points)
    assert mesh.volumes.min() > 0


def test_slivers_are_refused(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    # A flat element glued onto a side, over two triangles of one plane.
    first, second = BOX.surface.triangles[select_face(BOX, "z+")[:2]]
    sliver = np.union1d(first, second)
    assert len(sliver) == 4
    replace_result(monkeypatch, BOX.points, np.vstack((BOX.tets, sliver)))
    with pytest.raises(MeshError, match=r"fTetWild is invalid.*degenerate.*\(162\)"):
        tetrahedralize(VERTICES, TRIANGLES)
    assert not cache.exists()


def test_lost_parts_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_result(monkeypatch, BOX.points * (1, 1, 0.9), BOX.tets)
    with pytest.raises(MeshError, match=r"fills 900 mm\^3 where the surface encloses 1000 mm\^3"):
        tetrahedralize(VERTICES, TRIANGLES, epsilon=1e-3, cache=False)
    replace_result(monkeypatch, np.empty((0, 3)), np.empty((0, 4), int))
    with pytest.raises(MeshError, match="returned no elements"):
        tetrahedralize(VERTICES, TRIANGLES, cache=False)


def test_two_solids_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    both = np.vstack((BOX.points, BOX.points + 20.0))
    replace_result(monkeypatch, both, np.vstack((BOX.tets, BOX.tets + BOX.n_points)))
    surface = np.vstack((VERTICES, VERTICES + 20.0)), np.vstack((TRIANGLES, TRIANGLES + 8))
    with pytest.raises(MeshError, match="2 disconnected parts"):
        tetrahedralize(*surface, cache=False)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"edge_length_mm": 0.0}, "edge_length_mm=0.0"),
        ({"edge_length_mm": float("nan")}, "edge_length_mm=nan"),
        ({"edge_length_mm": 18.0}, r"18 mm exceeds the object's diagonal 17\.32 mm"),
        ({"edge_length_mm": 1e-3}, r"would take about 8\.5e\+12 elements"),
        ({"relative_edge_length": -0.1}, "relative_edge_length=-0.1"),
        ({"epsilon": 0}, "epsilon=0"),
    ],
)
def test_unusable_settings(runs: list[float], settings: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        tetrahedralize(VERTICES, TRIANGLES, cache=False, **settings)
    assert not runs


def test_a_crash_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    worker = tmp_path / "worker.py"
    worker.write_text("import sys\nsys.exit('segments intersect')\n")
    monkeypatch.setattr(meshing, "_WORKER", worker)
    with pytest.raises(MeshError, match=r"12 triangles \(exit status 1\): segments intersect"):
        tetrahedralize(VERTICES, TRIANGLES, cache=False)


def test_missing_pytetwild_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshing.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="pip install pytetwild"):
        tetrahedralize(VERTICES, TRIANGLES, cache=False)


def test_heavy_packages_are_imported_late() -> None:
    heavy = "{'pytetwild', 'meshio', 'pyvista', 'vtk', 'matplotlib', 'torch'}"
    code = f"import sys, tactorch.mesh; sys.exit(str(sorted({heavy} & set(sys.modules))))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "[]"


def test_the_mesh_stays_a_tetmesh(cache: Path, runs: list[float]) -> None:
    assert isinstance(tetrahedralize(VERTICES, TRIANGLES), TetMesh)
