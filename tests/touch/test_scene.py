"""A gel pressed on a body: forces, motion of the gel, and a rigid ball as a limit."""

from collections.abc import Callable

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact import Ball, Contact
from tactorch.mesh import Box, Sphere
from tactorch.mesh.lattice import lattice_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec
from tactorch.sensor.contact import build_press
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelContact, GelMesh
from tactorch.touch import GelPress, TouchScene
from tactorch.touch.pairing import face_each_other
from tactorch.touch.scene import held_nodes

Make = Callable[..., TouchScene]
DOWN, ACROSS = np.array([0.0, 0.0, 0.6]), np.array([0.3, 0.0, 0.0])


def turned(press: GelPress, vectors: np.ndarray) -> np.ndarray:
    return vectors @ press.pose[:3, :3].T


def test_forces_on_gel_body_and_base_balance(make_scene: Make, above: np.ndarray) -> None:
    (press,) = make_scene().press(above, [np.array([0.2, 0.1, 0.6])])
    on_body = press.forces.sum(axis=0)
    on_gel = turned(press, press.gel_forces.sum(axis=0))
    assert on_body[2] < -0.05
    np.testing.assert_allclose(on_gel, -on_body, atol=1e-12)
    np.testing.assert_allclose(press.base_force, -on_body, atol=1e-5)


def test_moments_of_both_forces_balance(make_scene: Make, above: np.ndarray) -> None:
    """Points of gel and body in contact are at one place in the deformed state."""
    scene = make_scene(friction="stick")
    (press,) = scene.press(above, [DOWN])
    moved = press.gel_points + press.gel_displacement
    gel = turned(press, moved) + press.pose[:3, 3]
    on_gel = np.cross(gel, turned(press, press.gel_forces)).sum(axis=0)
    on_body = np.cross(press.points, press.forces).sum(axis=0)
    arm = np.abs(press.points).max() * np.abs(press.forces.sum(axis=0)).max()
    np.testing.assert_allclose(on_gel, -on_body, atol=0.05 * arm)


def test_stiffer_body_and_deeper_press_need_more_force(make_scene: Make, above: np.ndarray) -> None:
    soft = make_scene(0.1).press(above, [0.5 * DOWN, DOWN])
    stiff = make_scene(0.4).press(above, [0.5 * DOWN, DOWN])
    forces = [[-press.forces[:, 2].sum() for press in presses] for presses in (soft, stiff)]
    assert forces[0][0] < forces[0][1] < forces[1][1]
    assert forces[1][0] > 1.3 * forces[0][0]
    # A stiffer body indents the gel more at the same depth.
    assert stiff[1].gel_displacement[:, 2].min() < 1.3 * soft[1].gel_displacement[:, 2].min()


def test_gel_moves_away_from_the_contact_and_with_shear(
    make_scene: Make, above: np.ndarray
) -> None:
    scene = make_scene()
    straight, across = scene.press(above, [DOWN, DOWN + ACROSS])
    at, moved = straight.gel_points[:, :2], straight.gel_displacement[:, :2]
    ring = np.linalg.norm(at, axis=1)
    outside = (ring > 2.0) & (ring < 4.0)
    radial = (moved * at).sum(axis=1)[outside] / ring[outside]
    assert radial.mean() > 5e-4
    assert (radial > 0).mean() > 0.9
    # The sensor moved along +x: the body drags the gel back, along -x.
    change = (across.gel_displacement - straight.gel_displacement)[ring < 1.0, 0]
    assert change.max() < -0.02
    assert across.gel_forces[:, 0].sum() < -0.02
    assert across.forces[:, 0].sum() > 0.02
    np.testing.assert_allclose(across.pose[:3, 3] - straight.pose[:3, 3], (0.3, 0, 0), atol=1e-12)


def test_without_friction_forces_are_pressures_along_the_axis(
    make_scene: Make, above: np.ndarray
) -> None:
    (press,) = make_scene(friction="none").press(above, [DOWN + ACROSS])
    assert np.abs(press.gel_forces[:, :2]).max() == 0.0
    assert (press.forces[:, 2] <= 0.0).all()  # no adhesion
    assert press.gel_forces[:, 2].sum() < -0.05


def test_first_touch_is_that_of_the_shape(make_scene: Make, above: np.ndarray) -> None:
    """The mesh of the body is coarse; the imprint is that of the sphere."""
    pose = above.copy()
    pose[2, 3] = 9.0
    (press,) = make_scene().press(pose, [DOWN])
    assert press.first_pose[2, 3] == pytest.approx(6.0, abs=0.03)
    assert press.pose[2, 3] == pytest.approx(press.first_pose[2, 3] - 0.6)


def test_gaps_of_a_curved_gel_are_those_of_its_face() -> None:
    """Its elements have straight sides."""
    layer = GelLayer(2.5, 0.2, 0.45, radius_mm=6.0, curvature_radius_mm=14.0)
    box = Box((0.0, 0.0, 4.0), (14.0, 14.0, 8.0))
    body, gel = lattice_mesh(box, 4.0), GelMesh(layer, 2.0, 2, center=0.6)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 10.0
    facing = face_each_other(body, box, gel, pose)
    assert facing is not None
    expected = 2.0 - layer.height_mm(facing.points[:, :2])
    np.testing.assert_allclose(facing.gaps_mm, expected, atol=1e-6)


