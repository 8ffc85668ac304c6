"""Random presses of a sensor: recordings, images and their consistency."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.mesh import Box, Hemisphere, Lathe
from tactorch.mesh.lattice import lattice_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.sensor.description import GelLayer, SensorDescription, load_sensor, save_sensor
from tactorch.sensor.render import RenderOptions
from tactorch.touch import Touch, TouchOptions, TouchScene, simulate_touch
from tactorch.touch.places import draw_place

NEO_HOOKEAN = MaterialSpec("neo_hookean", 0.45)


@pytest.fixture(scope="module")
def touched(sensor_file: Path) -> tuple[Recording, Touch]:
    """Two places of a hemisphere, two steps each."""
    return touch(sensor_file, presses=(2, 2), steps=2, shear_mm=(0.2, 0.3))


def touch(sensor_file: Path, seed: int = 1, **changes: Any) -> tuple[Recording, Touch]:
    usual = {"image_width_px": None, "gel_edge_mm": 1.8, "depth_mm": (0.5, 0.8)}
    options = TouchOptions(**{**usual, "sensor": str(sensor_file), **changes})
    phantom = Phantom(Hemisphere((0.0, 0.0, 0.0), 6.0), (), 0.2)
    meshes = [lattice_mesh(phantom.body, edge) for edge in (1.5, 2.5)]
    rng = np.random.default_rng(seed)
    return simulate_touch(
        phantom, *meshes, material=NEO_HOOKEAN, options=options, rng=rng, samples=1, snr_db=40.0
    )


def test_forces_of_recording_and_gel_are_opposite(touched: tuple[Recording, Touch]) -> None:
    recording, found = touched
    assert len(recording.presses) == len(found.images) == 4
    assert found.place.tolist() == [0, 0, 1, 1]
    assert [press.step for press in recording.presses] == [0, 1, 0, 1]
    for press, pose, on_gel in zip(recording.presses, found.poses, found.total_force, strict=True):
        np.testing.assert_allclose(press.total_force, -pose[:3, :3] @ on_gel, atol=1e-6)
        assert on_gel[2] < -0.02
        np.testing.assert_allclose(press.direction, pose[:3, 2], atol=1e-6)
    assert found.total_force[1, 2] < found.total_force[0, 2]  # deeper


def test_poses_are_on_the_surface_and_move_along_their_axis(
    touched: tuple[Recording, Touch],
) -> None:
    _, found = touched
    for pose, first in zip(found.poses, found.first_poses, strict=True):
        rotation = pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-5)
        assert np.linalg.norm(first[:3, 3]) == pytest.approx(6.0, abs=0.25)
        inward = -first[:3, 3] / np.linalg.norm(first[:3, 3])
        assert inward @ rotation[:, 2] > np.cos(np.deg2rad(30.0))
        motion = rotation.T @ (pose[:3, 3] - first[:3, 3])
        assert 0.2 < motion[2] < 0.85
        assert 0.09 < np.linalg.norm(motion[:2]) < 0.31


def test_displacements_are_those_of_the_contact_with_noise(
    touched: tuple[Recording, Touch],
) -> None:
    recording, found = touched
    for press, pose in zip(recording.presses, found.poses, strict=True):
        assert press.observed.any()
        assert press.noise_mm > 0.0
        along = (press.displacement @ pose[:3, 2])[press.observed[:, 0]]
        assert along.max() > 0.05  # pushed along the axis
        assert press.fixed[recording.mesh.points[:, 2] < 1e-6].all()
        # Observed nodes are in front of the gel.
        at = (recording.mesh.points[press.observed[:, 0]] - pose[:3, 3]) @ pose[:3, :3]
        assert np.abs(at[:, 2]).max() < 1.5


def test_pictures_belong_to_the_deformation(touched: tuple[Recording, Touch]) -> None:
    _, found = touched
    assert found.images.shape == (4, 32, 40, 3)
    assert found.images.dtype == found.reference.dtype == np.uint8
    assert found.height_mm.shape == (4, 32, 40)
    assert found.marker_visible.shape == (4, 20)
    assert found.marker_visible.all()
    lowest = found.gel_displacement[..., 2].min(axis=1)
    np.testing.assert_allclose(found.height_mm.min(axis=(1, 2)), lowest, rtol=0.35)
    change = np.abs(found.images[1].astype(float) - found.reference).mean(axis=2)
    assert change[8:24, 10:30].mean() > 1.5 * np.abs(change[:2]).mean()
    # Markers move as the nodes of the gel that are close to them.
    moved = (found.markers_px[1] - found.rest_markers_px) * found.mm_per_px
    at = (found.rest_markers_px - np.array([19.5, 15.5])) * found.mm_per_px
    apart = np.linalg.norm(at[:, None] - found.gel_points[:, :2], axis=2)
    node = apart.argmin(axis=1)
    close = apart.min(axis=1) < 0.3
    assert close.sum() >= 4
    near = found.gel_displacement[1, node[close], :2]
    np.testing.assert_allclose(moved[close], near, atol=0.05)


def test_same_generator_gives_the_same_presses(sensor_file: Path) -> None:
    one, same, other = (touch(sensor_file, seed=s, presses=(1, 1)) for s in (4, 4, 5))
    np.testing.assert_array_equal(one[1].images, same[1].images)
    np.testing.assert_array_equal(one[1].gel_forces, same[1].gel_forces)
    np.testing.assert_array_equal(one[0].presses[0].forces, same[0].presses[0].forces)
    assert (one[1].poses != other[1].poses).any()


def test_presses_are_solved_on_the_other_mesh(sensor_file: Path) -> None:
    """The recording has its own mesh; forces are those of the simulation's mesh."""
    options = TouchOptions(
        sensor=str(sensor_file), gel_edge_mm=1.8, presses=(1, 1), max_slope_deg=30.0
    )
    body = Phantom(Hemisphere((0.0, 0.0, 0.0), 6.0), (), 0.2)
    scenes = []
    for edges in ((1.5, 2.5), (1.0, 2.5), (1.5, None)):
        mesh, fine = (None if e is None else lattice_mesh(body.body, e) for e in edges)
        rng = np.random.default_rng(3)
        assert mesh is not None
        scenes.append(
            simulate_touch(body, mesh, fine, material=NEO_HOOKEAN, options=options, rng=rng)
        )
    (first, one), (second, two), (third, three) = scenes
    np.testing.assert_array_equal(one.gel_forces, two.gel_forces)
    assert first.mesh.n_points < second.mesh.n_points
    assert (one.gel_forces != three.gel_forces).any()
    assert not first.provenance["same_mesh"]
    assert third.provenance["same_mesh"]


