"""Contact forces from how a gel's face moved: those that moved it."""

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import Supports
from tactorch.sensor.description import GelLayer, load_sensor
from tactorch.sensor.gel import GelMesh, GelModel, GelOptions

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(10.0, 10.0))


@pytest.fixture(scope="module")
def model() -> GelModel:
    return GelModel(GEL, GelOptions(1.0, 3, "tet4"))


@pytest.fixture(scope="module")
def pushed(model: GelModel) -> tuple[np.ndarray, np.ndarray]:
    """Forces over a patch, pushing in and a little sideways; and how the face moves under them."""
    distance = np.linalg.norm(model.points[:, :2], axis=1)
    forces = np.where((distance < 2.6)[:, None], (0.004, 0.0, -0.02), 0.0)
    loads = np.zeros(model.gel_mesh.mesh.points.shape)
    loads[model.gel_mesh.face] = forces
    held = np.zeros(loads.shape, dtype=bool)
    held[model.gel_mesh.window] = True
    result = model.body.equilibrate(model.youngs, loads, Supports(fixed=held))
    moved = result.require().displacement
    return forces, moved[model.gel_mesh.face]


def test_forces_are_those_that_moved_it(
    model: GelModel, pushed: tuple[np.ndarray, np.ndarray]
) -> None:
    forces, moved = pushed
    found = model.forces(moved)
    np.testing.assert_allclose(found.forces, forces, atol=1e-9)
    np.testing.assert_allclose(found.total, forces.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.displacement, moved, atol=1e-12)


def test_noise_of_one_percent_leaves_the_total(
    model: GelModel, pushed: tuple[np.ndarray, np.ndarray], rng: np.random.Generator
) -> None:
    """Total force within 5 %; and smooth forces are nearer to the true ones than direct ones."""
    forces, moved = pushed
    noise = 0.01 * np.abs(moved).max()
    noisy = moved + rng.normal(0, noise, moved.shape)
    direct, smooth = model.forces(noisy), model.smooth_forces(noisy, noise)
    distance = np.linalg.norm(model.points[:, :2], axis=1)
    touched = model.smooth_forces(noisy, noise, distance < 3.2)
    size = np.linalg.norm(forces.sum(axis=0))
    for found in (direct, smooth, touched):
        assert np.linalg.norm(found.total - forces.sum(axis=0)) < 0.05 * size
    off = [np.sqrt(np.mean((found.forces - forces) ** 2)) for found in (direct, smooth, touched)]
    assert off[2] < 0.65 * off[0]
    assert off[1] < off[0]
    assert (touched.forces[distance >= 3.2] == 0).all()


def test_what_is_not_seen_is_free(model: GelModel, pushed: tuple[np.ndarray, np.ndarray]) -> None:
    """Where displacements are not known no force is taken to act."""
    forces, moved = pushed
    loaded = np.linalg.norm(forces, axis=1) > 0
    part = np.where(loaded[:, None], moved, np.nan)
    found = model.forces(part)
    np.testing.assert_allclose(found.forces, forces, atol=1e-8)
    np.testing.assert_allclose(found.displacement, moved, atol=1e-8)


@pytest.mark.parametrize("name", ["finger", "gelsight_mini", "gelsight_markers"])
def test_shipped_gels_are_meshed(name: str) -> None:
    gel = load_sensor(name).gel
    meshed = GelMesh(gel, 2.0, 2)
    width, height = gel.half_size_mm
    area = np.pi * width * height if gel.radius_mm is not None else 4 * width * height
    volume = meshed.mesh.volumes.sum()
    assert volume == pytest.approx(area * float(gel.thickness_mm), rel=0.03)
    assert gel.covers(meshed.face_points[:, :2] * (1 - 1e-9)).all()


def test_a_curved_gel() -> None:
    gel = GelLayer(5.0, 0.12, radius_mm=10.0, curvature_radius_mm=26.0)
    meshed = GelMesh(gel, 1.0, 3)
    points = meshed.face_points
    np.testing.assert_allclose(points[:, 2], gel.height_mm(points[:, :2]), atol=1e-9)
    assert points[:, 2].min() == pytest.approx(-2.0)
    np.testing.assert_allclose(meshed.mesh.points[meshed.window, 2], -5.0, atol=1e-9)


def test_wrong_input_is_refused(model: GelModel) -> None:
    with pytest.raises(ConfigError, match=r"shape \(4, 3\); expected \(121, 3\)"):
        model.forces(np.zeros((4, 3)))
    with pytest.raises(ConfigError, match="no displacement of the gel is known"):
        model.forces(np.full((121, 3), np.nan))
    with pytest.raises(ConfigError, match="at least 4 cells across"):
        GelMesh(GEL, 5.0, 4)
    with pytest.raises(ConfigError, match="give a larger"):
        GelMesh(GEL, 0.01, 4)
