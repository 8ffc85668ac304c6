"""Steps of the background and plates, from the residuals of a model without them."""

from collections.abc import Sequence
from unittest.mock import Mock

import numpy as np
import pytest

from tactorch.inverse.fields import BALL, FAMILIES, ShapeField, ShapePrior, Sites
from tactorch.inverse.fields.background import Background
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import Model, Start, with_step
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.proposals import changed, split
from tactorch.inverse.search.search import _over_rival
from tactorch.inverse.search.slabs import (
    crosses,
    inclusions_as_steps,
    simpler_background,
    slabs,
)
from tactorch.mesh import Box, box_mesh
from tactorch.phantoms import Gradient, Layers, Phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 4, tets_per_cell=5)
PRIOR = ShapePrior.of(MESH, 0.2)
BODY = Box((5.0, 5.0, 5.0), (10.0, 10.0, 10.0))
POINTS = Sites.at(np.random.default_rng(0).uniform(0.0, 10.0, (500, 3)))


def proposed(youngs: Layers | Gradient) -> tuple[ShapeProblem, Model, dict[str, Start]]:
    """Return what is proposed beside a uniform background, by the family of inclusions."""
    fine = box_mesh(10.0, 7, tets_per_cell=5)
    plan = PressPlan(("z+", "x+"), (0.01, 0.02))
    recording = simulate(
        Phantom(BODY, (), youngs), plan, mesh=MESH, fine_mesh=fine, element="tet10", snr_db=40.0
    )
    problem = ShapeProblem(recording, Settings(), max_shapes=2)
    model = problem.uniform()
    starts = {"cuboid" if s.field.families else "step": s for s in slabs(problem, model)}
    return problem, model, starts


def test_a_skin_is_proposed_as_a_step() -> None:
    _, _, starts = proposed(Layers((7.1,), (0.2, 0.5)))
    start = starts["step"]
    assert start.field.background.steps == ("z+",)
    place, contrast = start.field.physical(start.z)[1:]
    assert place == pytest.approx(7.1, abs=1.3)  # half an element
    assert contrast > 0.0


def test_a_layer_between_two_planes_is_proposed_as_a_plate() -> None:
    problem, model, starts = proposed(Layers((2.9, 5.7), (0.2, 0.6, 0.2)))
    start = starts["cuboid"]
    (shape,) = start.field.shapes(start.z)
    low, high = (shape.center_mm[2] + sign * shape.half_size_mm[2] for sign in (-1.0, 1.0))
    assert [low, high] == pytest.approx([2.9, 5.7], abs=1.3)
    assert shape.contrast > 1.0
    assert crosses(shape, PRIOR)
    problem.max_shapes = 0
    assert not any(start.field.families for start in slabs(problem, model))


def plates(*values: Sequence[float]) -> Mock:
    """Return a model of plates across z, by centre, half the thickness and log-contrast."""
    cuboid, parts = FAMILIES["cuboid"], [np.array([np.log(0.2)])]
    field = ShapeField(PRIOR, (cuboid,) * len(values))
    for x, y, z, half_width, contrast in values:
        half = np.array([half_width, half_width, 1.2])
        logs = np.log(half / np.cbrt(half.prod()))
        ratios = np.tensordot(cuboid.basis, np.diag(logs))
        log_radius = np.log(6.0 / np.pi * half.prod()) / 3.0
        parts.append(np.array([x, y, z, log_radius, contrast, *ratios, 0.0, 0.0, 0.0]))
    fit = Mock(spec=ShapeFit, field=field, z=field.standard(np.concatenate(parts)))
    return Mock(spec=Model, fit=fit, errors={})


