"""The press after which the map of shapes is expected to be best."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import InverseProblem
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.fields.parameterization import Log
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.sampling import Patch
from tactorch.sampling.rules import SamplingState
from tactorch.sampling.shape_design import ExpectedShapeError, LumpPosition, ShapeDesign
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 5, tets_per_cell=5)
CENTER = (3.0, 5.0, 7.0)  # of the ball


def shapes_of(*balls: tuple[float, ...]) -> ShapeReconstruction:
    """Balls (x, y, z, log-radius, log-contrast) in 0.2 MPa."""
    field = ShapeField(ShapePrior.of(MESH, 0.2), (BALL,) * len(balls))
    z = field.standard(np.concatenate([[np.log(0.2)], *balls]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), np.eye(len(z)))
    return ShapeReconstruction(field, z, posterior, 1.0, (50.0,) * len(balls), 50.0)


@pytest.fixture(scope="module")
def ball() -> ShapeReconstruction:
    return shapes_of((*CENTER, np.log(1.8), np.log(4.0)))


@pytest.fixture(scope="module")
def blocks(ball: ShapeReconstruction) -> list[np.ndarray]:
    """Derivatives of the data of patches at the middle, over the ball, and far from it."""
    plan = PressPlan(
        ("z+",),
        (0.01,),
        patch_radius_mm=1.8,
        patch_centers_mm=((5.0, 5.0, 10.0), (3.0, 5.0, 10.0), (8.0, 2.0, 10.0)),
    )
    recording = simulate(make_phantom("uniform_cube"), plan, mesh=MESH, snr_db=40.0)
    presses = tuple(
        replace(press, noise_mm=0.01 * float(np.std(press.displacement[press.observed])))
        for press in recording.presses
    )
    problem = InverseProblem(replace(recording, presses=presses))
    youngs = ball.youngs_at(MESH.centroids)
    jacobian = problem.evaluate(youngs).jacobian() * youngs
    return np.split(jacobian, problem.data.begins[1:])


def expected_error(shapes: ShapeReconstruction, jacobian: np.ndarray) -> float:
    """Expected error after one press."""
    (error,) = ShapeDesign(shapes, MESH, np.zeros((1, MESH.n_tets))).expected_errors([jacobian])
    return float(error)


def test_a_press_over_the_ball_tells_more_of_it(ball: Any, blocks: Any) -> None:
    middle, over, away = blocks
    design = ShapeDesign(ball, MESH, middle)
    errors = design.expected_errors([over, away, np.zeros_like(over), None])
    assert errors[0] < 0.8 * errors[1]
    assert errors[1] < errors[2]
    assert errors[3] == np.inf
    np.testing.assert_array_equal(design.expected_errors([over, away]), errors[:2])


def test_presses_that_tell_all_leave_no_error(ball: Any, blocks: Any) -> None:
    every = 1e5 * np.eye(MESH.n_tets)
    (error,) = ShapeDesign(ball, MESH, blocks[0]).expected_errors([every])
    assert error < 0.01


def test_the_error_of_a_uniform_body_is_that_of_its_modulus_and_of_lumps_not_seen() -> None:
    shapes = shapes_of()
    deviation = float(shapes.field.deviation[0])
    row = np.full((1, MESH.n_tets), 1.0 / MESH.n_tets)  # the mean log-modulus

    def error(signal: float) -> float:
        return expected_error(shapes, signal * row)

    # A uniform change explains all of a datum: lumps remain unseen whatever its noise.
    variance = deviation**2 / (1.0 + (10.0 * deviation) ** 2)
    missed = error(1e6)
    assert 0.0 < missed < 0.1 * np.log(3.0) ** 2
    assert error(10.0) - missed == pytest.approx(variance, rel=1e-6)
    assert expected_error(shapes, 1e6 * np.eye(MESH.n_tets)) < 1e-6


def test_unexplained_data_count_as_noise(ball: Any, blocks: Any) -> None:
    """Residuals of three deviations are noise of three deviations, for shapes and other lumps."""
    rough = replace(ball, chi2=9.0)
    assert expected_error(rough, 3.0 * blocks[0]) == pytest.approx(expected_error(ball, blocks[0]))
    assert expected_error(rough, blocks[0]) > expected_error(ball, blocks[0])


def state_of(blocks: Any, shapes: ShapeReconstruction | None) -> SamplingState:
    patches = [Patch(np.array(c), np.array([0.0, 0.0, -1.0]), 1.8) for c in np.eye(3)]
    halved = [0.5 * block for block in blocks]  # by parameters of twice the log-modulus
    return SamplingState(
        MESH, patches, (0,), Log(), np.ones((1, MESH.n_tets)),
        lambda indices: [halved[i] for i in indices], None, halved[0],
        np.full(MESH.n_tets, 2.0), shapes,
    )  # fmt: skip


def test_the_rule_takes_the_press_of_the_smallest_error(ball: Any, blocks: Any) -> None:
    middle, over, away = blocks
    assert ExpectedShapeError().choose(state_of([middle, over, away], ball)) == 1
    assert ExpectedShapeError().choose(state_of([middle, away, over], ball)) == 2
    with pytest.raises(ConfigError, match="needs shapes"):
        ExpectedShapeError().choose(state_of(blocks, None))


def test_the_position_is_best_known_after_a_press_over_the_ball(ball: Any, blocks: Any) -> None:
    middle, over, away = blocks
    design = ShapeDesign(ball, MESH, middle)
    deviations = design.expected_center_deviations([over, away, np.zeros_like(over), None])
    assert deviations[0] < 0.8 * deviations[1]
    assert deviations[1] < deviations[2] < deviations[3] == np.inf
    # With all information, the centre is known.
    (known,) = design.expected_center_deviations([1e5 * np.eye(MESH.n_tets)])
    assert known < 0.01
    assert LumpPosition().choose(state_of([middle, away, over], ball)) == 2


def test_before_a_lump_is_found_the_place_that_shows_most_lumps_is_pressed(blocks: Any) -> None:
    middle, over, _ = blocks
    design, nothing = ShapeDesign(shapes_of(), MESH, middle), np.zeros_like(over)
    some, same, none = design.expected_missed_errors([over, nothing, None])
    assert some < same < none == np.inf
    assert LumpPosition().choose(state_of([middle, nothing, over], shapes_of())) == 2
    with pytest.raises(ConfigError, match="needs shapes"):
        LumpPosition().choose(state_of(blocks, None))
