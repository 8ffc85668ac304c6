"""Forces on a gel that is refined at the edge of the contact."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.sensor.description import GelLayer
from tactorch.sensor.face_data import FaceData
from tactorch.sensor.gel import GelModel, GelOptions
from tactorch.sensor.gel_face import GelFace
from tactorch.sensor.refined_gel import RefinedGel

GEL = GelLayer(2.0, 0.12, 0.45, size_mm=(8.0, 8.0))
HALF = 2.3  # of the contact, mm; no line of the meshes


def square(points: np.ndarray) -> np.ndarray:
    inside = HALF - np.abs(points)
    outside = -np.linalg.norm(np.minimum(inside, 0.0), axis=1)
    return np.where((inside > 0).all(axis=1), inside.min(axis=1), outside)


def pressed(points: np.ndarray) -> np.ndarray:
    """Smooth displacement of a contact without slip, mm."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([0.03 * x + 0.02, 0.03 * y, -0.2 - 0.01 * (x**2 + y**2) - 0.01 * x])


@pytest.fixture(scope="module")
def model() -> GelModel:
    return GelModel(GEL, GelOptions(edge_mm=1.0, layers=2))


@pytest.fixture(scope="module")
def truth() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the face, their displacement and the force, on another, finer mesh."""
    fine = RefinedGel(GelModel(GEL, GelOptions(edge_mm=1.6, layers=3)), square, 0.7)
    state = fine._equilibrium(pressed(fine.face.points[fine.face.touching]))
    return fine.face.points, fine._moved(state), fine._forces(state).sum(axis=0)


def measured(truth: tuple[np.ndarray, ...], rng: np.random.Generator) -> FaceData:
    """Noisy displacements of markers and depths, the latter with a constant and a tilt."""
    points, moved, _ = truth
    near = (np.abs(points[:, :2]) < 3.6).all(axis=1)
    at = points[near]
    every = np.arange(len(at))
    markers = every[::3]
    plane = 0.05 + 0.004 * at[:, 0]
    return FaceData.of(
        at[markers, :2], moved[near][markers, :2] + rng.normal(0.0, 0.001, (len(markers), 2)),
        0.002, at[:, :2], moved[near][:, 2] + plane + rng.normal(0.0, 0.005, len(at)), 0.01,
    )  # fmt: skip


def test_force_of_a_contact_with_a_sharp_edge(
    model: GelModel, truth: tuple[np.ndarray, ...]
) -> None:
    data = measured(truth, np.random.default_rng(0))
    found = RefinedGel(model, square, 0.9).solve(data, free_plane=True)
    _, _, force = truth
    np.testing.assert_allclose(found.total, force, rtol=0.03, atol=0.01 * abs(force[2]))
    assert found.in_contact is not None
    inside = found.in_contact
    wrong = found.displacement[inside] - pressed(found.points[inside])
    assert np.abs(wrong[:, :2]).max() < 0.01
    assert wrong[:, 2].std() < 0.015  # its mean and tilt are not measured
    assert np.abs(found.forces[~inside]).max() == 0.0


def test_more_force_from_a_mesh_that_does_not_resolve_the_edge(
    model: GelModel, truth: tuple[np.ndarray, ...]
) -> None:
    points, moved, force = truth
    nearest = np.linalg.norm(points[:, None, :2] - model.points[None, :, :2], axis=2).argmin(axis=0)
    coarse = model.smooth_forces(moved[nearest], 0.001, square(model.points[:, :2]) > -0.3)
    assert abs(coarse.total[2] / force[2] - 1.0) > 0.03


def test_elements_are_small_at_the_edge_and_nodes_lie_on_it(model: GelModel) -> None:
    face = GelFace.refined(model.gel_mesh, GEL, square, 0.6)
    away = square(face.points[:, :2])
    assert (np.abs(away) < 1e-9).sum() > 20
    corners = face.points[face.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    at_edge = np.abs(square(corners.mean(axis=1)[:, :2])) < 0.2
    assert longest[at_edge].max() < 0.6 + 2 * 0.3 * 0.6  # nodes move by up to 0.3 of it
    assert face.touching[away > 0.2].all()
    assert not face.touching[away < -0.05].any()
    np.testing.assert_allclose(face.points[:, 2], 0.0, atol=1e-12)


def test_nodes_of_a_curved_face_stay_on_it() -> None:
    gel = GelLayer(2.0, 0.12, 0.45, size_mm=(8.0, 8.0), curvature_radius_mm=20.0)
    model = GelModel(gel, GelOptions(edge_mm=1.0, layers=3))
    face = GelFace.refined(model.gel_mesh, gel, square, 0.6)
    np.testing.assert_allclose(face.points[:, 2], gel.height_mm(face.points[:, :2]), atol=1e-12)
    assert np.ptp(face.points[:, 2]) > 0.3


def test_each_part_of_a_contact_has_linear_modes(model: GelModel) -> None:
    def two(points: np.ndarray) -> np.ndarray:
        return 1.0 - np.abs(np.column_stack([np.abs(points[:, 0]) - 2.0, points[:, 1]])).max(axis=1)

    face = GelFace.refined(model.gel_mesh, GEL, two, 0.6)
    linear, rough = face.smooth_modes(20)
    x = face.points[face.touching, 0]
    wanted = np.column_stack([x > 0, np.where(x > 0, x, 0.0), np.where(x > 0, 0.0, x)])
    left = wanted - linear @ np.linalg.lstsq(linear, wanted, rcond=None)[0]
    assert linear.shape[1] == 6
    assert rough.shape[1] == 20
    assert np.abs(left).max() < 1e-9


def test_rows_interpolate_linear_displacements_exactly(model: GelModel) -> None:
    rng = np.random.default_rng(1)
    at = rng.uniform(-3.9, 3.9, (30, 2))
    moved = np.column_stack([0.1 * at[:, 0], 0.2 * at[:, 1], 0.3 * at[:, 0] - at[:, 1]])
    data = FaceData.of(at, moved[:, :2], 0.01, at, moved[:, 2], 0.01)
    points, triangles = model.points, model.gel_mesh.face_triangles
    nodal = np.column_stack(
        [0.1 * points[:, 0], 0.2 * points[:, 1], 0.3 * points[:, 0] - points[:, 1]]
    )
    np.testing.assert_allclose(
        data.rows(points, triangles) @ nodal.ravel(), data.displacement_mm, atol=1e-12
    )


def test_data_that_are_unknown_are_left_out() -> None:
    at = np.zeros((3, 2))
    in_plane = np.array([(0.1, 0.2), (np.nan, np.nan), (0.3, 0.4)])
    data = FaceData.of(at, in_plane, 0.002, at, np.array([np.nan, 0.5, 0.6]), 0.01)
    assert data.displacement_mm.tolist() == [0.1, 0.3, 0.2, 0.4, 0.5, 0.6]
    assert data.axes.tolist() == [0, 0, 1, 1, 2, 2]
    with pytest.raises(ConfigError, match="deviations_mm"):
        replace(data, deviations_mm=np.zeros(6))
    with pytest.raises(ConfigError, match="not finite"):
        replace(data, displacement_mm=np.full(6, np.nan))


def test_a_contact_without_a_triangle_is_refused(model: GelModel) -> None:
    with pytest.raises(ConfigError, match="contact_edge_mm"):
        RefinedGel(model, lambda p: 0.01 - np.linalg.norm(p - 0.37, axis=1), 0.9)


def test_a_face_that_is_pulled_out_is_refused(model: GelModel) -> None:
    at = model.points[np.abs(model.points[:, :2]).max(axis=1) < HALF]
    data = FaceData.of(
        at[:, :2], np.zeros((len(at), 2)), 0.01, at[:, :2], np.full(len(at), 0.1), 0.01
    )
    with pytest.raises(ConvergenceError, match="pull"):
        RefinedGel(model, square, 1.5).solve(data)
