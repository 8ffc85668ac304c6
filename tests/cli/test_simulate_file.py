"""`tactorch simulate phantom=mesh`: a body of a file, pressed at points of its surface."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.mesh import Box, TetMesh, write_mesh, write_surface
from tactorch.recording import Recording

BALL = "phantom.inclusions=[{shape: sphere, center_mm: [5,5,6], radius_mm: 2, youngs_mpa: 1}]"


@pytest.fixture
def fake_meshing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a structured mesh in place of fTetWild's, which takes seconds."""
    from tactorch.mesh import box_mesh, meshing

    def meshed(vertices: np.ndarray, triangles: np.ndarray, length: float, **_: Any) -> TetMesh:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return box_mesh(high - low, round(12.0 / length), origin_mm=low)

    monkeypatch.setattr(meshing, "tetrahedralize", meshed)


def cube(path: Path) -> None:
    write_surface(path, *Box((5, 5, 5), 10.0).surface())


@pytest.mark.usefixtures("fake_meshing")
def test_a_body_of_a_file_is_simulated(tactorch: Any) -> None:
    cube(Path("cube.stl"))
    done = tactorch(
        "simulate", "phantom=mesh", "phantom.file=cube.stl", BALL, "out=a.h5",
        "press.points_mm=[[5,5,10],[10,5,6]]", "press.patch_radius_mm=2.5", "press.steps=1",
        "press.support=fixed", "mesh=same", "mesh.edge_length_mm=3",
    )  # fmt: skip
    assert done.status == 0, done.err
    recording = Recording.load("a.h5")
    directions = [press.direction for press in recording.presses]
    np.testing.assert_allclose(directions, [(0, 0, -1), (-1, 0, 0)], atol=1e-9)
    assert recording.truth is not None
    assert recording.truth.max() > 0.5
    assert recording.presses[1].fixed[:, 0].sum() == 25


@pytest.mark.usefixtures("fake_meshing")
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((), "phantom.file is required"),
        (("phantom.file=none.stl",), "none.stl"),
        (("phantom.file=open.stl",), "3 of its 18 edges"),
        (("phantom.file=cube.stl", "phantom.unit=inch"), "phantom.unit"),
        (("phantom.file=cube.stl", BALL.replace("[5,5,6]", "[5,5,9]")), "protrudes"),
        (("phantom.file=cube.stl", BALL.replace("sphere", "heart")), "'heart'"),
        (("phantom.file=cube.stl", BALL.replace(", youngs_mpa: 1", "")), "youngs_mpa is missing"),
        (("phantom.file=cube.stl", "press.points_mm=[[5,5,10]]"), "patch_radius_mm"),
        (
            ("phantom.file=cube.stl", "press.points_mm=[[5,5,30]]", "press.patch_radius_mm=2"),
            "20 mm from the surface",
        ),
        (("phantom.file=tets.vtu", "phantom.unit=m", BALL), "protrudes"),
    ],
)
def test_wrong_bodies_get_one_message(tactorch: Any, settings: tuple, words: str) -> None:
    cube(Path("cube.stl"))
    vertices, triangles = Box((5, 5, 5), 10.0).surface()
    write_surface("open.stl", vertices, triangles[1:])
    from tactorch.mesh import box_mesh

    write_mesh("tets.vtu", box_mesh(0.001, 2))
    done = tactorch("simulate", "phantom=mesh", "mesh=same", "out=a.h5", *settings)
    assert done.status == 2, done.out
    assert words in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert not Path("a.h5").exists()
