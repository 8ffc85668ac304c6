"""Forces on a gel that is refined at the edge of the contact."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import (
    FaceData,
    GelContact,
    GelFace,
    GelModel,
    GelOptions,
    RefinedGel,
    refined,
)
from tactorch.sensor.gel.refined import _edge_length

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


@pytest.fixture(scope="module", autouse=True)
def coarser() -> Iterator[None]:
    """Elements as long as stated, although the contact is small, and few modes: fast tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refined, "_EDGE_LENGTH", 1.0)
        patch.setattr(refined, "_MODES", 30)
        yield


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


@pytest.fixture(scope="module")
def gel(model: GelModel) -> RefinedGel:
    return RefinedGel(model, square, 0.7)


@pytest.fixture(scope="module")
def found(gel: RefinedGel, truth: tuple[np.ndarray, ...]) -> GelContact:
    return gel.solve(measured(truth, np.random.default_rng(0)), free_plane=True)


@pytest.mark.slow
def test_force_of_a_contact_with_a_sharp_edge(
    found: GelContact, truth: tuple[np.ndarray, ...]
) -> None:
    _, _, force = truth
    np.testing.assert_allclose(found.total, force, rtol=0.03, atol=0.01 * abs(force[2]))
    assert found.in_contact is not None
    inside = found.in_contact
    wrong = found.displacement[inside] - pressed(found.points[inside])
    assert np.abs(wrong[:, :2]).max() < 0.01
    assert wrong[:, 2].std() < 0.015  # its mean and tilt are not measured
    assert np.abs(found.forces[~inside]).max() == 0.0