def test_images_have_the_wanted_width_and_noise(sensor_file: Path) -> None:
    options = TouchOptions(sensor=str(sensor_file), image_width_px=80)
    description, own = options.description(), load_sensor(sensor_file)
    assert description.image_size_px == (80, 64)
    assert description.size_mm == pytest.approx(own.size_mm)
    _, exact = touch(sensor_file, presses=(1, 1), heights=False, render=RenderOptions(noise=0.0))
    assert exact.height_mm is None
    _, noisy = touch(sensor_file, presses=(1, 1), render=RenderOptions(noise=5.0))
    spread = (noisy.reference.astype(float) - exact.reference).std()
    assert spread == pytest.approx(5.0, rel=0.1)


def test_height_of_a_curved_gel_is_relative_to_its_rest(tmp_path: Path) -> None:
    """A face of straight elements would show its edges."""
    gel = GelLayer(2.5, 0.2, 0.45, radius_mm=6.0, curvature_radius_mm=14.0)
    path = tmp_path / "dome.yaml"
    save_sensor(SensorDescription("dome", (48, 48), (0.2, 0.2), gel), path)
    _, found = touch(path, presses=(1, 1), depth_mm=(0.4, 0.4))
    height = found.height_mm[0]
    assert height.min() < -0.05
    rim = np.concatenate([height[0], height[-1], height[:, 0], height[:, -1]])
    assert np.abs(rim).max() < 0.02
    assert np.abs(np.diff(rim)).max() < 0.01


def test_sensor_without_markers_has_none(sensor_file: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    text = sensor_file.read_text().split("markers:")[0] + "markers: null\n"
    plain.write_text(text)
    _, found = touch(plain, presses=(1, 1))
    assert found.markers_px.shape == (1, 0, 2)
    assert found.total_force[0, 2] < -0.02


def test_wrong_options_are_named(sensor_file: Path) -> None:
    with pytest.raises(ConfigError, match=r"dataset.touch.depth_mm=\[1.0, 0.5\]: give the lower"):
        TouchOptions(depth_mm=(1.0, 0.5))
    with pytest.raises(FileError, match=r"or one of finger.*nowhere.yaml"):
        TouchOptions(sensor="nowhere.yaml").description()
    with pytest.raises(ConfigError, match=r"dataset.touch.friction='glue'"):
        TouchOptions(friction="glue")
    with pytest.raises(ConfigError, match=r"sensor is null"):
        TouchOptions().description()


def test_body_without_places_is_an_error(sensor_file: Path) -> None:
    """A cone is steep everywhere."""
    options = TouchOptions(sensor=str(sensor_file), max_slope_deg=20.0, gel_edge_mm=1.8)
    phantom = Phantom(Lathe((0.0, 0.0, 0.0), [(0, 0), (6, 0), (0, 8)]), (), 0.2)
    mesh, rng = lattice_mesh(phantom.body, 2.0), np.random.default_rng(0)
    with pytest.raises(ConfigError, match=r"within 20 degrees .* z-; give a larger max_slope_deg"):
        simulate_touch(phantom, mesh, None, material=NEO_HOOKEAN, options=options, rng=rng)


def test_flat_sides_that_are_wider_than_the_gel_are_pressed(sensor_file: Path) -> None:
    """A tilted gel touches them at its rim first."""
    options = TouchOptions(sensor=str(sensor_file), gel_edge_mm=1.8, depth_mm=(0.5, 0.5))
    box = Phantom(Box((0.0, 0.0, 4.0), (24.0, 24.0, 8.0)), (), 0.2)
    scene = TouchScene(
        box, lattice_mesh(box.body, 4.0), NEO_HOOKEAN, options.description(), options
    )
    rng = np.random.default_rng(0)
    firsts = [draw_place(scene, rng)[1].first_touch[0] for _ in range(12)]
    assert any(np.abs(first / (5.5, 4.5)).max() > 0.5 for first in firsts)


def test_places_are_where_the_gel_touches_in_its_middle(
    sensor_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactorch.touch.places._CENTRAL", 0.0)
    monkeypatch.setattr("tactorch.touch.places._LAG", -1.0)
    monkeypatch.setattr("tactorch.touch.places._MAX_DRAWS", 3)
    with pytest.raises(ConfigError, match=r"no place was found in 3 draws"):
        touch(sensor_file)
