"""Features: independent of units, covariant under rotations, and conserving sums."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.inverse import Bounds, NoiseModel
from tactorch.inverse.fit import linear_image
from tactorch.learning.data import apply_symmetry
from tactorch.learning.surrogate.features import (
    PRESS_CHANNELS,
    PRESS_VECTORS,
    compute_features,
    compute_targets,
    select_strongest,
)
from tactorch.mesh import TetMesh, VoxelGrid, box_mesh
from tactorch.recording import Press, Recording

COUNT = 4


def changed(recording: Recording, length: float, stiffness: float) -> Recording:
    """The same object, `length` times as large and `stiffness` times as stiff."""
    force = stiffness * length**2
    presses = [
        replace(
            press,
            forces=force * press.forces,
            displacement=length * press.displacement,
            springs=stiffness * length * press.springs,
            noise_mm=length * press.noise_mm,
        )
        for press in recording.presses
    ]
    mesh = TetMesh(length * recording.mesh.points, recording.mesh.tets)
    return Recording(mesh, tuple(presses), recording.material, stiffness * recording.truth)


@pytest.mark.parametrize(("length", "stiffness"), [(2.5, 1.0), (1.0, 4.0), (0.3, 0.2)])
def test_units_do_not_matter(recording: Recording, length: float, stiffness: float) -> None:
    seen = compute_features(recording, COUNT)
    other = compute_features(changed(recording, length, stiffness), COUNT)
    assert other.youngs_mpa == pytest.approx(stiffness * seen.youngs_mpa, rel=1e-4)
    np.testing.assert_allclose(other.presses, seen.presses, atol=1e-4)
    np.testing.assert_allclose(other.shared, seen.shared, atol=1e-3)


def turned(recording: Recording, order: tuple[int, ...], signs: tuple[int, ...]) -> Recording:
    """The same object and presses in turned axes."""
    Q = np.zeros((3, 3))
    Q[range(3), order] = signs

    def vectors(values: np.ndarray) -> np.ndarray:
        return np.nan_to_num(values) @ Q.T

    presses = [
        Press(
            vectors(press.forces),
            press.observed[:, order],
            np.where(press.observed[:, order], vectors(press.displacement), np.nan),
            press.springs[:, order],
            noise_mm=press.noise_mm,
        )
        for press in recording.presses
    ]
    tets = recording.mesh.tets
    if np.linalg.det(Q) < 0:
        tets = tets[:, [1, 0, 2, 3]]
    mesh = TetMesh(vectors(recording.mesh.points), tets)
    return Recording(mesh, tuple(presses), recording.material, recording.truth)


@pytest.mark.parametrize(
    ("order", "signs"), [((1, 2, 0), (1, 1, 1)), ((0, 1, 2), (-1, 1, 1)), ((2, 1, 0), (1, -1, -1))]
)
def test_a_turned_object_looks_turned(recording: Recording, order: tuple, signs: tuple) -> None:
    seen, other = (
        compute_features(recording, COUNT),
        compute_features(turned(recording, order, signs), COUNT),
    )
    presses = apply_symmetry((order, signs), torch.from_numpy(seen.presses), PRESS_VECTORS)
    shared = apply_symmetry((order, signs), torch.from_numpy(seen.shared))
    np.testing.assert_allclose(other.presses, presses.numpy(), atol=1e-5)
    np.testing.assert_allclose(other.shared, shared.numpy(), atol=1e-5)


def test_the_channels_have_their_meaning(recording: Recording) -> None:
    seen = compute_features(recording, COUNT)
    assert seen.presses.shape == (2, len(PRESS_CHANNELS), COUNT, COUNT, COUNT)
    top = dict(zip(PRESS_CHANNELS, seen.presses[0], strict=True))
    assert (top["observed"] == 1.0).sum() == COUNT**2
    assert (top["observed"][:, :, -1] == 1.0).all()  # z+ is seen
    assert (top["supported"][:, :, 0] == 1.0).all()
    assert top["supported"].sum() == COUNT**2
    assert (top["displacement_z"][:, :, -1] < 0).all()
    pressure = recording.presses[1].total_force[2] / 100.0 / seen.youngs_mpa
    np.testing.assert_allclose(top["traction_z"].sum() / COUNT**2, pressure, rtol=1e-12)
    assert (seen.shared[0] == 1.0).all()


def test_the_strongest_press_of_each_location_is_selected(recording: Recording) -> None:
    assert select_strongest(recording, 1) == [1, 3]
    assert select_strongest(recording, 2) == [0, 1, 2, 3]
    mirrored = replace(recording.presses[0], forces=-recording.presses[0].forces)
    pulled = replace(recording, presses=(*recording.presses, mirrored))
    assert select_strongest(pulled, 1) == [1, 3, 4]


def test_press_locations_are_distinguished_by_their_loads(recording: Recording) -> None:
    """Not by the observed nodes, which vary between frames; nor by the total force alone."""
    light, heavy = recording.presses[:2]
    holed = light.observed.copy()
    holed[np.flatnonzero(light.observed.any(axis=1))[:3]] = False
    seen = replace(light, observed=holed)
    assert select_strongest(replace(recording, presses=(seen, heavy)), 1) == [1]
    pressed = np.flatnonzero(heavy.forces.any(axis=1))
    half = np.isin(np.arange(len(heavy.forces)), pressed[: len(pressed) // 2])[:, None]
    parts = [replace(heavy, forces=np.where(part, heavy.forces, 0.0)) for part in (half, ~half)]
    assert select_strongest(replace(recording, presses=tuple(parts)), 1) == [0, 1]
    gone = replace(light, springs=0 * light.springs, fixed=light.springs > 0)
    bottom = np.zeros_like(light.prescribed)
    bottom[gone.fixed.any(axis=1), 2] = 0.1
    pushed = [
        replace(gone, forces=0 * light.forces, prescribed=f * bottom, direction=None)
        for f in (1.0, 3.0, 2.0)
    ]
    assert select_strongest(replace(recording, presses=tuple(pushed)), 1) == [1]


def test_values_without_weight_have_no_effect(recording: Recording) -> None:
    press = recording.presses[1]
    node = int(np.flatnonzero(press.observed.any(axis=1))[5])
    weights = np.ones_like(press.forces)
    weights[node] = 0.0
    wrong = press.displacement.copy()
    wrong[node] += 3.0
    plain = replace(recording, presses=(replace(press, weights=weights),))
    bad = replace(recording, presses=(replace(press, weights=weights, displacement=wrong),))
    np.testing.assert_array_equal(
        compute_features(bad, COUNT).presses, compute_features(plain, COUNT).presses
    )


def test_components_that_are_not_observed_take_the_prediction(recording: Recording) -> None:
    press = recording.presses[1]
    only = press.observed & np.array([False, False, True])
    seen = compute_features(replace(recording, presses=(replace(press, observed=only),)), COUNT)
    top = dict(zip(PRESS_CHANNELS, seen.presses[0], strict=True))
    assert (top["residual_x"] == 0).all()
    assert (top["residual_z"] != 0).any()
    assert np.abs(top["displacement_x"]).max() > 0.01


def test_a_press_that_moved_nothing(recording: Recording) -> None:
    still = replace(recording.presses[3], displacement=0 * recording.presses[3].displacement)
    seen = compute_features(replace(recording, presses=(recording.presses[1], still)), COUNT)
    assert np.isfinite(seen.presses).all()
    assert np.isfinite(seen.shared).all()


def test_bounds_and_noise_are_those_given(recording: Recording) -> None:
    unsaid = tuple(replace(press, noise_mm=None) for press in recording.presses)
    unsure = replace(recording, presses=unsaid)
    noise = PRESS_CHANNELS.index("noise")
    low, high = (
        compute_features(unsure, COUNT, noise=NoiseModel(mm=mm)).presses for mm in (0.001, 0.01)
    )
    there = low[:, noise] != 0
    np.testing.assert_allclose((high - low)[:, noise][there], 1.0, atol=1e-3)
    bounded = compute_features(recording, COUNT, bounds=Bounds(0.001, 0.21))
    assert bounded.youngs_mpa == pytest.approx(0.21)


def test_large_meshes_take_the_thrifty_way(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = compute_features(recording, COUNT).shared
    monkeypatch.setattr(linear_image, "_MAX_ENTRIES", 1.0)
    np.testing.assert_allclose(compute_features(recording, COUNT).shared, plain, atol=1e-8)


@pytest.mark.parametrize(("count", "frames"), [(3, 1), (0, 1), (4, 0)])
def test_grids_that_cannot_be(recording: Recording, count: int, frames: int) -> None:
    with pytest.raises(ConfigError, match="must be even"):
        compute_features(recording, count, frames)


def test_targets_are_over_the_uniform_modulus(recording: Recording) -> None:
    target, inside = compute_targets(recording.mesh, recording.truth, 0.25, 8)
    assert inside.all()
    np.testing.assert_allclose(0.25 * np.exp(target).max(), recording.truth.max())
    np.testing.assert_allclose(0.25 * np.exp(target).min(), recording.truth.min())


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 7))
def test_splatting_keeps_sums_and_centres(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = box_mesh(3.0, 2, tets_per_cell=5)
    grid = VoxelGrid(mesh, count)
    values = rng.standard_normal((mesh.n_points, 2))
    field = grid.splat(values)
    np.testing.assert_allclose(field.sum(axis=(1, 2, 3)), values.sum(axis=0), atol=1e-12)


def test_a_node_between_two_voxels_goes_to_both() -> None:
    grid = VoxelGrid(box_mesh(4.0, 2, center_mm=(2.0, 2.0, 2.0), tets_per_cell=5), 4)
    nodal = np.zeros((grid.mesh.n_points, 1))
    middle = np.flatnonzero((grid.mesh.points == 2.0).all(axis=1))
    nodal[middle] = 8.0
    field = grid.splat(nodal)[0]
    np.testing.assert_allclose(field[1:3, 1:3, 1:3], 1.0)
    assert field.sum() == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("poisson", "seen"), [(0.45, -1.0), (0.49, np.log10(0.02)), (0.4999, -3.0)]
)
def test_poissons_ratio_is_seen(recording: Recording, poisson: float, seen: float) -> None:
    material = replace(recording.material, poisson=poisson)
    other = Recording(recording.mesh, recording.presses, material)
    np.testing.assert_allclose(compute_features(other, COUNT).shared[3], seen, atol=1e-5)
