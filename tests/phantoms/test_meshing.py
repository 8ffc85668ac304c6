import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import (
    Box,
    Cylinder,
    Sphere,
    TetMesh,
    box_mesh,
    face_nodes,
    meshing,
    select_face,
)
from tactorch.phantoms import Phantom, make_phantom


def mean_edge(mesh: TetMesh) -> float:
    ends = mesh.points[mesh.edges]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())


@pytest.mark.parametrize("size", [(10.0, 10.0, 10.0), (10.0, 20.0, 5.0)])
@pytest.mark.parametrize("length", [1.0, 1.7, 3.0])
def test_structured_mesh_keeps_below_the_edge_length(
    size: tuple[float, float, float], length: float
) -> None:
    phantom = Phantom(Box((1.0, 2.0, 3.0), size))
    mesh = phantom.mesh(length)
    assert 0.7 * length < mean_edge(mesh) <= length
    np.testing.assert_allclose(mesh.bounds, phantom.body.bounds(), atol=1e-12)


def test_default_is_a_tenth_of_the_diagonal() -> None:
    phantom = Phantom(Box(size_mm=(10.0, 10.0, 10.0)))
    target = 0.1 * np.sqrt(300.0)
    assert 0.8 * target < mean_edge(phantom.mesh()) <= target
    assert mean_edge(phantom.mesh(relative_edge_length=0.2)) > target


@pytest.mark.slow
def test_cylinder_is_meshed_by_tetwild() -> None:
    phantom = Phantom(Cylinder((0.0, 0.0, 5.0), 5.0, 10.0))
    mesh = phantom.mesh(3.0)
    assert mesh.volumes.sum() == pytest.approx(np.pi * 250.0, rel=0.02)
    assert phantom.on_mesh(mesh).shape == (mesh.n_tets,)


@pytest.mark.parametrize(
    ("name", "volume", "flat"),
    [
        ("hemisphere_two_spheres", 2 / 3 * np.pi * 1000, ("z-",)),
        pytest.param(
            "hyperboloid_sphere",
            np.pi * 10 * (12.25 + (25 - 12.25) / 3),
            ("z-", "z+"),
            marks=pytest.mark.slow,
        ),
        pytest.param("toy_two_spheres", None, ("z-",), marks=pytest.mark.slow),
    ],
)
def test_curved_bodies_are_meshed_with_their_flat_sides(
    name: str, volume: float | None, flat: tuple[str, ...]
) -> None:
    phantom = make_phantom(name)
    mesh = phantom.mesh(relative_edge_length=0.12)
    if volume is not None:
        assert mesh.volumes.sum() == pytest.approx(volume, rel=0.02)
    for side in flat:
        assert len(select_face(mesh, side))
    found = phantom.on_mesh(mesh)
    assert found.min() < 0.5 * found.max()


@pytest.mark.slow
def test_conforming_mesh_follows_the_inclusion() -> None:
    """The inclusion's nodes lie on its surface, and its elements fill its volume."""
    ball = Sphere((5.0, 5.0, 5.0), 2.5)
    phantom = Phantom(Box((5.0, 5.0, 5.0), (10.0, 10.0, 10.0)), [(ball, 1.0)])
    exact = 4 / 3 * np.pi * 2.5**3
    off = {}
    for conforming in (False, True):
        mesh = phantom.mesh(2.0, generator="tetwild", conforming=conforming)
        inside = phantom.on_mesh(mesh) == 1.0
        outer = np.setdiff1d(mesh.tets[inside], []).astype(int)
        rim = np.intersect1d(outer, mesh.tets[~inside])
        off[conforming] = np.abs(ball.signed_distance(mesh.points[rim])).max()
        volume = mesh.volumes[inside].sum()
        assert len(face_nodes(mesh, "z+"))
    assert off[True] < 0.05 < off[False]
    assert volume == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize(
    ("body", "settings", "message"),
    [
        (Box(), {"generator": "gmsh"}, "generator='gmsh'"),
        (Cylinder(), {"generator": "structured"}, "not a Cylinder"),
        (Box(), {"generator": "structured", "conforming": True}, "cannot follow"),
        (Box(), {"edge_length_mm": 0.0}, "edge_length_mm"),
        (Box(), {"edge_length_mm": 1e-3}, "cells"),
        (Box(), {"relative_edge_length": -0.1}, "relative_edge_length"),
    ],
)
def test_wrong_settings_are_refused(body: Box | Cylinder, settings: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Phantom(body, [(Sphere(radius_mm=0.1), 1.0)]).mesh(**settings)


@pytest.mark.slow
def test_faces_of_a_box_are_plane() -> None:
    ball = Sphere((5.0, 5.0, 6.0), 2.0)
    mesh = Phantom(Box((5.0,) * 3, (10.0, 10.0, 10.0)), [(ball, 1.0)]).mesh(3.0, conforming=True)
    assert mesh.volumes.sum() == pytest.approx(1000.0, abs=1e-9)
    nodes = np.unique(mesh.surface.triangles)
    planes = np.minimum(np.abs(mesh.points[nodes]), np.abs(mesh.points[nodes] - 10.0))
    assert planes.min(axis=1).max() == 0.0
    areas = [mesh.surface.areas[mesh.surface.normals[:, a] > 0.99].sum() for a in range(3)]
    np.testing.assert_allclose(areas, 100.0, rtol=1e-12)


def test_a_mesh_remains_where_elements_would_be_inverted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshing, "_EPSILON", 0.2)
    mesh = box_mesh(1.0, 4)
    assert meshing._with_plane_faces(mesh, Box((0.5,) * 3, (1.0,) * 3)) is mesh