@pytest.mark.slow
def test_errors_of_forces_follow_from_those_of_displacements(
    gel: RefinedGel, found: GelContact, truth: tuple[np.ndarray, ...]
) -> None:
    errors, touching = found.errors, gel.face.touching
    assert errors is not None
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance, errors.covariance)
    deviation = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.total - truth[2]) < 3.0 * deviation).all()
    assert deviation[2] < 0.1 * abs(truth[2][2])
    assert not errors.forces[:, ~touching].any()
    largest = int(np.abs(errors.displacement).sum(axis=(1, 2)).argmax())
    step, change = 0.1, errors.displacement[largest]
    ends = [
        gel._equilibrium(found.displacement[touching] + sign * step * change[touching], gel._rest)
        for sign in (1.0, -1.0)
    ]
    moved, forces = (
        (part(ends[0]) - part(ends[1])) / (2.0 * step) for part in (gel._moved, gel._forces)
    )
    np.testing.assert_allclose(change, moved, atol=1e-3 * np.abs(moved).max())
    wanted = errors.forces[largest]
    np.testing.assert_allclose(forces, wanted, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.slow
def test_forces_near_the_edge_have_further_errors(found: GelContact) -> None:
    assert found.errors is not None
    only = ~found.errors.displacement.any(axis=(1, 2))
    near = square(found.points[:, :2]) < 0.7
    assert only.any()
    forces = found.errors.forces[only]
    assert not forces[:, ~near].any()
    size = np.linalg.norm(found.forces[near & (found.forces != 0.0).any(axis=1)], axis=1)
    deviation = np.sqrt((forces**2).sum(axis=(0, 2)))
    ratio = deviation[near & (found.forces != 0.0).any(axis=1)] / size
    assert ratio.min() > 0.05
    assert ratio.max() < 0.15


def test_more_force_from_a_mesh_that_does_not_resolve_the_edge(
    model: GelModel, truth: tuple[np.ndarray, ...]
) -> None:
    points, moved, force = truth
    nearest = np.linalg.norm(points[:, None, :2] - model.points[None, :, :2], axis=2).argmin(axis=0)
    coarse = model.smooth_forces(moved[nearest], 0.001, square(model.points[:, :2]) > -0.3)
    assert abs(coarse.total[2] / force[2] - 1.0) > 0.03


def test_elements_are_small_at_the_edge_and_nodes_lie_on_it(model: GelModel) -> None:
    face = GelFace.refined(model.gel_mesh, square, 0.6)
    away = square(face.points[:, :2])
    assert (np.abs(away) < 1e-9).sum() > 20
    corners = face.points[face.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    at_edge = np.abs(square(corners.mean(axis=1)[:, :2])) < 0.2
    assert longest[at_edge].max() < 0.6 + 2 * 0.3 * 0.6  # nodes move by up to 0.3 of it
    assert face.touching[away > 0.2].all()
    assert not face.touching[away < -0.05].any()
    np.testing.assert_allclose(face.points[:, 2], 0.0, atol=1e-12)


@pytest.mark.parametrize(("base_mm", "edge_mm"), [(0.8, 0.9), (1.0, 0.5), (1.6, 0.7)])
def test_no_element_is_cut_by_the_edge(base_mm: float, edge_mm: float) -> None:
    coarse = GelModel(GEL, GelOptions(edge_mm=base_mm, layers=2)).gel_mesh
    for half, shift in ((2.3, 0.0), (1.9, 0.27), (2.6, -0.41)):

        def moved(points: np.ndarray, half: float = half, shift: float = shift) -> np.ndarray:
            return square((points - shift) * HALF / half) * half / HALF

        face = GelFace.refined(coarse, moved, edge_mm)
        area = face._contact_areas(face.points[face.touching, :2]).sum()
        # The corners of the square need not be nodes: cut ones miss up to half of edge_mm^2 each.
        assert (2 * half) ** 2 - 2 * edge_mm**2 <= area <= (2 * half) ** 2 + 1e-9


def test_elements_of_small_contacts_are_smaller() -> None:
    assert _edge_length(square, GEL) == pytest.approx(2 * HALF, rel=0.05)
    assert _edge_length(lambda p: square(100.0 * p), GEL) == 0.15
    assert _edge_length(lambda p: np.full(len(p), -1.0), GEL) == 0.0


def test_nodes_of_a_curved_face_stay_on_it() -> None:
    gel = GelLayer(2.0, 0.12, 0.45, size_mm=(8.0, 8.0), curvature_radius_mm=20.0)
    model = GelModel(gel, GelOptions(edge_mm=1.0, layers=3))
    face = GelFace.refined(model.gel_mesh, square, 0.6)
    np.testing.assert_allclose(face.points[:, 2], gel.height_mm(face.points[:, :2]), atol=1e-12)
    assert np.ptp(face.points[:, 2]) > 0.3


def test_each_part_of_a_contact_has_linear_modes(model: GelModel) -> None:
    def two(points: np.ndarray) -> np.ndarray:
        return 1.0 - np.abs(np.column_stack([np.abs(points[:, 0]) - 2.0, points[:, 1]])).max(axis=1)

    face = GelFace.refined(model.gel_mesh, two, 0.6)
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


def test_errors_of_integrated_slopes() -> None:
    axis = np.linspace(-4.0, 4.0, 17)
    at = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    depth = np.where(square(at) >= 0.0, -0.3, 0.0)
    data = FaceData.of(at, np.zeros(at.shape), 0.002, at, depth, 0.01)
    wide = data.with_depth_errors(square, 0.9)
    near, along_z = np.abs(square(data.points_mm)) < 0.99, data.axes == 2
    np.testing.assert_allclose(wide.deviations_mm[~along_z & ~near], 0.002)
    np.testing.assert_allclose(wide.deviations_mm[~along_z & near], 0.01)
    np.testing.assert_allclose(wide.deviations_mm[along_z & near], 0.02)
    assert wide.patterns_mm is not None
    covariance = wide.patterns_mm @ wide.patterns_mm.T
    assert not covariance[~along_z].any()
    inside = square(at) >= 0.0
    depths = covariance[np.ix_(along_z, along_z)]
    np.testing.assert_allclose(np.diag(depths)[~inside], 0.005**2, rtol=0.02)
    np.testing.assert_allclose(np.diag(depths)[inside], 0.005**2 + 0.03**2, rtol=0.02)
    far = np.linalg.norm(at[:, None] - at, axis=2) > 4.0
    np.testing.assert_allclose(depths[far & inside[:, None] & inside], 0.03**2, rtol=0.02)
    assert np.abs(depths[far & ~(inside[:, None] & inside)]).max() < 0.2 * 0.005**2
    # Whitened errors are independent.
    draws = np.random.default_rng(0).normal(size=(wide.patterns_mm.shape[1], 4000))
    rough = np.random.default_rng(1).normal(size=(len(data.axes), 4000))
    drawn = wide.patterns_mm @ draws + wide.deviations_mm[:, None] * rough
    whitened = wide.whiten(drawn)
    np.testing.assert_allclose(np.mean(whitened**2), 1.0, rtol=0.01)
    assert np.abs(np.corrcoef(whitened[::29])[0, 1:]).max() < 0.1
    single = wide.whiten(drawn[:, 0])
    np.testing.assert_allclose(single, whitened[:, 0], rtol=1e-9, atol=1e-9)


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
