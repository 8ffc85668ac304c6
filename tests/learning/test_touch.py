"""What a network sees: the same whatever the units, turned as the object is, and nothing lost."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.learning.symmetry import apply
from tactorch.learning.touch import PRESS_CHANNELS, PRESS_VECTORS, strongest, targets, touch
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
    seen = touch(recording, COUNT)
    other = touch(changed(recording, length, stiffness), COUNT)
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
    seen, other = touch(recording, COUNT), touch(turned(recording, order, signs), COUNT)
    presses = apply((order, signs), torch.from_numpy(seen.presses), PRESS_VECTORS)
    shared = apply((order, signs), torch.from_numpy(seen.shared))
    np.testing.assert_allclose(other.presses, presses.numpy(), atol=1e-5)
    np.testing.assert_allclose(other.shared, shared.numpy(), atol=1e-5)


def test_what_the_channels_say(recording: Recording) -> None:
    seen = touch(recording, COUNT)
    assert seen.presses.shape == (2, len(PRESS_CHANNELS), COUNT, COUNT, COUNT)
    top = dict(zip(PRESS_CHANNELS, seen.presses[0], strict=True))
    assert (top["valid"] == 1.0).sum() == COUNT**2
    assert (top["valid"][:, :, -1] == 1.0).all()  # z+ is seen
    assert (top["held"][:, :, 0] == 1.0).all()
    assert top["held"].sum() == COUNT**2
    assert (top["moved_z"][:, :, -1] < 0).all()
    pressure = recording.presses[1].total_force[2] / 100.0 / seen.youngs_mpa
    np.testing.assert_allclose(top["traction_z"].sum() / COUNT**2, pressure, rtol=1e-12)
    assert (seen.shared[0] == 1.0).all()


def test_the_strongest_press_of_each_place_is_looked_at(recording: Recording) -> None:
    assert strongest(recording, 1) == [1, 3]
    assert strongest(recording, 2) == [0, 1, 2, 3]
    mirrored = replace(recording.presses[0], forces=-recording.presses[0].forces)
    pulled = replace(recording, presses=(*recording.presses, mirrored))
    assert strongest(pulled, 1) == [1, 3, 4]


@pytest.mark.parametrize(("count", "frames"), [(3, 1), (0, 1), (4, 0)])
def test_grids_that_cannot_be(recording: Recording, count: int, frames: int) -> None:
    with pytest.raises(ConfigError, match="must be even"):
        touch(recording, count, frames)


def test_targets_are_over_the_uniform_modulus(recording: Recording) -> None:
    target, inside = targets(recording.mesh, recording.truth, 0.25, 8)
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
