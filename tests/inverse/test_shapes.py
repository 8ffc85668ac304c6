"""Inclusions as shapes: field, derivatives, evidence and presses."""

import json
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import scipy.integrate

from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.fem import ELEMENTS, Newton, NewtonOptions
from tactorch.inverse.errors import ERRORS, ErrorModel, MeasuredPresses
from tactorch.inverse.errors.discrepancy import Discrepancy
from tactorch.inverse.fields import (
    BALL,
    ELLIPSOID,
    Background,
    InclusionShape,
    ShapeField,
    ShapePrior,
    Sites,
)
from tactorch.inverse.fields.inclusion import Parameters
from tactorch.inverse.fields.sites import samples_around
from tactorch.inverse.fit import shapes as shape_fit
from tactorch.inverse.fit.objective import Objective
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.result.build import of_inclusions
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search import correction as correction_module
from tactorch.inverse.search import find_shapes
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.correction import Correction, _LoadSeries
from tactorch.inverse.search.model import (
    Model,
    Start,
    less,
    make_posterior,
    varied,
    with_family,
)
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.proposals import changed, joined
from tactorch.inverse.search.search import _first
from tactorch.inverse.search.sizing import (
    Rim,
    contact_sizing,
    inclusion_sizing,
    observed_sizing,
    sharp_edge_sizing,
)
from tactorch.mesh import Ellipsoid, Rotated, box_mesh, face_nodes
from tactorch.phantoms import make_phantom
from tactorch.recording import GelReading, refine_recording
from tactorch.sensor.description import GelLayer
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 4, tets_per_cell=5)
PLAN = PressPlan(("z+", "x+"), (0.01, 0.02))


@pytest.fixture(scope="module")
def recording():
    """Presses on a ball of radius 2.5 mm and 1 MPa at (5, 5, 6) mm, from a finer other mesh."""
    phantom = make_phantom("cube_sphere", depth=0.4, radius=0.25)
    fine = box_mesh(10.0, 7, tets_per_cell=5)
    return simulate(
        phantom, PLAN, mesh=MESH, fine_mesh=fine, element="tet10", samples=4, snr_db=40.0
    )


@pytest.fixture(scope="module")
def found(recording):
    """Shapes of the recording."""
    return find_shapes(recording, max_shapes=2)


@pytest.fixture(scope="module")
def uniform_recording():
    """Presses on a body without an inclusion."""
    phantom = make_phantom("uniform_cube")
    return simulate(phantom, PLAN, mesh=MESH, element="tet10", snr_db=30.0)


@pytest.fixture(scope="module")
def problem(recording):
    return InverseProblem(recording, element="tet10")


@pytest.fixture(scope="module")
def sites(problem):
    return Sites.of(problem.body.assembly)


PRIOR = ShapePrior.of(MESH, 0.2)
VALUES = {
    "ball": [np.log(0.2), 5.0, 4.6, 5.7, np.log(2.2), 1.2],
    "ellipsoid": [np.log(0.2), 5.0, 4.6, 5.7, np.log(2.2), 1.2, 0.2, -0.1, 0.1, -0.2, 0.15],
}


def test_samples_are_evenly_around_the_quadrature_points():
    rule = ELEMENTS["tet10"].points
    groups = samples_around(rule).reshape(len(rule), -1, 4)
    for k, group in enumerate(groups):
        distance = ((group[:, None] - rule) ** 2).sum(axis=2)
        np.testing.assert_allclose(distance[:, k], distance.min(axis=1))
        # The same for each point, but for the order of the corners.
        own, others = group[:, k].mean(), np.delete(group, k, axis=1).mean(axis=0)
        assert own == pytest.approx(groups[0][:, 0].mean())
        np.testing.assert_allclose(others, (1.0 - own) / 3.0)
    np.testing.assert_allclose(groups.mean(axis=(0, 1)), 0.25)


def test_the_geometry_of_a_rotated_ellipsoid_is_where_the_shape_is():
    radii, center = np.array([2.0, 1.2, 0.8]), np.array([5.0, 4.0, 6.0])
    shape = Rotated(Ellipsoid(tuple(center), tuple(radii)), (20.0, 50.0, -70.0))
    turn = shape.matrix()
    own = Parameters.of(ELLIPSOID.values(center, turn @ np.diag(np.log(radii)) @ turn.T, 1.0))
    assert np.exp(own.log_radius) == pytest.approx(np.cbrt(radii.prod()))
    points = center + np.random.default_rng(0).uniform(-2.5, 2.5, (5000, 3))
    inside = ELLIPSOID.fraction(own, points[:, None], np.zeros(len(points)))
    np.testing.assert_array_equal(inside > 0.5, shape.contains(points))
    assert inside.mean() == pytest.approx(4.0 / 3.0 * np.pi * radii.prod() / 5.0**3, rel=0.1)


def test_an_ellipsoid_is_where_its_axes_say():
    field = ShapeField(PRIOR, (ELLIPSOID,))
    z = field.standard(np.array(VALUES["ellipsoid"]))
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


