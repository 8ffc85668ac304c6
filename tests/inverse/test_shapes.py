"""Inclusions as shapes: field, derivatives, evidence and search."""

import numpy as np
import pytest
import scipy.integrate

from tactorch.inverse.objective import Objective
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.shapes import find_shapes
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapesOnSites, fit_shapes
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 4, tets_per_cell=5)
PLAN = PressPlan(("z+", "x+"), (0.01, 0.02))


@pytest.fixture(scope="module")
def recording():
    """Presses on a ball of radius 2.5 mm and 1 MPa at (5, 5, 6) mm, from a finer other mesh."""
    phantom = make_phantom("cube_sphere", depth=0.4, radius=0.25)
    fine = phantom.mesh(1.6, conforming=True)
    return simulate(phantom, PLAN, mesh=MESH, fine_mesh=fine, element="tet10", snr_db=40.0)


@pytest.fixture(scope="module")
def uniform_recording():
    """Presses on a body without an inclusion."""
    phantom = make_phantom("uniform_cube")
    return simulate(phantom, PLAN, mesh=MESH, element="tet10", snr_db=30.0)


@pytest.fixture(scope="module")
def problem(recording):
    return InverseProblem(recording, element="tet10")


PRIOR = ShapePrior.of(MESH, 0.2)
VALUES = {
    False: [np.log(0.2), 5.0, 4.6, 5.7, np.log(2.2), 1.2],
    True: [np.log(0.2), 5.0, 4.6, 5.7, np.log(2.2), 1.2, 0.2, -0.1, 0.1, -0.2, 0.15],
}


@pytest.mark.parametrize("distorted", [False, True])
def test_the_jacobian_is_that_of_the_field(problem, distorted):
    field = ShapeField(PRIOR, (distorted,))
    sites, z = Sites.of(problem.body.assembly), field.standard(np.array(VALUES[distorted]))
    jacobian = field.jacobian(z, sites)
    assert np.abs(jacobian).max(axis=0).min() > 1e-2  # else the test shows nothing
    for k, step in enumerate(1e-5 * np.eye(field.size)):
        slope = (field.log_youngs(z + step, sites) - field.log_youngs(z - step, sites)) / 2e-5
        np.testing.assert_allclose(jacobian[:, k], slope, atol=1e-7)


@pytest.mark.parametrize("distorted", [False, True])
def test_the_field_integrates_to_the_volume_of_the_inclusion(problem, distorted):
    field, assembly = ShapeField(PRIOR, (distorted,)), problem.body.assembly
    z = field.standard(np.array(VALUES[distorted]))
    excess = field.log_youngs(z, Sites.of(assembly)) - np.log(0.2)
    volume = float(excess @ assembly.weights.ravel()) / 1.2
    (shape,) = field.shapes(z)
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * np.prod(shape.semi_axes_mm), rel=0.02)


def test_an_ellipsoid_is_where_its_axes_say():
    field = ShapeField(PRIOR, (True,))
    z = field.standard(np.array(VALUES[True]))
    (shape,) = field.shapes(z)
    axes, semi = np.array(shape.axes), np.array(shape.semi_axes_mm)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert list(semi) == sorted(semi, reverse=True)
    assert semi[0] > 1.2 * semi[2]
    for direction, length in zip(axes, semi, strict=True):
        ends = shape.center_mm + np.outer([0.99, 1.01], length * direction)
        inside, outside = field.log_youngs(z, Sites.at(ends)) - np.log(0.2)
        assert inside == pytest.approx(1.2)
        assert outside == pytest.approx(0.0)


def test_residuals_follow_the_parameters(problem):
    field = ShapeField(PRIOR, (True,))
    objective = Objective(
        problem, ShapesOnSites(field, Sites.of(problem.body.assembly)), weight=1.0
    )
    z = field.standard(np.array(VALUES[True]))
    point = objective.at(z)
    for k in (0, 2, 4, 5, 7):
        step = 1e-4 * np.eye(field.size)[k]
        ends = [objective.at(z + s * step).evaluation.residuals for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-4
        np.testing.assert_allclose(point.jacobian[:, k], slope, atol=1e-4 * np.abs(slope).max())


def test_the_evidence_is_the_integral_of_the_likelihood(problem):
    """One parameter: the Laplace approximation against quadrature."""
    field = ShapeField(ShapePrior.of(MESH, 0.22), ())
    sites = Sites.of(problem.body.assembly)
    fit = fit_shapes(problem, field, np.zeros(1), sites=sites, tolerance=1e-10)
    objective, deviation = (
        Objective(problem, ShapesOnSites(field, sites), weight=1.0),
        np.sqrt(fit.covariance[0, 0]),
    )
    z = fit.z[0] + deviation * np.linspace(-5.0, 5.0, 21)
    least = objective.at(fit.z).value(1.0)
    heights = [np.exp(least - objective.at(np.array([x])).value(1.0)) for x in z]
    integral = np.log(scipy.integrate.simpson(heights, x=z)) - least - 0.5 * np.log(2.0 * np.pi)
    assert fit.log_evidence() == pytest.approx(integral, abs=0.05)


def test_a_ball_is_found_with_its_modulus(recording):
    search = find_shapes(recording, max_shapes=2)
    (shape,) = search.best.shapes
    assert np.linalg.norm(np.array(shape.center_mm) - [5.0, 5.0, 6.0]) < 0.2
    assert shape.radius_mm == pytest.approx(2.5, rel=0.1)
    assert shape.contrast == pytest.approx(5.0, rel=0.3)
    assert search.probability > 0.999
    inside, outside = search.best.youngs_at(np.array([[5.0, 5.0, 6.0], [1.0, 1.0, 1.0]]))
    assert inside / outside == pytest.approx(shape.contrast)


def test_nothing_is_found_in_a_uniform_body(uniform_recording):
    search = find_shapes(uniform_recording, max_shapes=2)
    assert search.best.shapes == []
    assert search.probability < 0.5
