"""Smooth forces: what the prior takes, what it leaves, and how well the total is known."""

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelModel, GelOptions
from tactorch.sensor.gel.tractions import SmoothFit, traction_basis

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(10.0, 10.0))
NONE = np.zeros((60, 0))
Basis = tuple[np.ndarray, np.ndarray]


@pytest.fixture
def row() -> Basis:
    """Ten nodes in a row, those at the ends with half the area."""
    areas = np.ones(10)
    areas[[0, -1]] = 0.5
    return traction_basis(np.stack([np.arange(9), np.arange(1, 10)], axis=1), areas)


@pytest.fixture
def compliance(rng: np.random.Generator) -> np.ndarray:
    """Of 60 displacements, to neighbours much alike."""
    apart = np.abs(np.linspace(0, 9, 20)[:, None] - np.arange(10))
    return np.kron(np.exp(-((apart / 1.5) ** 2)), np.eye(3)) * rng.uniform(0.9, 1.1, (60, 1))


def test_roughness_is_of_tractions(row: Basis) -> None:
    """What is uniform is free; a ramp of tractions has the squares of its nine steps."""
    areas = np.repeat(np.r_[0.5, np.ones(8), 0.5], 3)
    uniform, rough = row
    np.testing.assert_allclose(uniform @ np.linalg.pinv(uniform) @ areas, areas)
    assert uniform.shape == (30, 3)
    ramp = areas * np.repeat(0.2 * np.arange(10), 3)
    amplitudes = np.linalg.solve(np.hstack([rough, uniform]), ramp)[: rough.shape[1]]
    assert amplitudes @ amplitudes == pytest.approx(3 * 9 * 0.04)


def test_parts_that_do_not_meet_are_free_each() -> None:
    uniform, _ = traction_basis(np.array([[0, 1], [2, 3]]), np.ones(5))
    assert uniform.shape == (15, 9)  # two pairs and a lone node


def test_uniform_tractions_are_not_taken_from(row: Basis, compliance: np.ndarray) -> None:
    """However much noise is stated."""
    forces = np.repeat(np.r_[0.5, np.ones(8), 0.5], 3) * np.tile([0.01, 0.0, -0.1], 10)
    for noise in (1e-6, 10.0):
        found, *_ = SmoothFit(compliance, NONE, row).fit(compliance @ forces, noise)
        np.testing.assert_allclose(found, forces, atol=1e-6)


def test_total_is_as_uncertain_as_stated(
    row: Basis, compliance: np.ndarray, rng: np.random.Generator
) -> None:
    """Over tractions drawn from the prior, and noise."""
    scores, noises = [], []
    for _ in range(150):
        walk = row[1] @ rng.normal(0, 0.3, row[1].shape[1])
        noisy = compliance @ walk + rng.normal(0, 0.2, 60)
        found, covariance, noise = SmoothFit(compliance, NONE, row).fit(noisy, 0.2)
        off = (found - walk).reshape(-1, 3).sum(axis=0)
        scores.append(off @ np.linalg.solve(covariance, off))
        noises.append(noise)
    assert np.mean(scores) == pytest.approx(3.0, abs=0.8)  # four deviations of the mean
    assert np.median(noises) == pytest.approx(0.2, rel=0.1)


def test_noise_that_shows_counts_where_less_is_stated(
    row: Basis, compliance: np.ndarray, rng: np.random.Generator
) -> None:
    noisy = compliance @ row[0][:, 2] + rng.normal(0, 0.2, 60)
    assert SmoothFit(compliance, NONE, row).fit(noisy, 1e-4)[2] == pytest.approx(0.2, rel=0.3)
    assert SmoothFit(compliance, NONE, row).fit(noisy, 0.7)[2] == pytest.approx(0.7)


def test_what_a_plane_may_explain_tells_nothing(
    row: Basis, compliance: np.ndarray, rng: np.random.Generator
) -> None:
    forces = row[0][:, 2] * -0.1
    plane = np.tile(np.eye(3)[2], 20)[:, None]
    raised = compliance @ forces + 5.0 * plane[:, 0]
    wrong, *_ = SmoothFit(compliance, NONE, row).fit(raised, 0.01)
    assert np.linalg.norm(wrong - forces) > 1.0
    found, covariance, _ = SmoothFit(compliance, plane, row).fit(raised, 0.01)
    np.testing.assert_allclose(found, forces, atol=1e-6)
    _, known, _ = SmoothFit(compliance, NONE, row).fit(compliance @ forces, 0.01)
    assert covariance[2, 2] > known[2, 2]


@pytest.fixture(scope="module", params=["tet4", "tet10"])
def model(request: pytest.FixtureRequest) -> GelModel:
    return GelModel(GEL, GelOptions(1.25, 2, request.param))


