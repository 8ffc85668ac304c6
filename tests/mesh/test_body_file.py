"""Bodies of files: signed distances are those of the shapes that were written."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError
from tactorch.mesh import BodyFile, Box, Hyperboloid, Sphere, box_mesh, write_mesh, write_surface

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "shape",
    [Box((1, 2, 3), (4.0, 6.0, 8.0)), Hyperboloid((0, 0, 0), 2.0, 5.0, 10.0)],
    ids=["box", "hyperboloid"],
)
def test_distances_are_those_of_the_shape(tmp_path: Path, shape: Box | Hyperboloid) -> None:
    write_surface(tmp_path / "a.ply", *shape.surface())
    body = BodyFile(tmp_path / "a.ply")
    low, high = shape.bounds()
    points = RNG.uniform(low - 2.0, high + 2.0, (2000, 3))
    expected = shape.signed_distance(points)
    tolerance = 1e-9 if isinstance(shape, Box) else 0.03  # of the polyhedron
    np.testing.assert_allclose(body.signed_distance(points), expected, atol=tolerance)
    np.testing.assert_allclose(body.bounds(), shape.bounds(), atol=tolerance)


def test_meshes_units_and_changed_files_are_read(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.vtu", box_mesh(0.01, 2))
    body = BodyFile(str(tmp_path / "a.vtu"), "m")
    np.testing.assert_allclose(body.bounds(), [(0, 0, 0), (10, 10, 10)])
    assert body.contains(np.array([(5.0, 5.0, 5.0), (5.0, 5.0, 11.0)])).tolist() == [True, False]
    assert body == BodyFile(str(tmp_path / "a.vtu"), "m")
    write_surface(tmp_path / "b.stl", *Sphere((0, 0, 0), 5.0).surface(12))
    assert BodyFile(tmp_path / "b.stl").bounds()[1, 2] == pytest.approx(5.0)
    write_surface(tmp_path / "b.stl", *Sphere((0, 0, 0), 50.0).surface(12))
    assert BodyFile(tmp_path / "b.stl").bounds()[1, 2] == pytest.approx(50.0, rel=1e-6)


def test_wrong_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"none\.stl"):
        BodyFile(tmp_path / "none.stl").bounds()
    vertices, triangles = Sphere().surface(12)
    write_surface(tmp_path / "open.stl", vertices, triangles[1:])
    with pytest.raises(MeshError, match=r"open\.stl.*open: 3 of"):
        BodyFile(tmp_path / "open.stl").surface()
    with pytest.raises(ConfigError, match="unit='inch'"):
        BodyFile(tmp_path / "open.stl", "inch")
    with pytest.raises(ConfigError, match="path="):
        BodyFile(3)