def test_a_smooth_background_varies_by_its_modes():
    field = ShapeField(PRIOR, (), Background(degree=2))
    assert field.size == field.n_background == 10
    values = np.zeros(10)
    values[0] = np.log(0.2)
    points = np.random.default_rng(0).uniform(0.0, 10.0, (20, 3))
    modes = field.background.jacobian(PRIOR, values, Sites.at(points))[:, 1:]
    for k in range(1, 10):
        values[k] = 0.3
        expected = np.log(0.2) + 0.3 * modes[:, k - 1]
        found = field.log_youngs(field.standard(values), Sites.at(points))
        np.testing.assert_allclose(found, expected, atol=1e-12)
        shared = np.tile(values, (len(points), 1))
        np.testing.assert_allclose(field.log_background(shared, points), expected)
        values[k] = 0.0
    ends = Sites.at(np.array([[5.0, 5.0, 0.0], [5.0, 5.0, 10.0]]))
    along_z = field.background.jacobian(PRIOR, values, ends)[:, 1:]
    assert np.any(np.isclose(along_z[0], 1.0) & np.isclose(along_z[1], -1.0))


def test_a_background_of_degree_one_is_linear():
    """Cosines of any degree have no slope at the sides, and inclusions would stand for it."""
    field = ShapeField(PRIOR, (), Background(degree=1))
    assert field.size == 4
    values = np.array([np.log(0.2), 0.1, -0.2, 0.3])
    points = np.random.default_rng(1).uniform(0.0, 10.0, (30, 3))
    logs = field.log_youngs(field.standard(values), Sites.at(points))
    plane = np.column_stack([np.ones(30), points])
    residual = np.linalg.lstsq(plane, logs, rcond=None)[1]
    np.testing.assert_allclose(residual, 0.0, atol=1e-20)
    assert np.ptp(logs) > 0.3


def test_a_smooth_background_of_an_earlier_version_is_refused():
    plain = ShapeField(PRIOR, (), Background(degree=2)).plain()
    del plain["smooth"]
    with pytest.raises(ConfigError, match="earlier version"):
        ShapeField.of(plain)
    plain["degree"] = 0
    assert ShapeField.of(plain).background.degree == 0


def test_a_background_has_steps_at_planes():
    background = Background(degree=2, steps=("z-", "x+", "z-"))
    assert len(set(background.parameters)) == background.step_at(2).stop == 1 + 9 + 6
    field = ShapeField(PRIOR, (), Background(steps=("z-", "x+", "z-")))
    values = np.array([np.log(0.2), 4.0, 0.5, 7.0, -0.3, 2.0, 1.0])
    points = np.random.default_rng(0).uniform(0.0, 10.0, (200, 3))
    x, _, z = points.T
    expected = np.log(0.2) + 0.5 * (z < 4.0) - 0.3 * (x > 7.0) + 1.0 * (z < 2.0)
    found = field.log_youngs(field.standard(values), Sites.at(points))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    places = np.tile(values, (200, 1))
    places[:, 1] = z + np.where(np.arange(200) % 2, 0.1, -0.1)  # of each draw its own
    draws = field.log_background(places, points)
    np.testing.assert_allclose(draws - expected + 0.5 * (z < 4.0), 0.5 * (np.arange(200) % 2))


def test_files_hold_the_steps_of_a_background():
    field = ShapeField(PRIOR, (), Background(degree=2, steps=("z-", "x+")))
    assert ShapeField.of(json.loads(json.dumps(field.plain()))).background == field.background
    plain = field.plain()
    del plain["steps"]  # as in files of earlier versions
    assert ShapeField.of(plain).background.steps == ()
    with pytest.raises(ConfigError, match="earlier version"):
        ShapeField.of(plain | {"layers": [0, 0, 3]})


def test_derivatives_of_steps_are_those_of_the_modulus(sites):
    field = ShapeField(PRIOR, (BALL,), Background(degree=1, steps=("z-", "x+")))
    steps = [4.1, 0.5, 7.2, -0.3]
    own = [np.log(0.2), 0.1, 0.2, -0.1, *steps, *VALUES["ball"][1:]]
    z = field.standard(np.array(own))
    assert_derivatives(field, z, sites)


OVERLAPPING = [*VALUES["ball"][1:], 6.2, 5.1, 5.3, np.log(2.0), 1.0]


def assert_derivatives(field, z, sites):
    jacobian = field.jacobian(z, sites)
    assert np.abs(jacobian).max(axis=0).min() > 1e-2  # else the test shows nothing
    for k, step in enumerate(1e-5 * np.eye(field.size)):
        slope = (field.log_youngs(z + step, sites) - field.log_youngs(z - step, sites)) / 2e-5
        np.testing.assert_allclose(jacobian[:, k], slope, atol=1e-6)


@pytest.mark.parametrize("contrasts", [(1.2, 1.0), (0.7, 1.0), (-0.5, -0.8), (1.2, -0.6)])
def test_derivatives_where_inclusions_overlap(sites, contrasts):
    field, own = ShapeField(PRIOR, (BALL, BALL)), np.array([np.log(0.2), *OVERLAPPING])
    own[[5, 10]] = contrasts
    assert_derivatives(field, field.standard(own), sites)


def test_inclusions_that_overlap_are_not_stiffer_than_the_stiffer_one():
    field, own = ShapeField(PRIOR, (BALL, BALL)), np.array([np.log(0.2), *OVERLAPPING])
    middle = Sites.at(np.array([[5.6, 4.85, 5.5]]))

    def contrast(*logs: float) -> float:
        own[[5, 10]] = logs
        (mean,) = field.mean_youngs(field.standard(own), middle)
        (log,) = field.log_youngs(field.standard(own), middle)
        assert np.log(mean) == pytest.approx(log)
        return log - np.log(0.2)

    assert contrast(1.2, 1.0) == contrast(1.0, 1.2) == pytest.approx(1.2)
    assert contrast(-0.5, -0.8) == pytest.approx(-0.8)
    assert contrast(1.2, -0.5) == pytest.approx(0.7)


