"""Families of inclusions: what each one states of itself, and a cuboid's own data."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse.data.observations import NoiseModel
from tactorch.inverse.fields import (
    BALL,
    ELLIPSOID,
    FAMILIES,
    Candidate,
    Cloud,
    ShapeField,
    ShapePrior,
    Sites,
)
from tactorch.inverse.fields.cuboid import CUBOID
from tactorch.inverse.fields.family import families_beyond
from tactorch.inverse.fields.inclusion import Parameters
from tactorch.inverse.fit.shapes import ShapesOnSites, fit_shapes
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import Alternative, InclusionValues, ShapeReconstruction
from tactorch.inverse.search.model import as_judged, with_family
from tactorch.mesh import Box, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 4, tets_per_cell=5)
PRIOR = ShapePrior.of(MESH, 0.2)
COMMON = [5.0, 4.6, 5.7, np.log(2.2), 1.2]
#: Parameters of the families beside the common ones.
DISTORTED = {
    "ball": [],
    "ellipsoid": [0.2, -0.1, 0.1, -0.2, 0.15],
    "cuboid": [0.35, -0.3, 0.1, -0.2, 0.3],
    "rod": [1.5, 0.8, 0.4],
    "tapered rod": [1.5, 0.8, 0.4, 0.5],
    "bent rod": [1.9, 0.8, 0.4, -0.3, 1.1, 0.4],
    "ring": [0.6, -0.8, 2.1],
    "irregular lump": np.random.default_rng(3).normal(0.0, 0.06, 21).tolist(),
}


@pytest.fixture(scope="module")
def recording():
    """Presses on two sides of a uniform body."""
    plan = PressPlan(("z+", "x+"), (0.01, 0.02))
    return simulate(make_phantom("uniform_cube"), plan, mesh=MESH, fine_mesh=MESH)


@pytest.fixture(scope="module")
def problem(recording):
    return InverseProblem(recording, noise=NoiseModel(relative=1e-3))


def parameters(name: str) -> tuple[ShapeField, np.ndarray]:
    """Return a field of one inclusion of a family, with distortions, and its parameters."""
    family = FAMILIES[name]
    field = ShapeField(PRIOR, (family,))
    own = [*COMMON, *DISTORTED[name]]
    return field, field.standard(np.array([np.log(0.2), *own]))


@pytest.mark.parametrize("name", [*FAMILIES])
def test_derivatives_are_those_of_the_modulus(problem, name):
    (field, z), sites = parameters(name), Sites.of(problem.body.assembly)
    jacobian = field.jacobian(z, sites)
    assert np.abs(jacobian).max(axis=0).min() > 1e-2  # else the test shows nothing
    for k, step in enumerate(1e-5 * np.eye(field.size)):
        slope = (field.log_youngs(z + step, sites) - field.log_youngs(z - step, sites)) / 2e-5
        # A sample point beside a diagonal plane of the cuboid has two slopes in between.
        atol = 1e-6 if name == "cuboid" else 1e-7
        np.testing.assert_allclose(jacobian[:, k], slope, atol=atol)


@pytest.mark.parametrize("name", [*FAMILIES])
def test_a_shape_beside_the_body_changes_nothing(problem, name):
    field, values = parameters(name)
    values[1:4] += 30.0
    sites, z = Sites.of(problem.body.assembly), field.standard(values)
    jacobian = field.jacobian(z, sites)
    assert jacobian.shape == (np.prod(sites.shape), field.size)
    assert not jacobian[:, 1:].any()


@pytest.mark.parametrize("name", [*FAMILIES])
def test_the_body_is_where_the_modulus_differs(name):
    field, z = parameters(name)
    (shape,) = field.shapes(z)
    points = np.random.default_rng(0).uniform(0.0, 10.0, (200_000, 3))
    inside = field.log_youngs(z, Sites.at(points)) > np.log(0.2) + 0.6
    np.testing.assert_array_equal(shape.contains(points), inside)
    np.testing.assert_array_equal(shape.distance(points) <= 0.0, inside)
    assert 1000.0 * inside.mean() == pytest.approx(4.0 / 3.0 * np.pi * 2.2**3, rel=0.03)
    assert shape.radius_mm == pytest.approx(2.2)
    np.testing.assert_allclose(points[inside].mean(axis=0), shape.centroid_mm, atol=0.05)
    largest = np.abs(points[inside] - shape.center_mm).max(axis=0)
    assert (largest <= shape.half_size_mm).all()
    np.testing.assert_allclose(largest, shape.half_size_mm, rtol=0.05)
    np.testing.assert_allclose(np.ptp(points[inside], axis=0), shape.size_mm, rtol=0.07)
    vertices, _ = shape.surface(16)
    np.testing.assert_allclose(np.abs(shape.distance(vertices)).max(), 0.0, atol=1e-9)


@pytest.mark.parametrize("name", [*FAMILIES])
def test_a_smooth_boundary_keeps_the_volume(problem, name):
    (field, z), assembly = parameters(name), problem.body.assembly
    excess = field.log_youngs(z, Sites.of(assembly)) - np.log(0.2)
    volume = float(excess @ assembly.weights.ravel()) / 1.2
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 2.2**3, rel=0.03)


def test_a_cuboid_has_the_sides_that_its_parameters_say():
    """Half-lengths of 1.5, 2 and 2.5 mm; volume, radius and ratios follow."""
    half = np.array([1.5, 2.0, 2.5])
    logs = np.log(half * np.cbrt(6.0 / np.pi))
    ratios = [(logs[0] - logs[1]) / np.sqrt(2.0), (logs[0] + logs[1] - 2 * logs[2]) / np.sqrt(6.0)]
    own = Parameters.of(np.array([5.0, 4.6, 5.7, logs.mean(), 1.2, *ratios, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(CUBOID.shape(own).half_size_mm, half)
    points = np.random.default_rng(1).uniform(0.0, 10.0, (500, 3))
    box = Box((5.0, 4.6, 5.7), tuple(2.0 * half))
    found = CUBOID.distance(own, points[:, None])[:, 0]
    np.testing.assert_allclose(found, box.signed_distance(points))


@pytest.mark.parametrize("name", [*FAMILIES])
def test_results_and_pictures_are_of_any_family(name):
    field, z = parameters(name)
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 1e-4 * np.eye(len(z)))
    result = ShapeReconstruction(field, z, posterior, 1.0, (9.0,), 9.0)
    result = replace(result, alternatives=(Alternative(0.2, field, z, posterior),))
    read = ShapeReconstruction.of(json.loads(json.dumps(result.plain())))
    (inclusion,), (other,) = read.inclusions, read.alternatives
    assert other.probability == 0.2
    assert other.shapes == [*field.shapes(z)]
    assert inclusion.shape == next(field.shapes(result.estimate))
    assert np.abs(result.estimate - z).max() < 2e-3
    centers = InclusionValues.of(field, result.samples, 0).center_mm
    np.testing.assert_allclose(centers.mean(axis=0), inclusion.shape.centroid_mm, atol=0.01)
    assert inclusion.youngs_mpa == pytest.approx(0.2 * np.exp(1.2), rel=5e-3)
    low, high = inclusion.radius_90_mm
    assert np.log(high / low) == pytest.approx(2 * 1.645 * 0.01 * PRIOR.log_radius, rel=0.1)
    (solid,) = result.to_pyvista()
    assert solid.volume == pytest.approx(4.0 / 3.0 * np.pi * 2.2**3, rel=0.02)


def test_a_family_becomes_a_more_general_one():
    """A search goes on from balls to ellipsoids; a cuboid is tried on request."""
    assert families_beyond(BALL) == [ELLIPSOID]
    assert families_beyond(ELLIPSOID) == families_beyond(CUBOID) == []
    field, z = parameters("ellipsoid")
    cuboids, same = with_family(field, z, 0, CUBOID)
    before, after = field.own(field.physical(z), 0), cuboids.own(cuboids.physical(same), 0)
    np.testing.assert_allclose(after.center, before.center)
    np.testing.assert_allclose(after[1:3], before[1:3])
    np.testing.assert_allclose(after.distortions[:2], before.distortions[:2])
    balls = ShapeField(PRIOR, (BALL, CUBOID))
    judged, _ = as_judged(balls, np.zeros(balls.size))
    assert judged.families == (ELLIPSOID, CUBOID)


def test_balls_and_rods_are_born_in_the_families_that_are_for_them():
    ball = Candidate(np.array([1.0, 2.0, 3.0]), 2.0, 0.5, 10.0, np.zeros(3))
    rod = ball._replace(half_mm=np.array([0.0, 4.0, 0.0]))
    np.testing.assert_allclose(BALL.birth(ball), [1.0, 2.0, 3.0, np.log(2.0), 0.5])
    assert BALL.birth(rod) is ELLIPSOID.birth(ball) is CUBOID.birth(ball) is None
    shape = ELLIPSOID.shape(Parameters.of(ELLIPSOID.birth(rod)))
    assert shape.semi_axes_mm == pytest.approx((6.0, 2.0, 2.0))
    np.testing.assert_allclose(shape.half_size_mm, [2.0, 6.0, 2.0])


def test_files_name_the_families_and_those_of_earlier_versions_load():
    field = ShapeField(PRIOR, (CUBOID, BALL, ELLIPSOID))
    plain = json.loads(json.dumps(field.plain()))
    assert plain["families"] == ["cuboid", "ball", "ellipsoid"]
    assert ShapeField.of(plain).families == field.families
    del plain["families"]
    plain["distorted"] = [False, True]
    assert ShapeField.of(plain).families == (BALL, ELLIPSOID)


def test_a_cuboid_is_found_in_its_own_data(problem):
    """Data of a cuboid are explained by a cuboid, from a ball at another place, and by no ball."""
    field, z = parameters("cuboid")
    sites = Sites.of(problem.body.assembly)
    exact = problem.evaluate(ShapesOnSites(field, sites).at(z).youngs)
    noise = [np.random.default_rng(k).normal(size=n) for k, n in enumerate(problem.data.counts)]
    changes = [
        predicted - observation.values + one / problem.data.scale[begin : begin + len(one)]
        for predicted, observation, one, begin in zip(
            exact.predicted, problem.data.observations, noise, problem.data.begins, strict=True
        )
    ]
    data = problem.with_data(problem.data.shifted(changes))
    ball = ShapeField(PRIOR, (BALL,))
    start = ball.standard(np.array([np.log(0.2), 5.5, 5.0, 5.5, np.log(2.0), 0.8]))
    round_fit, _ = fit_shapes(data, ball, start, sites=sites)
    fit, _ = fit_shapes(data, *with_family(ball, round_fit.z, 0, CUBOID), sites=sites)
    assert fit.chi2 == pytest.approx(1.0, abs=0.15)
    assert fit.log_evidence() > round_fit.log_evidence() + 3.0
    # Other turns, with the sides in another order, are the same cuboid.
    found, true = next(field.shapes(fit.z)), next(field.shapes(z))
    np.testing.assert_allclose(found.semi_axes_mm, true.semi_axes_mm, rtol=0.05)
    np.testing.assert_allclose(found.center_mm, true.center_mm, atol=0.05)
    points = np.random.default_rng(0).uniform(0.0, 10.0, (50_000, 3))
    both, either = (found.contains(points) & true.contains(points)), found.contains(points)
    assert 2.0 * both.sum() / (either.sum() + true.contains(points).sum()) > 0.95
    others = slice(4, None)  # radius, contrast, ratios and turn are better known than beforehand
    assert np.sqrt(np.diag(fit.covariance))[others].max() < 0.5


@pytest.mark.parametrize("name", [*FAMILIES])
def test_a_family_resembles_points_of_its_own(name):
    """An inclusion like the points inside another one of the same family is the other one."""
    (field, z), family = parameters(name), FAMILIES[name]
    (shape,) = field.shapes(z)
    cloud = Cloud.of([shape])
    like = family.shape(Parameters.of(family.like(cloud)))
    points = np.random.default_rng(0).uniform(0.0, 10.0, (100_000, 3))
    one, other = shape.contains(points), like.contains(points)
    assert 2.0 * (one & other).sum() / (one.sum() + other.sum()) > 0.85
    assert like.contrast == pytest.approx(shape.contrast)
    assert like.radius_mm == pytest.approx(2.2)


@pytest.mark.parametrize("name", ["rod", "tapered rod", "bent rod", "ring"])
def test_tubes_have_a_radius_and_its_derivatives_all_over_the_prior(name):
    family, rng = FAMILIES[name], np.random.default_rng(0)
    field = ShapeField(PRIOR, (family,))
    places = field.parts[0].start + np.array([3, *range(5, len(family.parameters))])
    for z in np.clip(2.0 * rng.standard_normal((100, field.size)), -4.0, 4.0):
        values = field.physical(z)
        radius, by_size, by_vectors = family._radius(field.own(values, 0))
        assert 0.0 < radius < 2.0 * np.exp(field.own(values, 0).log_radius)
        for place, slope in zip(places, [by_size, *by_vectors], strict=True):
            step = 1e-6 * np.eye(field.size)[place]
            ends = [family._radius(field.own(values + sign * step, 0))[0] for sign in (-1, 1)]
            assert slope == pytest.approx((ends[1] - ends[0]) / 2e-6, rel=1e-4, abs=1e-6)
