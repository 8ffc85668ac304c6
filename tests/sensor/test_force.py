"""Forces of frames: those of the iterated equilibrium, in a fixed time, as contact pushes."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import ForceOptions, ForceSolver, GelModel, GelOptions
from tactorch.sensor.gel.compliance import face_compliance

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(10.0, 10.0))
CELLS = GelOptions(1.0, 3, "tet4")


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def model() -> GelModel:
    return GelModel(GEL, CELLS)


def pushed(model: GelModel, pressure_mpa: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forces of a pressure over a patch, how the face moves, and where it was touched."""
    touched = np.linalg.norm(model.points[:, :2], axis=1) < 2.6
    forces = np.where(touched[:, None], (0.2, 0.0, -1.0), 0.0) * pressure_mpa
    forces = forces * model.gel_mesh.face_areas[:, None]
    state = model._equilibrium(forces)
    return forces, state.result.displacement[model.gel_mesh.face], touched


def solver(model: GelModel, deformation: str = "auto") -> ForceSolver:
    return ForceSolver(model, ForceOptions(deformation))


@pytest.mark.parametrize(
    ("pressure", "rtol"), [(0.002, 2e-3), (0.02, 2e-4), (0.06, 2e-3), (0.12, 1e-2)]
)
def test_large_deformations_have_the_forces_that_acted(
    model: GelModel, pressure: float, rtol: float
) -> None:
    """Up to a quarter of the thickness; two orders alone are off by four times as much."""
    forces, moved, touched = pushed(model, pressure)
    size = float(np.abs(moved).max())
    found = solver(model, "large").solve(moved, 1e-5 * size, touched)
    total = forces.sum(axis=0)
    np.testing.assert_allclose(found.total, total, atol=rtol * abs(total[2]))
    np.testing.assert_allclose(found.displacement, moved, atol=max(10 * rtol, 1e-3) * size)


def test_forces_of_noisy_frames_are_those_of_the_iteration(
    model: GelModel, rng: np.random.Generator
) -> None:
    """Within a percent, or a standard deviation."""
    for pressure in (0.004, 0.04):
        _, moved, touched = pushed(model, pressure)
        noisy = moved + rng.normal(0.0, 0.005, moved.shape) + (0.0, 0.0, 0.01)
        slow = model.smooth_forces(noisy, 0.005, touched, free_plane=True)
        fast = solver(model).solve(noisy, 0.005, touched, free_plane=True)
        assert slow.covariance is not None
        deviation = float(np.sqrt(slow.covariance[2, 2]))
        assert abs(fast.total - slow.total).max() < max(0.01 * abs(slow.total[2]), deviation)


def test_small_deformations_are_linear_and_the_choice_is_automatic(model: GelModel) -> None:
    _, moved, touched = pushed(model, 0.002)
    small = solver(model, "small")
    one, two = (small.solve(s * moved, 1e-6, touched).total for s in (1.0, 2.0))
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-3)
    same = solver(model).solve(moved, 1e-6, touched)
    np.testing.assert_array_equal(same.total, one)
    _, deep, _ = pushed(model, 0.06)
    differ = abs(solver(model).solve(deep, 1e-6, touched).total[2] / small.solve(
        deep, 1e-6, touched).total[2] - 1.0)  # fmt: skip
    assert differ > 0.02


def test_frames_do_not_depend_on_earlier_ones(model: GelModel) -> None:
    frames = [pushed(model, pressure)[1] for pressure in (0.05, 0.001, 0.03)]
    touched = pushed(model, 0.01)[2]
    one = solver(model)
    together = [one.solve(moved, 1e-4, touched).forces for moved in frames]
    for moved, forces in zip(frames, together, strict=True):
        alone = solver(model).solve(moved, 1e-4, touched)
        np.testing.assert_array_equal(alone.forces, forces)