def test_models_are_changed_without_a_change_of_what_remains():
    """Modes and ellipsoids that are added start at the same map; removals leave the others."""
    field = ShapeField(PRIOR, (ELLIPSOID, BALL), Background(steps=("z-", "x+")))
    rng = np.random.default_rng(0)
    z = 0.3 * rng.standard_normal(field.size)
    sites = Sites.at(rng.uniform(0.0, 10.0, (200, 3)))
    before = field.log_youngs(z, sites)
    for other, same in (
        varied(field, z, degree=2),
        with_family(field, z, 1, ELLIPSOID),
    ):
        assert other.size > field.size
        np.testing.assert_allclose(other.log_youngs(same, sites), before, atol=1e-12)
    model = Mock(spec=Model, fit=Mock(spec=ShapeFit, field=field, z=z), errors={})
    start = less(model, [0])
    fewer, rest = start.field, start.z
    assert fewer.families == (BALL,)
    first, second = field.shapes(z)
    assert list(fewer.shapes(rest)) == [second]
    outside = ~first.contains(sites.centers)
    np.testing.assert_allclose(fewer.log_youngs(rest, sites)[outside], before[outside])


def test_inclusions_are_tried_as_other_forms_and_as_one():
    """Neighbours that are both stiffer are joined, but not as an irregular lump."""
    families = (BALL, ELLIPSOID, BALL, BALL)
    field = ShapeField(PRIOR, families)
    ball = [np.log(1.5), np.log(4.0)]
    values = [np.log(0.2), 3.0, 3.0, 5.0, *ball, 6.0, 3.0, 5.0, *ball, 0.2, 0.1, 0.0, 0.0, 0.0]
    values += [4.5, 4.0, 5.0, np.log(1.5), -1.0, 4.0, 9.0, 9.0, np.log(0.4), 1.0]
    model = Mock(spec=Model, errors={})
    model.fit = Mock(spec=ShapeFit, field=field, z=field.standard(np.array(values)))
    problem = Mock(spec=SearchProblem, forms=("ellipsoid", "ring", "irregular lump"))
    starts = {start.what: start for start in [*changed(problem, model), *joined(problem, model)]}
    assert set(starts) == {
        *(f"inclusion {k} as an ellipsoid" for k in (0, 2, 3)),
        *(f"inclusion {k} as a ring" for k in range(4)),
        *(f"inclusion {k} as an irregular lump" for k in range(4)),
        "inclusion 0 and 1 as an ellipsoid", "inclusion 0 and 1 as a ring",
    }  # fmt: skip
    start = starts["inclusion 0 and 1 as an ellipsoid"]
    assert start.field.families == (BALL, BALL, ELLIPSOID)
    *others, one = start.field.shapes(start.z)
    first, second, *kept = field.shapes(model.fit.z)
    assert others == kept
    assert one.radius_mm**3 == pytest.approx(first.radius_mm**3 + second.radius_mm**3)
    assert one.center_mm == pytest.approx((4.5, 3.0, 5.0), abs=0.1)
    assert one.contrast == pytest.approx(4.0)
    assert one.semi_axes_mm[0] > 2.5
    assert abs(one.axes[0][0]) == pytest.approx(1.0, abs=0.01)


def test_other_errors_differ_in_one_respect(problem):
    nothing = [np.zeros(count) for count in problem.data.counts]
    errors = ErrorModel(MeasuredPresses(problem, corrections_mm=nothing), ERRORS)
    assert errors.least == {"discretisation": 0.3, "pose": 0.001}
    present = {**errors.least, "forces": 0.05}
    others = dict(errors.others(present))
    assert {e.get("forces", 0.0) for e in others.values()} == {0.0, 0.02, 0.05, 0.1}
    assert {e["pose"] for e in others.values()} == {0.001, 0.002, 0.01, 0.05}
    for other in others.values():
        names = present.keys() | other.keys()
        assert sum(present.get(name) != other.get(name) for name in names) == 1
    assert {e.get("discrepancy", 0.0) for e in others.values()} == {0.0, *Discrepancy.levels}
    assert set(others) >= {"forces wrong by 0%", "poses wrong by 0.2%"}


def test_distance_and_inside_agree():
    (shape,) = ShapeField(PRIOR, (ELLIPSOID,)).shapes(
        ShapeField(PRIOR, (ELLIPSOID,)).standard(np.array(VALUES["ellipsoid"]))
    )
    points = np.random.default_rng(1).uniform(0.0, 10.0, (500, 3))
    inside = shape.contains(points)
    assert 0 < inside.sum() < 500
    np.testing.assert_array_equal(shape.distance(points) <= 0.0, inside)