def test_a_plate_at_an_end_is_tried_as_a_step() -> None:
    at_end = [5.0, 5.0, 1.1, 4.6, np.log(2.0)]
    inside, narrow = [5.0, 5.0, 5.0, 4.6, -0.4], [5.0, 5.0, 1.1, 3.0, 0.4]
    problem = Mock(spec=SearchProblem, step_sides=SearchProblem.step_sides)
    (start,) = inclusions_as_steps(problem, plates(at_end, inside, narrow))
    assert start.what == "inclusion 0 as a step"
    assert start.field.background.steps == ("z-",)
    assert len(start.field.families) == 2
    place, contrast = start.field.physical(start.z)[1:3]
    assert place == pytest.approx(2.3)
    assert contrast == pytest.approx(np.log(2.0))
    assert not [
        *inclusions_as_steps(Mock(spec=SearchProblem, step_sides=("z+", "x-")), plates(at_end))
    ]


def test_plates_are_not_tried_as_other_forms() -> None:
    problem = Mock(spec=SearchProblem, forms=("cuboid", "ring"))
    assert not [*changed(problem, plates([5.0, 5.0, 1.1, 4.6, 0.7]))]
    (start,) = changed(problem, plates([5.0, 5.0, 4.0, 3.0, 0.7]))
    assert start.field.families[0].name == "ring"


def test_an_inclusion_is_tried_as_two_balls_along_its_longest_axis() -> None:
    problem = Mock(spec=SearchProblem, max_shapes=2)
    model = plates([5.0, 4.0, 4.0, 3.0, 0.7])
    (start,) = split(problem, model)
    assert start.field.families == (BALL, BALL)
    (whole,), (first, last) = model.fit.field.shapes(model.fit.z), start.field.shapes(start.z)
    apart = np.array(last.center_mm) - first.center_mm
    assert np.linalg.norm(apart) == pytest.approx(3.0, rel=0.1)  # halves of 6 mm
    assert abs(apart[2]) < 0.2  # across the thickness
    middle = 0.5 * (np.array(first.center_mm) + last.center_mm)
    np.testing.assert_allclose(middle, whole.center_mm, atol=0.2)
    assert 2.0 * first.radius_mm**3 == pytest.approx(whole.radius_mm**3)
    assert first.contrast == pytest.approx(whole.contrast)
    problem.max_shapes = 1
    assert not [*split(problem, model)]


def test_each_step_of_a_background_is_tried_without() -> None:
    field = ShapeField(PRIOR, (), Background(degree=1))
    z = field.standard(np.array([np.log(0.2), 0.1, -0.2, 0.3]))
    once = with_step(field, z, "z-", 3.0, 0.5)
    both = with_step(*once, "x+", 7.0, -0.3)
    model = Mock(spec=Model, fit=Mock(spec=ShapeFit, field=both[0], z=both[1]), errors={})
    first, last = simpler_background(Mock(spec=SearchProblem), model)
    logs = last.field.log_youngs(last.z, POINTS)
    np.testing.assert_allclose(logs, once[0].log_youngs(once[1], POINTS))
    logs = first.field.log_youngs(first.z, POINTS)
    expected = with_step(field, z, "x+", 7.0, -0.3)
    np.testing.assert_allclose(logs, expected[0].log_youngs(expected[1], POINTS))


@pytest.mark.slow
def test_an_inclusion_in_place_of_a_smooth_background_is_not_probable() -> None:
    """A large ball explains a body that is stiffer at one side better than a uniform one."""
    gradient = Gradient((0.0, 0.0, 0.0), (10.0, 0.0, 10.0), 0.15, 0.3)
    problem, uniform, _ = proposed(gradient)
    field = ShapeField(problem.prior, (BALL,))
    ball = np.array([np.log(0.2), 9.0, 5.0, 9.0, np.log(4.0), 0.5])
    model = problem.fit(Start("ball", field, field.standard(ball), {}), None)
    plain, smooth, *_ = (fit for _, fit in problem.without(model, [0]))
    assert problem.gain(model.fit, plain) > 3.0
    assert problem.gain(model.fit, uniform.fit) > 3.0
    assert problem.gain(model.fit, smooth) < -3.0
    odds, rival, errors = _over_rival(problem, model, [0])
    assert odds < -3.0
    score = problem.held_out_score(model.fit, model.errors)
    predictive = problem.predictive_gain(score, rival, errors)
    assert predictive is not None
    assert predictive < 0.0