def test_depth_alone_gives_the_normal_force_of_a_contact_without_friction(model: GelModel) -> None:
    """And nothing across: not zero, but unknown."""
    touched = np.linalg.norm(model.points[:, :2], axis=1) < 2.6
    for pressure in (0.002, 0.04):
        forces = np.where(touched[:, None], (0.0, 0.0, -pressure), 0.0)
        forces = forces * model.gel_mesh.face_areas[:, None]
        moved = model._equilibrium(forces).result.displacement[model.gel_mesh.face].copy()
        moved[:, :2] = np.nan
        found = solver(model).solve(moved, 1e-5, touched)
        assert found.total[2] == pytest.approx(forces[:, 2].sum(), rel=0.01)
        assert found.normal_only
        assert np.isnan(found.total[:2]).all()
        assert np.isnan(found.forces[touched, :2]).all()
        assert not found.forces[~touched].any()
        assert np.isnan(found.displacement[:, :2]).all()
        assert found.covariance is not None
        assert np.isnan(found.covariance[0]).all()
        assert found.covariance[2, 2] > 0.0
        assert not np.isnan(found.with_zeros().total).any()


def test_contact_does_not_pull(model: GelModel) -> None:
    """A face that rises is refused, and nodes about a contact that would pull are released."""
    _, moved, touched = pushed(model, 0.01)
    with pytest.raises(ConvergenceError, match=r"a pull of .* N on the gel, which contact"):
        solver(model).solve(-moved, 1e-4, touched)
    wide = np.linalg.norm(model.points[:, :2], axis=1) < 4.0
    raised = moved.copy()
    raised[wide & ~touched, 2] += 0.03  # such as from wrong slopes at the edge of the contact
    found = solver(model).solve(raised, 1e-3, wide)
    normal = found.forces[:, 2]
    assert normal.clip(min=0.0).sum() < 0.3 * -normal.clip(max=0.0).sum()
    assert found.total[2] < 0.0
    held = model.smooth_forces(raised, 1e-3, wide).forces[:, 2]
    assert held.clip(min=0.0).sum() > 0.3 * -held.clip(max=0.0).sum()


@pytest.mark.parametrize("depth", [1.5, 3.0, 30.0])
def test_impossible_depths_are_refused(model: GelModel, depth: float) -> None:
    """A gel of 4 mm is not pressed in by 3 mm: a reason in a fixed time, rather than a force."""
    touched = np.linalg.norm(model.points[:, :2], axis=1) < 2.0
    moved = np.where(touched[:, None], (0.0, 0.0, -depth), 0.0)
    found = solver(model)
    if depth < 2.0:
        assert found.solve(moved, 0.01, touched).total[2] < 0.0
        return
    with pytest.raises(ConvergenceError, match="deform"):
        found.solve(moved, 0.01, touched)


def test_compliance_is_stored_for_the_mesh(model: GelModel, own_cache: Path) -> None:
    """For any modulus; damaged files are computed again."""
    told: list[tuple[int, int]] = []
    first = face_compliance(model, lambda done, total: told.append((done, total)))
    assert first is not None
    assert told[-1] == (len(model.points), len(model.points))
    np.testing.assert_allclose(first, first.T)
    loaded = np.arange(len(model.points)) % 7 == 0
    exact = model.rest_compliance(loaded)
    np.testing.assert_allclose(first[:, np.repeat(loaded, 3)], exact, rtol=1e-6, atol=1e-9)
    again = face_compliance(model, lambda *_: pytest.fail("computed again"))
    np.testing.assert_array_equal(first, again)
    stiff = GelModel(GelLayer(4.0, 0.6, 0.45, size_mm=(10.0, 10.0)), CELLS)
    third = face_compliance(stiff, lambda *_: pytest.fail("computed again"))
    np.testing.assert_allclose(3.0 * third, first, rtol=1e-12)
    (path,) = own_cache.rglob("*.npz")
    path.write_bytes(path.read_bytes()[:-100])
    np.testing.assert_allclose(face_compliance(model), first)
    other = GelModel(GelLayer(4.0, 0.2, 0.48, size_mm=(10.0, 10.0)), CELLS)
    face_compliance(other)
    assert len(list(own_cache.rglob("*.npz"))) == 2


def test_nothing_known_is_refused(model: GelModel) -> None:
    nowhere = np.zeros(len(model.points), dtype=bool)
    flat = np.zeros(model.points.shape)
    with pytest.raises(ConfigError, match="contact is false at every node"):
        solver(model).solve(flat, 0.01, nowhere)
    with pytest.raises(ConfigError, match="no displacement of the gel is known"):
        solver(model).solve(flat * np.nan, 0.01, ~nowhere)