@pytest.mark.parametrize("degree", [0, 2])
def test_residuals_follow_the_parameters(problem, sites, degree):
    field = ShapeField(PRIOR, (ELLIPSOID,), Background(degree))
    objective = Objective(problem, ShapesOnSites(field, sites), weight=1.0)
    values = VALUES["ellipsoid"]
    modes = [0.1] * (field.n_background - 1)
    z = field.standard(np.array([values[0], *modes, *values[1:]]))
    point = objective.at(z)
    for k in {0, 1, 2, 4, 5, 7, field.size - 1}:
        step = 1e-4 * np.eye(field.size)[k]
        ends = [objective.at(z + s * step).evaluation.residuals for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-4
        np.testing.assert_allclose(point.jacobian[:, k], slope, atol=1e-4 * np.abs(slope).max())
    rng = np.random.default_rng(0)
    change, weights = rng.normal(size=field.size), rng.normal(size=len(point.jacobian))
    np.testing.assert_allclose(point.jacobian_times(change), point.jacobian @ change, rtol=1e-7)
    np.testing.assert_allclose(point.transpose_times(weights), point.jacobian.T @ weights)
    np.testing.assert_allclose(point.penalty_gradient, z)


def test_a_field_without_second_derivative_says_so(problem, sites):
    point = Objective(problem, ShapesOnSites(ShapeField(PRIOR), sites), weight=1.0).at(np.zeros(1))
    with pytest.raises(ConfigError, match="one modulus per element"):
        point.second_order_times(np.ones(1))
    with pytest.raises(ConfigError, match="one modulus per element"):
        _ = point.objective.elements


def test_the_evidence_is_the_integral_of_the_likelihood(problem, sites):
    """One parameter: the Laplace approximation against quadrature."""
    field = ShapeField(ShapePrior.of(MESH, 0.22))
    fit, _ = fit_shapes(problem, field, np.zeros(1), sites=sites, tolerance=1e-10)
    objective = Objective(problem, ShapesOnSites(field, sites), weight=1.0)
    deviation = np.sqrt(fit.covariance[0, 0])
    z = fit.z[0] + deviation * np.linspace(-5.0, 5.0, 13)
    least = objective.at(fit.z).value(1.0)
    heights = [np.exp(least - objective.at(np.array([x])).value(1.0)) for x in z]
    integral = np.log(scipy.integrate.simpson(heights, x=z)) - least - 0.5 * np.log(2.0 * np.pi)
    assert fit.log_evidence() == pytest.approx(integral, abs=0.05)


def test_a_ball_is_found_with_its_modulus(found):
    result, (inclusion,) = found, found.inclusions
    shape = inclusion.shape
    assert np.linalg.norm(np.array(shape.center_mm) - [5.0, 5.0, 6.0]) < 0.2
    assert shape.radius_mm == pytest.approx(2.5, rel=0.1)
    low, high = np.log(inclusion.youngs_90_mpa)
    assert abs(np.log(inclusion.youngs_mpa / 1.0)) < 3.0 * (high - low) / 3.29
    assert high - low < np.log(3.0)
    assert inclusion.background_mpa == pytest.approx(0.2, rel=0.03)
    assert inclusion.youngs_90_mpa.low < inclusion.youngs_mpa < inclusion.youngs_90_mpa.high
    assert inclusion.radius_90_mm.low < shape.radius_mm < inclusion.radius_90_mm.high
    assert result.probability > 0.999
    assert result.force_deviation == 0.0
    assert result.pose_deviation == 0.001
    assert result.unexplained < 0.01
    assert result.history[0]["model"] == "uniform"
    inside, outside = result.youngs_at(np.array([[5.0, 5.0, 6.0], [1.0, 1.0, 1.0]]))
    assert inside == pytest.approx(inclusion.youngs_mpa)
    assert outside == pytest.approx(inclusion.background_mpa)
    deviation = result.log_deviation_at(np.array([[5.0, 5.0, 6.0], [1.0, 1.0, 1.0]]))
    assert deviation[0] > deviation[1] > 0.0
    again = ShapeReconstruction.of(json.loads(json.dumps(result.plain())))
    assert again.inclusions == result.inclusions
    assert again.plain() == result.plain()


@pytest.mark.slow
def test_a_sensor_that_is_not_fitted_leaves_the_whole_posterior(recording, found, caplog):
    """Not all presses have markers of a gel."""
    layer, still = GelLayer(4.0, 0.12, 0.45, size_mm=(16.0, 16.0)), np.zeros((9, 2))
    gel = GelReading(
        layer.numbers, np.eye(4), np.eye(4), still + np.arange(9)[:, None], still,
        np.full(9, 1e-3), np.array([0.03, 0.01, 1e-3]),
    )  # fmt: skip
    first, *others = recording.presses
    some = replace(recording, presses=(replace(first, gel=gel), *others))
    result = find_shapes(some, max_shapes=2)
    assert "have no markers of a gel" in caplog.text
    assert [entry["model"] for entry in result.history] == [e["model"] for e in found.history]
    assert len(result.posterior.ridges) == len(found.posterior.ridges)
    (inclusion,), (expected,) = result.inclusions, found.inclusions
    assert inclusion.youngs_90_mpa.low == pytest.approx(expected.youngs_90_mpa.low, rel=0.02)
    assert inclusion.youngs_90_mpa.high == pytest.approx(expected.youngs_90_mpa.high, rel=0.02)


@pytest.mark.slow
def test_a_search_continues_from_the_model_of_other_presses(recording, found):
    """It does not start from a uniform body, and keeps what the other presses showed."""
    fewer = replace(recording, presses=recording.presses[2:])
    result = find_shapes(fewer, max_shapes=1, start=found)
    assert result.history[0]["model"] == "the model before"
    assert result.history[0]["chi2"] < 2.0
    (inclusion,) = result.inclusions
    assert np.linalg.norm(np.array(inclusion.shape.center_mm) - [5.0, 5.0, 6.0]) < 0.3
    assert inclusion.shape.radius_mm == pytest.approx(2.5, rel=0.1)


@pytest.mark.slow
def test_a_start_that_the_presses_contradict_is_removed(uniform_recording):
    """A ball of an earlier search is not kept where further presses show none."""
    nothing = find_shapes(uniform_recording, max_shapes=2)
    field = replace(nothing.field, families=(BALL,))
    values = np.array([np.log(0.2), 4.0, 5.0, 6.0, np.log(2.0), np.log(2.0)])
    ball = replace(nothing, field=field, z=field.standard(values))
    result = find_shapes(uniform_recording, max_shapes=2, start=ball)
    assert [entry["model"] for entry in result.history[:2]] == [
        "the model before", "inclusion 0 removed",
    ]  # fmt: skip
    assert result.inclusions == []


@pytest.mark.slow
def test_a_background_that_varies_gives_way_to_inclusions(recording, found):
    """A varying background is not kept beside a ball that explains as much."""
    field, z = varied(found.field, found.z, degree=2)
    start = Start("before", field, z, {"pose": 0.001})
    result = find_shapes(recording, max_shapes=1, start=start)
    assert result.history[1]["model"] == "background of degree 0"
    assert result.field.background.degree == 0
    assert len(result.inclusions) == 1


def test_a_search_starts_from_a_uniform_body_rather_than_from_a_background_alone(
    uniform_recording,
):
    problem = ShapeProblem(uniform_recording, Settings())
    field = ShapeField(problem.prior, background=Background(degree=2))
    state = Start("before", field, np.full(field.size, 0.5), {"pose": 0.001})
    model, path = _first(problem, state)
    assert path.history[0]["model"] == "uniform"
    assert model.fit.field.background.degree == 0


def test_a_search_can_be_stopped(recording):
    calls = []

    def stop():
        calls.append(None)
        return len(calls) > 3

    with pytest.raises(CancelledError, match="stopped before it had a result"):
        find_shapes(recording, max_shapes=1, stop=stop)
    assert len(calls) == 4


def test_ctrl_c_ends_a_search_with_the_last_accepted_model(uniform_recording, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("tactorch.inverse.search.search.propose", interrupted)
    result = find_shapes(uniform_recording)
    assert result.ended == "interrupted"
    assert [record["model"] for record in result.history] == ["uniform", "final fit"]


def test_a_time_limit_ends_a_search_with_the_last_accepted_model(recording, monkeypatch):
    challenge, clock = ShapeProblem.challenge, SimpleNamespace(now=0.0)

    def late(self, *arguments, **named):
        clock.now = 100.0
        return challenge(self, *arguments, **named)

    monkeypatch.setattr(ShapeProblem, "challenge", late)
    times = SimpleNamespace(monotonic=lambda: clock.now)
    monkeypatch.setattr("tactorch.inverse.search.model.time", times)
    result = find_shapes(recording, Settings(max_seconds=50.0))
    assert result.ended == "time limit reached"
    assert [record["model"] for record in result.history] == ["uniform", "final fit"]
    assert result.untried[0].startswith("ball at [")
    warning = of_inclusions(recording, result, {}, 0.0).warnings[-1]
    assert f"Not tried any more: {result.untried[0]}" in warning


@pytest.mark.slow
def test_a_stopped_search_goes_on_from_what_it_reached(recording):
    first = []

    def stop():
        first.append(None)
        return len(first) > limit

    limit = 10**6
    expected = find_shapes(recording, max_shapes=1, stop=stop)
    count = len(first)
    first.clear()
    limit = count - 2  # in the final fit
    with pytest.raises(CancelledError) as stopped:
        find_shapes(recording, max_shapes=1, stop=stop)
    reached = stopped.value.reached
    assert reached.field.families == expected.field.families == (BALL,)
    rest = []
    result = find_shapes(
        recording, max_shapes=1, start=reached, stop=lambda: bool(rest.append(None))
    )
    assert [record["model"] for record in result.history] == ["the model before", "final fit"]
    assert len(rest) < 0.7 * count
    deviation = np.sqrt(np.diag(expected.posterior.covariance))[: len(result.z)]
    assert (np.abs(result.z - expected.z) < deviation).all()


@pytest.mark.slow
def test_a_search_that_is_stopped_in_its_posterior_has_reached_its_final_fit(
    recording, monkeypatch
):
    final = []

    def stopped(_problem, model):
        final.append(model)
        raise CancelledError("stopped")

    monkeypatch.setattr(ShapeProblem, "posterior", stopped)
    with pytest.raises(CancelledError) as error:
        find_shapes(recording, max_shapes=1)
    np.testing.assert_array_equal(error.value.reached.z, final[0].fit.z)


@pytest.mark.slow
def test_presses_without_noise_have_no_spurious_parts():
    """The error of the discretisation is not explained by further inclusions."""
    phantom = make_phantom("cube_sphere", depth=0.4, radius=0.25)
    fine = phantom.mesh(1.0, conforming=True)
    exact = simulate(phantom, PLAN, mesh=MESH, fine_mesh=fine, element="tet10")
    result = find_shapes(exact, max_shapes=3)
    (inclusion,) = result.inclusions
    assert inclusion.youngs_mpa == pytest.approx(1.0, rel=0.15)
    assert inclusion.shape.radius_mm == pytest.approx(2.5, rel=0.03)
    assert result.field.n_background == 1


@pytest.mark.slow
def test_layers_are_no_inclusions():
    phantom = make_phantom("cube_layers")
    fine = box_mesh(10.0, 7, tets_per_cell=5)
    recording = simulate(phantom, PLAN, mesh=MESH, fine_mesh=fine, element="tet10", snr_db=40.0)
    result = find_shapes(recording, max_shapes=2)
    assert result.inclusions == []
    assert {step.side[0] for step in result.steps} == {"z"}
    assert sorted(step.place_mm for step in result.steps) == pytest.approx(
        [10 / 3, 20 / 3], abs=0.5
    )
    heights = np.linspace(0.3, 9.7, 50)
    points = np.column_stack([np.full((50, 2), 5.0), heights])
    assert np.corrcoef(result.youngs_at(points), phantom.youngs_at(points))[0, 1] > 0.9


def test_nothing_is_found_in_a_uniform_body(uniform_recording):
    result = find_shapes(uniform_recording, max_shapes=2)
    assert result.inclusions == []
    assert result.probability == 0.0
    assert result.background_mpa == pytest.approx(0.2, rel=0.03)


def test_errors_of_the_forces_are_recognised(uniform_recording):
    """Forces of each press wrong by a tenth: no inclusion explains them."""
    rng = np.random.default_rng(0)
    presses = tuple(
        replace(press, forces=press.forces * np.exp(0.1 * rng.normal()))
        for press in uniform_recording.presses
    )
    result = find_shapes(replace(uniform_recording, presses=presses), max_shapes=2)
    assert result.force_deviation > 0.0
    assert result.inclusions == []


def test_errors_of_the_pose_are_recognised(uniform_recording):
    """Each contact is seen shifted and turned by a tenth of its displacement."""
    rng, presses, motions = np.random.default_rng(0), [], {}
    offsets = uniform_recording.mesh.points - [5.0, 5.0, 5.0]
    for press in uniform_recording.presses:
        place = press.observed.tobytes()
        if place not in motions:
            motions[place] = rng.normal(size=3) + np.cross(rng.normal(size=3) / 5.0, offsets)
        size = np.sqrt(np.mean(press.displacement[press.observed] ** 2))
        moved = press.displacement + 0.1 * size * motions[place]
        presses.append(replace(press, displacement=moved))
    result = find_shapes(replace(uniform_recording, presses=tuple(presses)), max_shapes=2)
    assert result.pose_deviation >= 0.01
    assert result.inclusions == []
    assert result.background_mpa == pytest.approx(0.2, rel=0.1)
    assert ShapeReconstruction.of(result.plain()).errors == result.errors


def test_a_correction_that_fails_leaves_the_model(recording, monkeypatch, caplog):
    """The second correction fails: data and model are those of the first."""
    presses = ShapeProblem(recording, Settings())
    model = presses.uniform()
    calls = []

    def offsets(self, fit, evaluation, check):
        calls.append(fit)
        if len(calls) == 3:
            raise ConvergenceError("no equilibrium")
        return [np.full(len(o.index), 0.01 * len(calls)) for o in evaluation.data.observations]

    monkeypatch.setattr(Correction, "offsets", offsets)
    before = presses.full.data.observations[0].values
    corrected = presses.corrected(model)
    np.testing.assert_allclose(presses.full.data.observations[0].values, before - 0.01)
    corrected = presses.corrected(corrected)
    np.testing.assert_allclose(presses.full.data.observations[0].values, before - 0.02)
    assert presses.corrected(corrected) is corrected
    np.testing.assert_allclose(presses.full.data.observations[0].values, before - 0.02)
    assert "not corrected: no equilibrium" in caplog.text
    calls[:] = calls[:2]
    start = Start("shifted", corrected.fit.field, corrected.fit.z + 0.3, corrected.errors)
    shifted = presses.fit(start, corrected.evaluation.displacements, tolerance=np.inf)
    final = presses.final(shifted)  # fails too; fitted closely all the same
    np.testing.assert_allclose(final.fit.z, corrected.fit.z, atol=0.01)


def test_the_optimum_is_one_step_beyond_the_last_evaluated_parameters(problem, sites):
    field = ShapeField(PRIOR, (BALL,))
    start = field.standard(np.array(VALUES["ball"]))
    close, _ = fit_shapes(problem, field, start, sites=sites, tolerance=1e-6)
    deviations = np.sqrt(np.diag(close.covariance))
    shift = 0.6 * close.covariance[:, -1] / deviations[-1]  # a predicted fall of 0.18
    rough, _ = fit_shapes(problem, field, close.z + shift, sites=sites, max_iterations=0)
    before, after = (np.abs((z - close.z) / deviations).max() for z in (rough.z, rough.optimum))
    assert before == pytest.approx(0.6)
    # The objective is curved, and `close` ends where errors of equilibria hide a further descent.
    assert after < 0.5 * before
    far, _ = fit_shapes(problem, field, start, sites=sites, max_iterations=0)
    np.testing.assert_array_equal(far.optimum, far.z)  # the step is long


def test_a_step_that_does_not_lower_the_objective_is_not_added(problem, sites, monkeypatch):
    field = ShapeField(PRIOR, (BALL,))
    start = field.standard(np.array(VALUES["ball"]))
    rough, _ = fit_shapes(problem, field, start, sites=sites, tolerance=0.4)
    assert (rough.optimum != rough.z).any()

    def fails(*args: object) -> None:
        raise ConvergenceError("no equilibrium")

    monkeypatch.setattr(shape_fit._ShapeSteps, "moved", fails)
    refused, _ = fit_shapes(problem, field, rough.z, sites=sites, tolerance=1e-9)
    np.testing.assert_array_equal(refused.z, rough.z)
    np.testing.assert_array_equal(refused.optimum, refused.z)


def test_displacements_at_other_parameters_are_linearised(recording):
    presses = ShapeProblem(recording, Settings())
    model, errors = presses.uniform(), []
    for step in (0.02, 0.04):
        z = model.fit.z + step
        exact = presses.full.evaluate(ShapesOnSites(model.fit.field, presses.sites).at(z).youngs)
        pairs = zip(presses.displacements(model, z), exact.displacements, strict=True)
        errors.append(max(np.abs(a - b).max() for a, b in pairs))
        change = np.subtract(exact.displacements, model.evaluation.displacements)
        assert errors[-1] < step * np.abs(change).max()
    assert errors[0] < 0.3 * errors[1]


def test_meshes_are_refined_at_inclusions_and_small_contacts(recording):
    ball = InclusionShape((5.0, 5.0, 5.0), (2.0,) * 3, tuple(map(tuple, np.eye(3))), 5.0)
    lengths = inclusion_sizing([ball])(np.array([[5.0, 5.0, 7.1], [5.0, 5.0, 5.0], [5, 5, 9.0]]))
    assert lengths[0] < 1.1 < lengths[2]
    assert lengths[0] < lengths[1]
    assert np.isinf(inclusion_sizing([])(np.zeros((2, 3)))).all()
    assert refine_recording(recording, contact_sizing(recording)).mesh.n_tets == MESH.n_tets
    small = simulate(
        make_phantom("uniform_cube"),
        PressPlan(("z+",), (0.01,), patch_radius_mm=3.0),
        mesh=box_mesh(10.0, 8, tets_per_cell=5),
    )
    lengths = contact_sizing(small)(np.array([[7.5, 5.0, 9.8], [5.0, 5.0, 2.0]]))
    assert lengths[0] < 3.0
    assert np.isinf(lengths[1])


@pytest.mark.slow
def test_the_correction_is_the_error_of_the_common_mesh():
    """Two pressures of a patch on a coarse mesh: the correction leaves a fraction of the error."""
    recording = simulate(
        make_phantom("uniform_cube"),
        PressPlan(("z+",), (0.01, 0.02), patch_radius_mm=3.0),
        mesh=box_mesh(10.0, 4, tets_per_cell=5),
        element="tet10",
    )
    field, newton = ShapeField(ShapePrior.of(recording.mesh, 0.2)), NewtonOptions()

    def evaluate(recording):
        problem = InverseProblem(recording, element="tet10", newton=newton)
        fit, evaluation = fit_shapes(problem, field, np.zeros(1), max_iterations=0)
        return problem, fit, evaluation

    problem, fit, before = evaluate(recording)
    rim = Rim.of(recording.presses[0], recording.mesh)
    sizing = rim.sizing(0.2, 0.7, 0.2)
    _, _, finest = evaluate(refine_recording(recording, sizing, smooth_tractions=True))
    correction = Correction.of(problem)
    offsets = correction.offsets(fit, before)
    n = recording.mesh.n_points
    for i, observation in enumerate(problem.data.observations):
        error = (finest.reported[i][:n] - before.reported[i]).ravel()[observation.index]
        assert np.linalg.norm(error) > 0.003 * np.linalg.norm(observation.values)
        assert np.linalg.norm(error - offsets[i]) < 0.35 * np.linalg.norm(error)


@pytest.mark.slow
def test_whole_sides_are_corrected_at_sharp_edges_and_inclusions(recording):
    newton = NewtonOptions()
    problem = InverseProblem(recording, element="tet10", newton=newton)
    correction = Correction.of(problem)
    assert not correction.uncertain
    assert not correction.has_singular_ends
    assert [numbers for numbers, _ in correction.contacts] == [(0, 1), (2, 3)]
    prior = ShapePrior.of(recording.mesh, 0.2)
    uniform, evaluation = fit_shapes(problem, ShapeField(prior), np.zeros(1), max_iterations=0)
    edges = np.linalg.norm(correction.offsets(uniform, evaluation)[1])
    field = ShapeField(prior, (BALL,))
    values = np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.5), np.log(5.0)])
    ball, evaluation = fit_shapes(problem, field, field.standard(values), max_iterations=0)
    low, high = (np.linalg.norm(o) for o in correction.offsets(ball, evaluation)[:2])
    assert 0.0 < low < high < 0.05 * np.linalg.norm(problem.data.observations[1].values)
    assert 0.0 < edges < high


