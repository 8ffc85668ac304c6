"""Discrepancies of the model: their covariance, and presses whose body is not as stated."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from tactorch.inverse import InverseProblem, Settings, find_shapes
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.discrepancy import Discrepancy
from tactorch.inverse.errors.heterogeneity import Heterogeneity, _modes
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.fields.background import Background
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.forward.problem import Evaluation
from tactorch.inverse.result.build import of_inclusions
from tactorch.inverse.search.model import Model, Start, is_negligible, with_step
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.proposals import _specific
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 5, tets_per_cell=5)
TOP = np.array([10.0, 10.0, 10.0])


def pressed(name: str, depth: float, snr_db: float = 40.0) -> Recording:
    """Return presses on a cube, by linear elements, whose depth is stated too large by a factor."""
    plan = PressPlan(("z+", "x+"), (0.01, 0.02))
    recording = simulate(make_phantom(name), plan, mesh=MESH, element="tet4", snr_db=snr_db)
    stated = TetMesh(TOP + (MESH.points - TOP) * [1.0, 1.0, depth], MESH.tets)
    same = {"inverse_crime": True, "element": "tet4"}
    return replace(recording, mesh=stated, truth=None, provenance=same)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Presses as stated."""
    return pressed("uniform_cube", 1.0)


def test_deviations_are_those_of_the_displacements(recording: Recording) -> None:
    """Their variance is that of a process of unit variance, and of its product with the strain."""
    problem = InverseProblem(recording)
    patterns = Discrepancy().patterns(MeasuredPresses(problem, [(0, 1), (2, 3)]))
    begins = [*problem.data.begins, len(patterns)]
    for i, observation in enumerate(problem.data.observations):
        rows = patterns[begins[i] : begins[i + 1]] / observation.scale[:, None]
        points = MESH.points[observation.index // 3]
        size = np.sqrt(np.mean(observation.values**2))
        strain = size / np.sqrt(points.var(axis=0).sum())
        np.testing.assert_allclose((rows**2).sum(axis=1), size**2 * (1.0 + strain**2), rtol=0.01)


def test_near_displacements_along_one_axis_have_them_in_common(recording: Recording) -> None:
    problem = InverseProblem(recording)
    patterns = Discrepancy().patterns(MeasuredPresses(problem, [(0, 1), (2, 3)]))
    index = problem.data.observations[0].index
    rows = patterns[: len(index)]
    correlation = np.corrcoef(np.hstack([rows, -rows]))  # of mean zero
    points, axes = MESH.points[index // 3], index % 3
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    same = axes[:, None] == axes
    assert np.abs(correlation[~same]).max() < 1e-9
    assert correlation[same & (apart < 2.1)].min() > 0.8
    assert correlation[same & (apart > 12.0)].max() < 0.1
    second = patterns[problem.data.begins[2] :]
    assert np.abs(patterns[: len(index)] @ second[: len(index)].T).max() == 0.0


def test_the_modulus_varies_by_a_process_of_unit_variance() -> None:
    """Its correlation is that of a Gaussian covariance: exp(-1/2) at a quarter of the side."""
    modes = _modes(box_mesh(10.0, 8, tets_per_cell=5))
    points = box_mesh(10.0, 8, tets_per_cell=5).centroids
    assert np.mean((modes**2).sum(axis=1)) == pytest.approx(1.0, rel=0.05)
    inner = (np.abs(points - 5.0) < 2.6).all(axis=1)
    covariance, apart = modes[inner] @ modes[inner].T, points[inner][:, None] - points[inner]
    variances = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(variances, variances)
    distances = np.linalg.norm(apart, axis=2)
    near = np.abs(distances - 2.5) < 0.1
    assert correlation[near].mean() == pytest.approx(np.exp(-0.5), abs=0.1)


def test_a_wrong_depth_is_a_discrepancy_and_no_lump() -> None:
    found = find_shapes(wrong := pressed("uniform_cube", 1.15))
    assert not found.inclusions
    assert not found.steps
    assert found.errors["discrepancy"] > 0.0
    assert found.unexplained >= found.errors["discrepancy"]
    (text,) = (w for w in of_inclusions(wrong, found, {}, 0.0).warnings if "smooth" in w)
    assert "Check the shape and depth of the object" in text


def test_presses_as_stated_have_none(recording: Recording) -> None:
    found = find_shapes(recording)
    assert "discrepancy" not in found.errors
    assert not found.inclusions


def test_an_inclusion_has_to_explain_more_than_a_discrepancy(recording: Recording) -> None:
    """The rivals of a model with an inclusion have larger discrepancies."""
    problem = ShapeProblem(recording, Settings(), max_shapes=1)
    present = {"pose": 0.01, "discrepancy": Discrepancy.levels[-2]}
    doubts = problem.errors.doubts(present)
    assert doubts[0] == present | {"discrepancy": Discrepancy.levels[-1]}
    assert doubts[1:] == [present | {"heterogeneity": x} for x in Heterogeneity.levels]
    model = problem.uniform()
    ball = ShapeField(problem.prior, (BALL,))
    z = np.append(model.fit.z, np.zeros(5))
    model = replace(model, fit=replace(model.fit, field=ball, z=z))
    tried = list[Start]()
    problem.try_model = lambda start, offsets: tried.append(start)  # type: ignore[method-assign]
    problem.offsets = lambda model: []  # type: ignore[method-assign]
    list(problem.without(model, [0]))
    assert not any(start.field.families for start in tried)
    assert {start.errors.get("discrepancy", 0.0) for start in tried} == {0.0, *Discrepancy.levels}
    varying = {start.errors.get("heterogeneity", 0.0) for start in tried}
    assert varying == {0.0, *Heterogeneity.levels}


def test_changes_of_the_map_are_tried_without_general_errors(recording: Recording) -> None:
    problem = ShapeProblem(recording, Settings())
    errors = {"pose": 0.01, "discrepancy": 0.02, "heterogeneity": 0.1}
    assert problem.errors.specific(errors) == {"pose": 0.01}
    same, other = ShapeField(problem.prior), ShapeField(problem.prior, background=Background(2))
    model = Model(Mock(spec=ShapeFit, field=same), Mock(spec=Evaluation), errors)
    starts = [
        Start("background", other, np.zeros(other.size), errors),
        Start("poses", same, np.zeros(same.size), {"discrepancy": 0.02}),
    ]
    (tried,) = _specific(problem, model, starts)
    assert (tried.field, tried.errors) == (other, {"pose": 0.01})
    assert not list(_specific(problem, replace(model, errors={"pose": 0.01}), starts))


@pytest.mark.parametrize("log_contrast", [0.03, -0.03, 0.07])
@pytest.mark.parametrize("is_step", [True, False])
def test_a_change_of_the_modulus_of_a_few_percent_is_no_structure(
    log_contrast: float, is_step: bool
) -> None:
    field = ShapeField(ShapePrior.of(MESH, 0.2), () if is_step else (BALL,))
    values = field.physical(np.zeros(field.size))
    if is_step:
        field, z = with_step(field, np.zeros(field.size), "z+", 8.0, log_contrast)
    else:
        values[field.index(0, "log_contrast")] = log_contrast
        z = field.standard(values)
    assert is_negligible(Mock(spec=ShapeFit, field=field, z=z)) is (abs(log_contrast) < 0.05)
