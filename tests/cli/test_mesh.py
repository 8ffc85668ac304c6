"""`tactorch mesh`: a mesh of a surface, and one message for each wrong file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import Box, Sphere, read_mesh, write_surface

VERTICES, TRIANGLES = Box((0.0, 0.0, 0.0), 20.0).surface()
SETTINGS = ("edge_length_mm=6", "out=body.vtu")


def cube(path: Path, keep: slice = slice(None), scale: float = 1.0) -> None:
    write_surface(path, scale * VERTICES, TRIANGLES[keep])


def ply(path: Path, change: Any = lambda text: text) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty double x\nproperty double y\n"
    head += "property double z\nelement face 12\nproperty list uchar int vertex_index\nend_header\n"
    rows = [" ".join(map(str, row)) for row in VERTICES]
    rows += [f"3 {' '.join(map(str, row))}" for row in TRIANGLES]
    path.write_text(change(head + "\n".join(rows) + "\n"))


def two(path: Path, shift: float) -> None:
    write_surface(
        path, np.vstack((VERTICES, VERTICES + shift)), np.vstack((TRIANGLES, TRIANGLES + 8))
    )


def spike(path: Path) -> None:
    vertices, triangles = Sphere((0, 0, 0), 10.0).surface(24)
    vertices[vertices[:, 2] > 9.9, 2] = -18.0
    write_surface(path, vertices, triangles)


WRONG = {
    "no file": ("no.stl", lambda path: None, (), ("no.stl", "not")),
    "a folder": ("folder.stl", lambda path: path.mkdir(), (), ("folder.stl",)),
    "empty file": ("a.stl", lambda path: path.write_bytes(b""), (), ("a.stl", "stl")),
    "cut short": (
        "a.stl", lambda path: (cube(path), path.write_bytes(path.read_bytes()[:300])), (),
        ("a.stl", "complete"),
    ),
    "another format": ("a.stl", lambda path: path.write_text("3 4 5"), (), ("a.stl", "stl")),
    "unknown suffix": ("a.step", lambda path: path.write_text("x"), (), (".step", ".stl, .obj")),
    "open": ("a.stl", lambda path: cube(path, slice(1, None)), (), ("a.stl", "3 of its 18 edges")),
    "NaN": (
        "a.ply", lambda path: ply(path, lambda text: text.replace("-10.0 -10.0", "nan 0", 1)), (),
        ("a.ply", "NaN"),
    ),
    "not consistent": (
        "a.ply", lambda path: ply(path, lambda text: text.replace("3 0 1 3", "3 1 0 3")), (),
        ("a.ply", "oriented consistently"),
    ),
    "two bodies": ("a.obj", lambda path: two(path, 40.0), (), ("a.obj", "largest=true")),
    "crosses itself": ("a.stl", spike, (), ("a.stl", "intersects itself", "triangles")),
    "metres": ("a.obj", lambda path: cube(path, scale=1e-3), (), ("0.0346 mm", "unit=mm")),
    "micrometres": ("a.obj", lambda path: cube(path, scale=1e3), (), ("3.46e+04 mm", "unit")),
    "edge too long": ("a.stl", cube, ("edge_length_mm=21",), ("21", "20 x 20 x 20 mm")),
    "edge too short": ("a.stl", cube, ("edge_length_mm=0.1",), ("6.8e+07", "max_elements")),
    "negative edge": ("a.stl", cube, ("edge_length_mm=-1",), ("edge_length_mm", "-1")),
    "unknown unit": ("a.stl", cube, ("unit=inch",), ("unit", "mm", "inch")),
    "unknown output": ("a.stl", cube, ("out=body.stl",), ("body.stl", ".msh, .vtu, .inp")),
}  # fmt: skip


@pytest.mark.parametrize("given", WRONG)
def test_wrong_input_gets_one_message(tactorch: Any, given: str) -> None:
    name, make, changes, words = WRONG[given]
    make(Path(name))
    keys = [change.partition("=")[0] for change in changes]
    kept = [setting for setting in SETTINGS if setting.partition("=")[0] not in keys]
    done = tactorch("mesh", name, *kept, *changes)
    assert done.status == 2, done.out
    assert len(done.err.strip().splitlines()) == 1
    for word in words:
        assert word in done.err
    assert not list(Path().glob("*body*"))


def test_a_surface_is_meshed(
    tactorch: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path / "cache"))
    cube(Path("cube.stl"), scale=1e-3)
    done = tactorch("mesh", "cube.stl", "unit=m", "edge_length_mm=9", "out=body.vtu")
    assert done.status == 0, done.err
    assert "meshing: 1 of" in done.out
    assert "target 9" in done.out
    mesh = read_mesh("body.vtu")
    assert mesh.volumes.sum() == pytest.approx(8000.0, rel=1e-4)
    assert np.median(mesh.edge_lengths) == pytest.approx(9.0, rel=0.35)  # fTetWild is random
    before = Path("body.vtu").read_bytes()
    tactorch("mesh", "cube.stl", "unit=m", "edge_length_mm=9", "out=body.vtu")
    assert Path("body.vtu").read_bytes() == before


def test_the_largest_part_is_kept_on_demand(tactorch: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from tactorch.cli import mesh as command
    from tactorch.mesh import box_mesh

    taken = []

    def meshed(points, faces, length, **_):
        taken.append(points)
        return box_mesh(20.0, 3, center_mm=(0, 0, 0))

    monkeypatch.setattr(command, "tetrahedralize", meshed)
    small = np.vstack((VERTICES, 0.1 * VERTICES + 30.0))
    write_surface("two.ply", small, np.vstack((TRIANGLES, TRIANGLES + 8)))
    done = tactorch("mesh", "two.ply", "edge_length_mm=6", "out=new/body.msh", "largest=true")
    assert done.status == 0, done.err
    assert len(taken[0]) == 8
    assert read_mesh("new/body.msh").n_points == 64