@pytest.mark.slow
def test_corrections_of_one_tangent_a_contact_are_those_of_equilibria(recording, monkeypatch):
    one = replace(recording, presses=recording.presses[:2])  # two loads
    problem = InverseProblem(one, element="tet10")
    field = ShapeField(ShapePrior.of(MESH, 0.2), (BALL,))
    values = np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.5), np.log(5.0)])
    fit, evaluation = fit_shapes(problem, field, field.standard(values), max_iterations=0)
    tangents, tangent = [], Newton._tangent

    def counted(self, *arguments, **options):
        tangents.append(self)
        return tangent(self, *arguments, **options)

    monkeypatch.setattr(Newton, "_tangent", counted)
    monkeypatch.setattr(correction_module, "sharp_edge_sizing", lambda mesh: None)  # smaller meshes
    correction = Correction.of(problem)
    found = np.concatenate(correction.offsets(fit, evaluation))
    assert len(tangents) == 1
    monkeypatch.setattr(correction_module, "_NEWTON", NewtonOptions(rtol=1e-7))
    exact = np.concatenate(correction.offsets(fit, evaluation))
    assert 1e-6 < np.linalg.norm(found - exact) / np.linalg.norm(exact) < 0.01


def test_the_posterior_of_a_ball_is_that_of_an_ellipsoid(recording):
    presses = ShapeProblem(recording, Settings())
    field = ShapeField(presses.prior, (BALL,))
    values = np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.5), np.log(5.0)])
    errors = {"pose": 0.002}
    problem = presses.full.with_data(presses.data(errors))
    fit, evaluation = fit_shapes(
        problem, field, field.standard(values), sites=presses.sites, max_iterations=0
    )
    posterior = make_posterior(Model(fit, evaluation, errors), presses.sites)
    assert posterior.field.families == (ELLIPSOID,)
    assert posterior.covariance[4, 4] > 1.02 * fit.covariance[4, 4] * max(1.0, fit.chi2)
    other = replace(field, families=(ELLIPSOID,))
    z = other.standard(np.concatenate([values, np.zeros(5)]))
    np.testing.assert_array_equal(posterior.z, z)
    full, _ = fit_shapes(problem, other, z, sites=presses.sites, max_iterations=0)
    inflation = max(1.0, fit.chi2)
    precision = full.jacobian.T @ full.jacobian / inflation + np.eye(len(z))
    scale = np.sqrt(np.diag(posterior.covariance))
    difference = posterior.covariance - np.linalg.inv(precision)
    np.testing.assert_allclose(difference / np.outer(scale, scale), 0.0, atol=1e-2)
    gradient = full.jacobian.T @ full.residuals / inflation + z
    step = -np.linalg.solve(precision, gradient)
    assert np.abs(step[-5:]).max() > 0.1 * scale[-5:].min()
    np.testing.assert_allclose(posterior.step / scale, step / scale, atol=0.05)


