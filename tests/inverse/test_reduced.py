"""Agreement of the reduced model with the full one, by contrast, size and deformation."""

import numpy as np
import pytest

from tactorch.inverse import InverseProblem
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

_MPA = 0.2


@pytest.fixture(scope="module")
def problems() -> dict[float, tuple[InverseProblem, ReducedProblem]]:
    """Presses of a cube of 1,715 tetrahedra, by pressure (MPa), without springs that dominate."""

    def make(pressure: float) -> tuple[InverseProblem, ReducedProblem]:
        mesh, plan = box_mesh(10.0, 7, tets_per_cell=5), PressPlan(("z+", "x+"), (pressure,))
        recording: Recording = simulate(make_phantom("cube_sphere"), plan, mesh=mesh, samples=2)
        problem = InverseProblem(recording)
        return problem, ReducedProblem.about_uniform(problem, _MPA)

    return {pressure: make(pressure) for pressure in (0.001, 0.02)}


def youngs(problem: InverseProblem, contrast: float, radius: float) -> np.ndarray:
    """Return moduli of a uniform cube with a ball, MPa."""
    mesh = problem.recording.mesh
    apart = np.linalg.norm(mesh.centroids - [5.0, 5.0, 6.0], axis=1)
    fractions = np.clip(0.5 + (radius - apart) / np.cbrt(mesh.volumes), 0.0, 1.0)
    return np.asarray(_MPA * contrast**fractions)


# The change of the data by a ball: contrast, radius (mm), pressure (MPa), and the largest error
# over the change, as it is and after the best factor.
@pytest.mark.parametrize(
    ("contrast", "radius", "pressure", "error", "scaled"),
    [
        (1.5, 2.0, 0.001, 0.03, 0.02),
        (5.0, 2.0, 0.001, 0.07, 0.06),
        (5.0, 3.0, 0.001, 0.25, 0.09),
        (0.3, 2.0, 0.001, 0.15, 0.04),
        (5.0, 2.0, 0.02, 0.12, 0.09),
    ],
)
def test_agreement_with_the_full_model(
    problems: dict[float, tuple[InverseProblem, ReducedProblem]],
    contrast: float,
    radius: float,
    pressure: float,
    error: float,
    scaled: float,
) -> None:
    full, reduced = problems[pressure]
    moduli = youngs(full, contrast, radius)
    uniform = full.evaluate(np.full(full.n_elements, _MPA))
    ends = [np.concatenate(p.evaluate(moduli).predicted) for p in (full, reduced)]
    exact, found = (end - np.concatenate(uniform.predicted) for end in ends)
    factor = float(exact @ found / (found @ found))
    size = np.linalg.norm(exact)
    assert np.linalg.norm(found - exact) / size < error
    assert np.linalg.norm(factor * found - exact) / size < scaled


def test_derivatives_are_those_of_its_predictions(
    problems: dict[float, tuple[InverseProblem, ReducedProblem]],
) -> None:
    full, reduced = problems[0.02]
    moduli, rng = youngs(full, 3.0, 2.5), np.random.default_rng(0)
    change, weights = rng.standard_normal(len(moduli)), rng.standard_normal(full.n_data)
    at = reduced.evaluate(moduli)
    ends = [reduced.evaluate(moduli + s * 1e-3 * change).residuals for s in (1.0, -1.0)]
    numerical = (ends[0] - ends[1]) / 2e-3
    scale = np.abs(numerical).max()
    np.testing.assert_allclose(at.jacobian_times(change), numerical, rtol=0, atol=2e-3 * scale)
    np.testing.assert_allclose(at.jacobian() @ change, numerical, rtol=0, atol=2e-3 * scale)
    product = float(weights @ at.jacobian_times(change))
    assert float(at.transpose_times(weights) @ change) == pytest.approx(product, rel=1e-4)
    # At the uniform body they are those of the full model.
    uniform = np.full(full.n_elements, _MPA)
    expected = full.evaluate(uniform).jacobian_times(change)
    found = reduced.evaluate(uniform).jacobian_times(change)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_changes_of_a_stiff_ball_are_those_about_it(
    problems: dict[float, tuple[InverseProblem, ReducedProblem]],
) -> None:
    full, about_uniform = problems[0.001]
    ball, stiffer = (full.evaluate(youngs(full, contrast, 2.0)) for contrast in (10.0, 20.0))
    change = np.concatenate(stiffer.predicted) - np.concatenate(ball.predicted)
    errors = []
    for reduced in (about_uniform, ReducedProblem(full, ball)):
        ends = [np.concatenate(reduced.evaluate(e.youngs).predicted) for e in (ball, stiffer)]
        errors.append(np.linalg.norm(ends[1] - ends[0] - change) / np.linalg.norm(change))
    assert errors[1] < 0.5
    assert errors[1] < 0.25 * errors[0]
