"""Gel and body in one equilibrium: derivatives, a patch test, and one mesh of both as reference."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from tactorch.fem import ELEMENTS, SoftBody, Supports, make_material
from tactorch.mesh import Box, TetMesh, box_mesh
from tactorch.recording import MaterialSpec
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelMesh
from tactorch.touch import TouchScene
from tactorch.touch.coupled import Coupled, CoupledState
from tactorch.touch.pairing import ELEMENT, face_each_other

LAYER = GelLayer(4.0, 0.12, 0.45, size_mm=(10.0, 10.0))


def above(z_mm: float) -> np.ndarray:
    """Pose of a sensor that looks down."""
    pose = np.eye(4)
    pose[:3, :3] = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
    pose[:3, 3] = (5.0, 5.0, z_mm)
    return pose


def on_cube(
    cube: TetMesh, layer: GelLayer, poisson: float, fixed: np.ndarray, cells: int = 7
) -> Coupled:
    gel = GelMesh(layer, 10.0 / cells, 2)
    facing = face_each_other(cube, Box((5.0, 5.0, 5.0), 10.0), gel, above(10.0))
    assert facing is not None
    material = MaterialSpec("neo_hookean", poisson)
    return Coupled(
        facing, cube, gel, material, Supports(fixed=fixed), body_mpa=0.2, depth_mm=1.0, rtol=1e-8
    )


def held(cube: TetMesh) -> np.ndarray:
    return np.repeat(cube.points[:, 2:] < 1e-9, 3, axis=1)


@pytest.fixture
def coupled(make_scene: Callable[..., TouchScene]) -> Callable[[str], Coupled]:
    """A gel on a hemisphere, part of whose points touch."""

    def make(friction: str) -> Coupled:
        scene, pose = make_scene(), np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = 6.0
        facing = scene.facing(pose)
        assert facing is not None
        fixed = np.repeat(scene.held[:, None], 3, axis=1)
        return Coupled(
            facing, scene.mesh, scene.gel, scene.material, Supports(fixed=fixed), body_mpa=0.2,
            depth_mm=0.8, sticks=friction == "stick", rtol=1e-11,
        )  # fmt: skip

    return make


def response(state: CoupledState, forces: np.ndarray) -> np.ndarray:
    return np.array(state.newton.linearize(state.result).force_response(forces))


@pytest.mark.parametrize("friction", ["stick", "none"])
def test_derivatives_by_moduli_and_motion_are_those_of_differences(
    coupled: Callable[[str], Coupled], friction: str
) -> None:
    """In a contact with points that stick, or slip, beside points that are apart."""
    both, motion = coupled(friction), np.array([0.1, -0.05, 0.6])
    body = np.full((both.counts[0], 4), 0.2)
    state = both.solve(both.youngs(body), motion)
    offsets = state.contact.offsets(state.displacement)
    touching = offsets[:, 2] < 0.0
    assert 0.1 < touching.mean() < 0.9
    assert state.contact.sticking.any() == (friction == "stick")

    def at(youngs: np.ndarray, moved: np.ndarray) -> np.ndarray:
        sticking = state.contact.sticking
        return both.solve(youngs, moved, state.displacement, sticking).displacement

    step, moduli = 1e-5, both.youngs(body)
    shape = np.random.default_rng(1).uniform(0.5, 1.5, body.size)[None] * 0.2
    for change in (both.body_changes(shape)[0], both.gel_change):
        force = both.assembly.internal_force(state.newton.linearize(state.result).response, change)
        found = -response(state, force[None])[0]
        ends = [at(moduli + s * change.reshape(moduli.shape), motion) for s in (step, -step)]
        expected = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())
    moved = response(state, state.motion_forces())
    ends = [at(moduli, motion + s * np.eye(3)[2]) for s in (1e-4, -1e-4)]
    expected = (ends[0] - ends[1]) / 2e-4
    np.testing.assert_allclose(moved[0], expected, atol=5e-3 * np.abs(expected).max())


def test_tilts_change_how_far_pairs_penetrate(coupled: Callable[[str], Coupled]) -> None:
    both = coupled("stick")
    state = both.solve(both.youngs(np.full((both.counts[0], 4), 0.2)), np.array([0.0, 0.0, 0.5]))
    forces, points = state.motion_forces(), state.contact.pairs.points
    springs = state.contact.springs(state.displacement)
    # A tilt about x moves a point at y along z by y, one about y a point at x by -x.
    for found, along in zip(forces[1:], (points[:, 1], -points[:, 0]), strict=True):
        by_hand = np.column_stack([0.0 * along, 0.0 * along, springs[:, 2] * along])
        np.testing.assert_allclose(found, state.contact.pairs.spread(by_hand))
    np.testing.assert_allclose(forces.sum(axis=1), 0.0, atol=1e-9 * np.abs(forces).max())


def test_divided_triangles_know_the_area_of_a_contact_better() -> None:
    """A cube of 10 mm ends within triangles of a wider gel."""
    cube, gel = box_mesh(10.0, 4), GelMesh(replace(LAYER, size_mm=(16.0, 16.0)), 1.6, 2)
    found = []
    for divisions in (1, 4):
        facing = face_each_other(cube, cube, gel, above(10.0), divisions)
        assert facing is not None
        found.append(float(facing.areas_mm2.sum()))
        assert len(facing.points) + len(facing.others) == 200 * 6 * divisions**2
        assert np.abs(facing.points[:, :2]).max() < 5.0 < np.abs(facing.others[:, :2]).max()
    assert abs(found[1] - 100.0) < 0.5 * abs(found[0] - 100.0)
    assert found[1] == pytest.approx(100.0, rel=0.03)


@pytest.mark.parametrize(("cells", "matches"), [(8, True), (7, False)])
def test_uniform_pressure_passes_the_contact(cells: int, matches: bool) -> None:
    """Patch test: springs in series, where Poisson's ratio is zero.

    It is exact where the elements of both meet. Else the pressure is uneven, and its sum is right.
    """
    cube = box_mesh(10.0, 4)
    both = on_cube(cube, replace(LAYER, poisson=0.0), 0.0, held(cube), cells)
    motion = 1e-3
    state = both.solve(both.youngs(np.full((cube.n_tets, 4), 0.2)), np.array([0.0, 0.0, motion]))
    at_pairs = state.contact.pair_forces(state.displacement)[:, 2]
    pressure = motion / (10.0 / 0.2 + 4.0 / 0.12 + 1.0 / state.contact.stiffness)
    assert at_pairs.sum() == pytest.approx(100.0 * pressure, rel=1e-4)
    if matches:
        areas = state.contact.pairs.areas_mm2
        np.testing.assert_allclose(at_pairs / areas, pressure, rtol=1e-4)
    gel = state.displacement[both.face_rows, 2]
    largest = 1e-5 if matches else 2e-3
    np.testing.assert_allclose(gel, -4.0 * pressure / 0.12, atol=largest * motion)
    # Along the axis of the sensor, which points down.
    body = state.displacement[both.body_rows[: cube.n_points], 2]
    expected = pressure / 0.2 * cube.points[:, 2]
    np.testing.assert_allclose(body, expected, atol=largest * motion)


@pytest.mark.slow
def test_markers_move_as_in_one_mesh_of_both() -> None:
    """A finer mesh that shares nodes in the contact, with a ball in the cube."""
    layer = replace(LAYER, size_mm=(14.0, 14.0))
    cube = box_mesh(10.0, 6)
    both = on_cube(cube, layer, 0.45, held(cube), cells=8)
    depth = 0.8

    def youngs(mesh: TetMesh) -> np.ndarray:
        at = ELEMENTS[ELEMENT].points @ mesh.points[mesh.tets]
        inside = np.linalg.norm(at - (5.0, 6.0, 6.5), axis=-1) < 2.0
        return np.where(inside, 1.0, 0.2)

    state = both.solve(both.youngs(youngs(cube)), np.array([0.0, 0.0, depth]))
    force = state.contact.pair_forces(state.displacement).sum(axis=0)[2]
    # One mesh, in the frame of the cube.
    grid = box_mesh((14.0, 14.0, 14.0), 14, origin_mm=(-2.0, -2.0, 0.0))
    centers = grid.points[grid.tets].mean(axis=1)
    kept = (centers[:, 2] > 10.0) | ((centers > 0.0) & (centers < 10.0)).all(axis=1)
    used, tets = np.unique(grid.tets[kept], return_inverse=True)
    mesh = TetMesh.create(grid.points[used], tets.reshape(-1, 4))
    moduli = youngs(mesh)
    moduli[mesh.centroids[:, 2] > 10.0] = 0.12
    window, base = mesh.points[:, 2] > 14.0 - 1e-6, mesh.points[:, 2] < 1e-6
    fixed = np.repeat((window | base)[:, None], 3, axis=1)
    prescribed = np.where(window[:, None], (0.0, 0.0, -depth), 0.0)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45), element="tet10")
    found = body.equilibrate(
        moduli, np.zeros(mesh.points.shape), Supports(fixed, prescribed)
    ).require()
    inner = body.assembly.internal_force(found.response, moduli)
    up = np.flatnonzero(body.discretisation.positions[:, 2] > 14.0 - 1e-6)
    assert force == pytest.approx(inner[up, 2].sum() * -1.0, rel=0.02)
    numbers = np.flatnonzero(np.abs(mesh.points[:, 2] - 10.0) < 1e-6)
    turn = above(10.0)[:3, :3]
    moved = (found.displacement[numbers] + (0.0, 0.0, depth)) @ turn
    places = (mesh.points[numbers] - (5.0, 5.0, 10.0)) @ turn
    at = np.stack(np.meshgrid(*2 * [np.linspace(-3.5, 3.5, 8)]), axis=-1).reshape(-1, 2)
    rows = both.face_rows
    pair = (both.parts.positions[rows], state.displacement[rows]), (places, moved)
    first, second = (LinearNDInterpolator(points[:, :2], u)(at) for points, u in pair)
    np.testing.assert_allclose(first, second, atol=0.03 * np.abs(second).max())