def test_changes_between_two_loads_are_quadratic_in_the_load():
    direction, curved = np.random.default_rng(0).standard_normal((2, 5))
    loads = np.array([0.5, 1.0, 0.25, 0.75])
    series = _LoadSeries.of(range(4), [np.zeros(5) + load for load in loads])
    assert series.ends == (2, 1)
    exact = [load * direction + load**2 * curved for load in loads]
    found = series.interpolate({i: exact[i] for i in series.ends})
    np.testing.assert_allclose([found[i] for i in range(4)], exact)
    single = _LoadSeries.of([0, 1], [np.ones(5), -0.5 * np.ones(5)])  # pulled as well as pushed
    assert single.ends == (0,)
    found = single.interpolate({0: direction})
    np.testing.assert_allclose(found[1], -0.5 * direction)


def test_sharp_edges_and_surfaces_near_inclusions_have_short_edges():
    lengths = sharp_edge_sizing(MESH)(np.array([[0.0, 5.0, 10.0], [5.0, 5.0, 10.0]]))
    assert lengths[0] < 0.7
    assert lengths[1] > 4.0
    ball = InclusionShape((5.0, 5.0, 7.0), (2.0,) * 3, tuple(map(tuple, np.eye(3))), 5.0)
    top = MESH.points[face_nodes(MESH, "z+")]
    sizing = observed_sizing(top, [ball])
    lengths = sizing(np.array([[5.0, 5.0, 10.0], [5.0, 5.0, 8.0]]))
    assert lengths[0] == pytest.approx(0.25)  # a quarter of the gap
    assert lengths[1] == pytest.approx(1.25)
    assert observed_sizing(MESH.points[face_nodes(MESH, "z-")], [ball]) is None


@pytest.mark.slow
def test_corrections_hold_at_inclusions():
    """Most of the error of a coarse mesh that does not follow a ball is that of its correction."""
    recording = simulate(
        make_phantom("uniform_cube"),
        PressPlan(("z+",), (0.01,)),
        mesh=box_mesh(10.0, 4, tets_per_cell=5),
        element="tet10",
    )
    field = ShapeField(ShapePrior.of(recording.mesh, 0.2), (BALL,))
    z = field.standard(np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.2), np.log(5.0)]))
    problem = InverseProblem(recording, element="tet10")
    fit, before = fit_shapes(problem, field, z, max_iterations=0)
    (offset,) = Correction.of(problem).offsets(fit, before)
    # The reference does not follow the ball, but has small elements there.
    (ball,) = field.shapes(z)
    fine = refine_recording(recording, lambda points: 0.6 + 0.7 * np.abs(ball.distance(points)))
    _, finest = fit_shapes(InverseProblem(fine, element="tet10"), field, z, max_iterations=0)
    index = problem.data.observations[0].index
    n = recording.mesh.n_points
    error = (finest.reported[0][:n] - before.reported[0]).ravel()[index]
    assert np.linalg.norm(error - offset) < 0.4 * np.linalg.norm(error)
