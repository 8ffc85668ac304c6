"""Presses at points of a surface of any shape."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, MeshError
from tactorch.fem import ELEMENTS, Discretisation
from tactorch.mesh import TetMesh, box_mesh, write_surface
from tactorch.phantoms import Phantom, make_phantom
from tactorch.simulation import PressPlan, simulate
from tactorch.simulation.curved import curved_forces, nodes_under
from tactorch.simulation.patch import patch_forces
from tactorch.simulation.plan import PressSite

BOX = box_mesh((10.0, 10.0, 4.0), (10, 10, 4))


def dome(divisions: int = 8) -> TetMesh:
    """Block whose top is a part of a sphere of radius 12 mm around (5, 5, -7)."""
    mesh = box_mesh(10.0, divisions)
    x, y, z = mesh.points.T
    height = np.sqrt(144.0 - (x - 5.0) ** 2 - (y - 5.0) ** 2) - 7.0
    return TetMesh.create(np.column_stack((x, y, z / 10.0 * height)), mesh.tets)


def plan(*points: tuple[float, float, float], **others: object) -> PressPlan:
    return PressPlan(
        points_mm=points, patch_radius_mm=2.0, pressures_mpa=(0.01,), support="fixed", **others
    )


def test_on_a_plane_it_is_the_patch_of_a_face() -> None:
    discretisation = Discretisation(BOX, ELEMENTS["tet10"])
    (site,) = plan((5.2, 4.7, 4.1)).sites_on(BOX)
    np.testing.assert_allclose(site.direction, [0.0, 0.0, -1.0])
    forces = curved_forces(discretisation, site, 2.0)
    expected = patch_forces(discretisation, PressSite("z+", (5.2, 4.7, 0.0)), 2.0)
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, -np.pi * 4.0], rtol=1e-12, atol=1e-12)
    # Parts of triangles are counted in or out of the circle, the face's patch is exact.
    assert np.abs(forces - expected).max() < 0.1 * np.abs(expected).max()
    within = np.linalg.norm(BOX.points[:, :2] - (5.2, 4.7), axis=1) <= 2.0
    assert (nodes_under(BOX, site, 2.0) == np.flatnonzero(within & (BOX.points[:, 2] > 3.9))).all()


@pytest.mark.parametrize("divisions", [2, 5])
def test_the_normal_near_a_rim_is_that_of_the_side(divisions: int) -> None:
    block = box_mesh(10.0, divisions)
    sites = plan((7.0, 5.0, 10.0), (9.0, 9.5, 10.0), (10.0, 5.0, 8.0)).sites_on(block)
    directions = [site.direction for site in sites]
    np.testing.assert_allclose(directions, [(0, 0, -1), (0, 0, -1), (-1, 0, 0)], atol=1e-12)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_force_is_along_the_normal_through_the_point_on_every_mesh(element: str) -> None:
    for divisions in (8, 13):
        mesh = dome(divisions)
        (site,) = plan((7.5, 6.0, 5.0)).sites_on(mesh)
        outward = site.point_mm - np.array([5.0, 5.0, -7.0])
        np.testing.assert_allclose(-site.direction, outward / np.linalg.norm(outward), atol=0.03)
        discretisation = Discretisation(mesh, ELEMENTS[element])
        forces = curved_forces(discretisation, site, 2.0)
        total = np.pi * 4.0 * site.direction
        np.testing.assert_allclose(forces.sum(axis=0), total, atol=1e-9)
        arms = discretisation.positions - site.point_mm
        moment = np.cross(arms, forces).sum(axis=0)
        assert np.linalg.norm(moment) < 0.05 * 2.0 * np.linalg.norm(total)


def test_the_surface_moves_inward_where_it_is_pressed(tmp_path: Path) -> None:
    """The phantom is of a file; its fine mesh is given, as fTetWild takes seconds."""
    mesh, fine = dome(4), dome(8)
    nodes = fine.surface.nodes()
    triangles = np.searchsorted(nodes, fine.surface.triangles)
    write_surface(tmp_path / "dome.stl", fine.points[nodes], triangles)
    ball = {"shape": "sphere", "center_mm": [5, 5, 2.5], "radius_mm": 1.0, "youngs_mpa": 1.0}
    phantom = make_phantom("mesh", file=str(tmp_path / "dome.stl"), inclusions=[ball])
    recording = simulate(
        phantom, plan((5, 5, 5), (8, 5, 4.5)), mesh=mesh, fine_mesh=fine, element="tet10", samples=4
    )
    assert [press.name[:1] for press in recording.presses] == ["(", "("]
    for press in recording.presses:
        assert press.direction is not None
        along = press.displacement @ press.direction
        assert np.nanmin(along) > 0.0
        assert np.linalg.norm(press.total_force) == pytest.approx(0.01 * np.pi * 4.0)
        assert (press.fixed[:, 2] == (mesh.points[:, 2] < 1e-9)).all()
    assert recording.truth is not None
    assert recording.truth.max() > 0.2
    stored = recording.provenance["phantom"]
    assert Phantom.from_config(stored).body == phantom.body


@pytest.mark.parametrize(("base", "axis", "sign"), [("z-", 2, 1.0), ("x+", 0, -1.0)])
def test_points_are_spread_over_the_surface_away_from_edges(
    base: str, axis: int, sign: float
) -> None:
    spread = PressPlan(points=9, patch_radius_mm=2.0, pressures_mpa=(0.01,), base=base)
    block = box_mesh(10.0, 10)
    points = np.array([site.point_mm for site in spread.sites_on(block)])
    assert points.shape == (9, 3)
    on_sides = np.isclose(np.abs(points - 5.0), 5.0)
    assert (on_sides.sum(axis=1) == 1).all()
    assert (np.abs(points - 5.0)[~on_sides] <= 3.0 + 1e-9).all()
    assert not np.isclose(sign * points[:, axis], sign * 5.0 - 5.0).any()  # the base
    assert np.isclose(sign * points[0, axis], sign * 5.0 + 5.0)
    apart = np.linalg.norm(points[:, None] - points, axis=2) + 99.0 * np.eye(9)
    assert apart.min() > 4.0


def test_points_of_a_dome_are_on_its_curved_side() -> None:
    around = PressPlan(points=5, patch_radius_mm=1.5, pressures_mpa=(0.01,))
    sites = around.sites_on(dome(10))
    top = [site for site in sites if site.direction[2] < -0.8]
    assert top
    assert top[0].point_mm[2] == pytest.approx(5.0)  # the highest


def test_a_plan_survives_its_configuration() -> None:
    first = plan((1, 2, 3), base="y-")
    assert PressPlan.from_mapping(to_mapping(first)) == first


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: PressPlan(points_mm=[(1, 2, 3)]), ConfigError, "patch_radius_mm"),
        (lambda: plan((1, 2, 3), patch_centers_mm=[(1, 2, 3)]), ConfigError, "give one"),
        (lambda: PressPlan(points=3), ConfigError, "press.points needs press.patch_radius_mm"),
        (lambda: plan((1, 2, 3), points=3), ConfigError, "points_mm and press.points are given"),
        (
            lambda: PressPlan(points=99, patch_radius_mm=1.5).sites_on(BOX), ConfigError,
            "press.points=99: the surface has 77 nodes",
        ),
        (lambda: PressPlan().sites_on(dome()), MeshError, "press.faces: No .* press=around"),
        (lambda: plan((5, 5, 9)).sites_on(BOX), ConfigError, r"\[5.0, 5.0, 9.0\] is 5 mm from"),
        (
            lambda: nodes_under(BOX, plan((5.5, 5.5, 4)).sites_on(BOX)[0], 0.3), ConfigError,
            "No node",
        ),
        (lambda: make_phantom("mesh"), ConfigError, "phantom.file is required"),
        (
            lambda: simulate(
                make_phantom("uniform_cube"), plan((5, 5, 0), base="z+"),
                mesh=TetMesh.create(dome().points * (1, 1, 2), dome().tets),
            ),
            MeshError, r"is on side 'z\+'",
        ),
    ],
)  # fmt: skip
def test_wrong_plans_are_named(make, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        make()