def pushed(model: GelModel, pressure_mpa: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces of a pressure over a patch, how the face moves, and where it was touched."""
    touched = np.linalg.norm(model.points[:, :2], axis=1) < 2.6
    forces = np.where(touched[:, None], (0.2, 0.0, -1.0), 0.0) * pressure_mpa
    forces = forces * model.gel_mesh.face_areas[:, None]
    state = model._equilibrium(forces)
    return forces, state.result.displacement[model.gel_mesh.face], touched


def test_forces_on_nodes_are_tractions_about_them(model: GelModel) -> None:
    """The same all over, they are what the element itself makes of a uniform traction."""
    traction = np.array([0.02, 0.0, -0.1])
    loads = model.load_matrix @ (model.gel_mesh.face_areas[:, None] * traction)
    corners = np.isin(model.gel_mesh.mesh.surface.triangles, model.gel_mesh.face).all(axis=1)
    exact = model.body.traction(np.flatnonzero(corners), traction.tolist()).numpy()
    np.testing.assert_allclose(loads, exact, atol=1e-12)
    alone = np.zeros(model.points.shape)
    alone[30] = traction
    np.testing.assert_allclose((model.load_matrix @ alone).sum(axis=0), traction)
    assert ((model.load_matrix @ alone) != 0).any(axis=1).sum() == (
        1 if model.body.n_nodes == model.gel_mesh.mesh.n_points else 6
    )


@pytest.mark.parametrize("pressure", [0.001, 0.04])
def test_smooth_forces_find_what_acted(model: GelModel, pressure: float) -> None:
    """On quadratic elements too, and where the gel is squeezed by a fifth of its thickness."""
    forces, moved, touched = pushed(model, pressure)
    size = float(np.abs(moved).max())
    found = model.smooth_forces(moved, 1e-5 * size, touched)
    np.testing.assert_allclose(found.total, forces.sum(axis=0), atol=1e-3 * abs(forces.sum()))
    np.testing.assert_allclose(found.displacement, moved, atol=1e-3 * size)
    again = model.smooth_forces(moved, 1e-5 * size, touched)
    np.testing.assert_array_equal(again.forces, found.forces)


def test_a_tilt_of_the_depth_is_found(model: GelModel) -> None:
    forces, moved, touched = pushed(model, 0.005)
    tilt = 0.02 + 0.003 * model.points[:, 0]
    tilted = moved + tilt[:, None] * (0.0, 0.0, 1.0)
    found = model.smooth_forces(tilted, 1e-5, touched, free_plane=True)
    np.testing.assert_allclose(found.total, forces.sum(axis=0), atol=2e-3 * abs(forces.sum()))
    wrong = model.smooth_forces(tilted, 1e-5, touched)
    assert np.linalg.norm(wrong.total - forces.sum(axis=0)) > 0.1 * abs(forces.sum())


def test_direct_total_answers_to_noise_as_stated(model: GelModel, rng: np.random.Generator) -> None:
    """The covariance is that of the total's derivatives, here by differences."""
    _, moved, touched = pushed(model, 0.01)
    given = np.where(touched[:, None], moved, np.nan)
    found = model.forces(given, 1.0)
    assert found.covariance is not None
    step = rng.normal(0, 1e-6, moved.shape)
    apart = model.forces(given + step).total - model.forces(given - step).total
    known = np.isfinite(given)
    state = model._equilibrium(np.zeros(given.shape), given)
    rates = model._total_force_sensitivity(state, known)
    np.testing.assert_allclose(rates @ step[known], apart / 2, rtol=2e-4, atol=1e-10)
    np.testing.assert_allclose(found.covariance, rates @ rates.T)


def test_forces_go_with_the_modulus(model: GelModel, rng: np.random.Generator) -> None:
    """At the same displacements, noise and all."""
    _, moved, touched = pushed(model, 0.01)
    noisy = moved + rng.normal(0, 0.003, moved.shape)
    element = "tet10" if model.body.discretisation.element.quadratic else "tet4"
    stiffer = GelModel(GelLayer(4.0, 0.6, 0.45, size_mm=(10.0, 10.0)), GelOptions(1.25, 2, element))
    for find in (
        lambda m: m.forces(noisy, 0.003),
        lambda m: m.smooth_forces(noisy, 0.003, touched),
    ):
        soft, stiff = find(model), find(stiffer)
        np.testing.assert_allclose(stiff.total, 3.0 * soft.total, rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(stiff.covariance, 9.0 * soft.covariance, rtol=5e-3, atol=1e-9)


def test_no_contact_is_refused(model: GelModel) -> None:
    nowhere = np.zeros(len(model.points), dtype=bool)
    with pytest.raises(ConfigError, match="contact is false at every node"):
        model.smooth_forces(np.zeros(model.points.shape), 0.01, nowhere)