def test_rigid_body_is_a_rigid_ball(make_scene: Make, above: np.ndarray) -> None:
    """The force on a gel by a body that is rigid is that of a probe on the gel alone."""
    scene = make_scene(2000.0, friction="none")
    (press,) = scene.press(above, [np.array([0.0, 0.0, 0.3])])
    gel = scene.gel
    law = make_material("neo_hookean", 0.45)
    body = SoftBody(gel.mesh, law, element="tet10")
    youngs, fixed = np.full(gel.mesh.n_tets, 0.2), np.zeros(gel.mesh.points.shape, dtype=bool)
    fixed[gel.window] = True
    # A probe approaches along its -z axis.
    ball = Contact.of(body.discretisation, Ball(6.0), np.array([0.0, 0.0, 5.7]), 0.2)
    found = body.equilibrate(youngs, np.zeros(fixed.shape), Supports(fixed=fixed), contact=ball)
    probe = ball.at(found.require().displacement).force_n[2]
    assert -press.gel_forces[:, 2].sum() == pytest.approx(probe, rel=0.05)


def test_base_is_held(make_scene: Make, above: np.ndarray) -> None:
    scene = make_scene()
    (press,) = scene.press(above, [DOWN])
    assert scene.held.sum() > 10
    assert np.abs(press.displacement[: scene.mesh.n_points][scene.held]).max() == 0.0
    assert np.abs(press.displacement).max() > 0.1
    top = held_nodes(scene.mesh, "z+", 0.1)
    assert (scene.mesh.points[top, 2] > 5.3).all()


def test_what_cannot_be_pressed_is_refused(make_scene: Make, above: np.ndarray) -> None:
    scene = make_scene()
    aside = above.copy()
    aside[0, 3] = 100.0
    with pytest.raises(ConfigError, match="over no part of the body"):
        scene.press(aside, [DOWN])
    with pytest.raises(ConfigError, match=r"material=linear .*give\s+material=neo_hookean"):
        TouchScene(
            scene.phantom, scene.mesh, MaterialSpec("linear", 0.45), scene.sensor, scene.options
        )


@pytest.mark.slow
def test_impossible_depth_is_an_error(make_scene: Make, above: np.ndarray) -> None:
    with pytest.raises(ConvergenceError, match=r"no equilibrium .* at 8 mm .*smaller depth_mm"):
        make_scene(5.0).press(above, [np.array([0.0, 0.0, 8.0])])


def test_inclusion_raises_the_force(make_scene: Make, above: np.ndarray) -> None:
    """Moduli are those of the phantom at quadrature points, not of its background alone."""
    plain = make_scene(0.1)
    lump = Phantom(plain.phantom.body, [(Sphere((0.0, 0.0, 3.0), 2.4), 2.0)], 0.1)
    hard = TouchScene(lump, plain.mesh, plain.material, plain.sensor, plain.options)
    forces = [scene.press(above, [DOWN])[0].forces[:, 2].sum() for scene in (plain, hard)]
    assert forces[1] < 1.2 * forces[0] < 0.0


def test_gel_knows_how_far_it_moves_a_curved_body(make_scene: Make, above: np.ndarray) -> None:
    """Points of the body move less than the gel, by their gap at first touch."""
    scene = make_scene(edge_mm=1.5, gel_edge_mm=1.0)
    (press,) = scene.press(above, [np.array([0.0, 0.0, 0.9])])
    gel = GelContact(press.gel_points, press.gel_displacement, press.gel_forces)
    loaded = np.linalg.norm(press.gel_forces, axis=1) > 0.0
    found = build_press(gel, press.pose, press.first_pose, scene.mesh, loaded)
    # Nodes near the top of the box are on it, not on the shape that gel and body touch along.
    on_shape = np.abs(scene.phantom.body.signed_distance(scene.mesh.points)) < 1e-3
    gaps = press.first_pose[2, 3] - scene.mesh.points[:, 2]
    within = found.observed.all(axis=1) & on_shape & (gaps < 0.5)
    assert gaps[within].max() > 0.3
    truth = press.displacement[: scene.mesh.n_points][within]
    np.testing.assert_allclose(found.displacement[within], truth, atol=0.03)
    # Poses that are too far away by 0.1 mm, and an object whose shape is not known.
    fixed = [
        build_press(gel, press.pose, press.first_pose, scene.mesh, loaded, apart_mm=apart)
        for apart in (0.1, None)
    ]
    moved = [one.displacement[within, 2] - found.displacement[within, 2] for one in fixed]
    np.testing.assert_allclose(moved[0], -0.1, atol=1e-9)
    np.testing.assert_allclose(moved[1], -gaps[within], atol=1e-6)
