"""Signal over noise and sensitivity of presses, for each voxel of a body."""

from functools import cache

import numpy as np
import pytest

from tactorch.fem import NewtonOptions
from tactorch.inverse import InverseProblem, PhysicsImage, Settings, physics_image
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.mesh import Box, Sphere, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate
from tactorch.viz import physics_figure

from .test_palpation import CENTER
from .test_palpation import recording as palpation

BALL = np.array([4.0, 5.5, 6.5])


@cache
def pressed(ball_mpa: float | None, side: float = 10.0, youngs: float = 0.2) -> Recording:
    """A cube with a ball of 2 mm or with none, pressed on two sides; on another, finer mesh."""
    scale = side / 10.0
    body = Box((side / 2,) * 3, (side,) * 3)
    balls = [] if ball_mpa is None else [(Sphere(scale * BALL, 2.0 * scale), ball_mpa)]
    return simulate(
        Phantom(body, balls, youngs),
        PressPlan(("z+", "x+"), (0.1 * youngs,), spring_n_per_mm=0.5 * side * youngs),
        mesh=box_mesh(side, 5, tets_per_cell=5), fine_mesh=box_mesh(side, 7, tets_per_cell=5),
        element="tet10", snr_db=40.0,
    )  # fmt: skip


@pytest.mark.parametrize(("ball_mpa", "sign"), [(1.0, 1.0), (0.05, -1.0)])
def test_the_strongest_signal_is_at_the_inclusion(ball_mpa: float, sign: float) -> None:
    image = physics_image(pressed(ball_mpa))
    assert np.linalg.norm(image.peak_mm - BALL) < 1.0  # half its radius
    strongest = np.abs(image.signal).argmax()
    assert sign * image.signal.flat[strongest] > 20.0
    assert image.chi2 > 3.0
    assert np.array_equal(image.signal != 0.0, image.sensitivity != 0.0)


def test_a_uniform_body_has_noise_alone() -> None:
    image = physics_image(pressed(None))
    inside = image.signal[image.grid.inside]
    # Errors of the data beside noise are stated, and may be less.
    assert 0.3 < inside.std() < 1.5
    assert np.abs(inside).max() < 4.0
    assert image.youngs_mpa == pytest.approx(0.2, rel=0.01)
    assert image.chi2 == pytest.approx(1.0, abs=0.25)


def test_it_has_no_unit() -> None:
    """A body of twice the size and three times the modulus, pressed in proportion."""
    small, large = (physics_image(pressed(*a)) for a in ((1.0,), (3.0, 20.0, 0.6)))
    np.testing.assert_allclose(large.signal, small.signal, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(large.sensitivity, small.sensitivity, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(large.wall_distance, small.wall_distance, atol=1e-9)
    np.testing.assert_allclose(large.contact_distance, small.contact_distance, atol=1e-9)


def test_gradient_and_hessian_are_those_of_differences() -> None:
    """By equilibria with the log-modulus of a voxel changed, less what the background changes."""
    problem = ShapeProblem(pressed(1.0), Settings())
    exact = InverseProblem(pressed(1.0), element="tet4", newton=NewtonOptions(rtol=1e-10))
    model = problem.uniform()
    image = PhysicsImage.of(problem, model, 4)
    data = problem.data(model.errors)
    residuals = data.whiten(problem.raw(model).residuals)
    youngs, step = float(np.exp(problem.reduced._log_youngs[0])), 0.02

    def change(logs: np.ndarray) -> np.ndarray:
        ends = [exact.evaluate(youngs * np.exp(s * step * logs)) for s in (1.0, -1.0)]
        up, down = (np.concatenate(end.predicted) for end in ends)
        return data.whiten((up - down) / (2.0 * step) * data.scale)

    basis = data.whiten(problem.jacobian(model))
    for voxel in ((1, 2, 2), (3, 0, 3)):
        column = int(np.ravel_multi_index(voxel, image.grid.shape))
        response = change(image.grid.element_weights[:, [column]].toarray()[:, 0])
        response = response - basis @ np.linalg.lstsq(basis, response, rcond=None)[0]
        size = np.linalg.norm(response)
        assert image.sensitivity[voxel] == pytest.approx(size, rel=2e-3)
        assert image.signal[voxel] == pytest.approx(-residuals @ response / size, rel=2e-3)


def test_distances_are_those_of_a_cube() -> None:
    recording = pressed(None)
    image = PhysicsImage.of(problem := ShapeProblem(recording, Settings()), problem.uniform(), 4)
    nearest = 1.25 * (0.5 + np.minimum(np.arange(4), 3 - np.arange(4))) * 2.0
    expected = np.min(np.meshgrid(nearest, nearest, nearest, indexing="ij"), axis=0) / 10.0
    np.testing.assert_allclose(image.wall_distance, expected, atol=1e-9)
    assert image.contact_distance[3, 3, 3] < image.contact_distance[0, 0, 0]
    assert image.contact_distance[0, 0, 3] == pytest.approx(0.125, abs=0.1)  # below a pressed side


def test_palpations_show_the_place_of_a_lump() -> None:
    image = physics_image(palpation())
    assert np.linalg.norm(image.peak_mm[:2] - CENTER[:2]) < 2.0
    assert image.signal.max() > 5.0


def test_voxels_are_drawn() -> None:
    image = physics_image(pressed(1.0))
    figure = physics_figure(image, n_slices=2, title="signal")
    assert len([axes for axes in figure.axes if axes.images]) == 6
