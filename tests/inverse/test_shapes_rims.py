"""Errors of the traction at the rims of contacts, which nodal forces leave open."""

from dataclasses import replace

import numpy as np
import pytest

import tactorch
from tactorch.fem import Discretisation
from tactorch.fem.elements import ELEMENTS
from tactorch.files import write_json
from tactorch.inverse import Settings
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.errors.rims import (
    EDGE_DEVIATION,
    Rims,
    _midside_loads,
    rim_edges,
)
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.fit.shapes import fit_shapes
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.correction import Correction
from tactorch.inverse.search.model import Start, make_posterior
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.sizing import loaded_end
from tactorch.mesh import box_mesh
from tactorch.mesh.tractions import LoadedSurface
from tactorch.phantoms import make_phantom
from tactorch.recording import PressErrors
from tactorch.simulation import PressPlan, simulate
from tactorch.simulation.patch import patch_forces
from tactorch.simulation.plan import PressSite

RADIUS_MM = 3.0
CELLS = 5
MESH = box_mesh(10.0, CELLS, tets_per_cell=5)
FINE = box_mesh(10.0, 8, tets_per_cell=5)


@pytest.fixture(scope="module")
def recording():
    plan = PressPlan(("z+",), (0.005, 0.01), patch_radius_mm=RADIUS_MM)
    made = simulate(make_phantom("uniform_cube"), plan, mesh=MESH, fine_mesh=FINE, snr_db=40.0)
    presses = tuple(
        replace(press, noise_mm=0.01 * float(np.std(press.displacement[press.observed])))
        for press in made.presses
    )
    return replace(made, presses=presses)


@pytest.fixture(scope="module")
def presses(recording):
    """The search's problem, as if nothing were known of the simulation."""
    return ShapeProblem(replace(recording, provenance={}), Settings())


@pytest.fixture(scope="module")
def uniform(presses):
    return presses.uniform()


@pytest.fixture(scope="module")
def problem(recording):
    return InverseProblem(recording, element="tet10")


@pytest.fixture(scope="module")
def evaluation(problem):
    return problem.evaluate(np.full(MESH.n_tets, 0.2))


def test_edges_are_those_beside_the_rim(recording, problem):
    ((_, rim),) = Correction.of(problem).contacts
    forces = recording.presses[0].forces
    loaded = LoadedSurface.of(MESH.surface, forces)
    ends, areas = rim_edges(loaded, rim.nodes)
    beside = np.isin(loaded.triangles, rim.nodes).any(axis=1)
    assert areas.sum() == pytest.approx(loaded.areas[beside].sum())
    assert (forces[ends] != 0).any(axis=2).all()
    distances = np.linalg.norm(MESH.points[ends].mean(axis=1)[:, :2] - 5.0, axis=1)
    assert 0.0 < distances.min() < distances.max() < RADIUS_MM + 10.0 / CELLS


def test_loads_have_no_integrals_over_hat_functions():
    discretisation = Discretisation(MESH, ELEMENTS["tet10"])
    ends = discretisation.edges[:5]
    loads = _midside_loads(discretisation, ends, np.arange(1.0, 6.0), np.array([0.0, 1.0, -2.0]))
    midsides = loads[:, MESH.n_points :]
    sums = loads[:, : MESH.n_points].copy()
    for column in discretisation.edges.T:
        for k in range(5):
            np.add.at(sums[k], column, 0.5 * midsides[k])
    np.testing.assert_allclose(sums, 0.0, atol=1e-14)
    assert np.abs(loads).max() == pytest.approx(10.0)


def test_patterns_explain_the_traction_that_ends_within_triangles(recording, problem, evaluation):
    """A uniform pressure on the disc, and the traction that its nodal forces stand for."""
    contacts = Correction.of(problem).uncertain
    discretisation = problem.body.discretisation
    exact = 0.01 * patch_forces(discretisation, PressSite("z+", (5.0, 5.0, 10.0)), RADIUS_MM)
    change = exact - discretisation.consistent_loads(recording.presses[1].forces)
    case, observation = evaluation.sensitivities[1], evaluation.data.observations[1]
    (moved,) = case.linearization.force_response(change[None])
    error = case.observe(moved) * observation.scale
    presses = MeasuredPresses(problem, linearised=evaluation, rims=contacts)
    rims_error = Rims()
    rims_error.smallest = 0.0
    patterns = rims_error.patterns(presses)
    first, second = np.split(patterns, [len(evaluation.data.observations[0].index)])
    amplitudes = np.linalg.lstsq(second, error, rcond=1e-6)[0]
    assert np.linalg.norm(error) > 1.0
    assert np.linalg.norm(second @ amplitudes - error) < 0.15 * np.linalg.norm(error)
    # In units of its own noise, half the pressure has the same changes but for the deformation.
    np.testing.assert_allclose(first, second, atol=0.1 * np.abs(second).max())
    rims_error.smallest = 1.0
    few = rims_error.patterns(presses)
    assert 0 < few.shape[1] < patterns.shape[1]
    assert np.linalg.norm(few, axis=0).min() > 1.0


@pytest.mark.slow
def test_errors_at_rims_are_kept_while_the_moduli_there_remain(recording, problem, monkeypatch):
    """The meshes of a correction, by the number of their presses; their changes are ordinals."""
    meshes = []

    def changes(self, model, fine, youngs_of, every):
        meshes.append(fine.mesh.n_tets)
        ends = [i for series in every for i in series.ends]
        return {i: np.full_like(model.predicted[i], len(meshes)) for i in ends}

    monkeypatch.setattr(Correction, "_changes", changes)
    kept = KeptRims()
    prior = ShapePrior.of(recording.mesh, 0.2)

    def last_change(*values):
        field = ShapeField(prior, (BALL,) * (len(values) > 1))
        z = field.standard(np.array(values))
        fit, before = fit_shapes(problem, field, z, max_iterations=0)
        # A correction of a later search, which shares what is kept.
        offsets = Correction.of(problem, kept).offsets(fit, before)
        return pytest.approx(offsets[1][0])

    assert last_change(np.log(0.2)) == 1.0
    assert last_change(np.log(0.215)) == 1.0
    assert last_change(np.log(0.25)) == 2.0
    # A deep ball has a mesh without the rim, and the error there is kept: 2 + 3.
    assert last_change(np.log(0.25), 5.0, 5.0, 3.0, np.log(1.5), np.log(4.0)) == 5.0
    # A ball under the contact has a mesh that is fine at both.
    assert last_change(np.log(0.25), 5.0, 5.0, 8.3, np.log(1.5), np.log(4.0)) == 4.0
    rim, _, at_ball, at_both = meshes
    assert at_both > rim
    assert at_both > at_ball


@pytest.mark.slow
@pytest.mark.usefixtures("uniform")
def test_the_search_may_take_tractions_at_rims_as_wrong(presses):
    levels = [e.get("rims", 0.0) for _, e in presses.errors.others(presses.errors.least)]
    assert set(levels) == {0.0, *Rims.levels}
    small, large = (presses.data({**presses.errors.least, "rims": rims}) for rims in (0.1, 0.5))
    assert presses.data(presses.errors.least).log_determinant < small.log_determinant
    assert small.log_determinant < large.log_determinant
    whole = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)
    whole_presses = ShapeProblem(replace(whole, provenance={}), Settings())
    assert "rims" not in [error.name for error in whole_presses.errors.errors]


def test_the_traction_of_a_sensor_is_uncertain_at_edges_of_the_body():
    whole = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)
    whole = replace(whole, provenance={})
    loaded = (whole.presses[0].forces != 0.0).any(axis=1)
    nodes = loaded_end(MESH, loaded)
    across = np.abs(MESH.points[:, :2] - 5.0).max(axis=1)
    assert set(nodes) == set(np.flatnonzero(loaded & (across > 4.99)))
    assert not len(loaded_end(MESH, np.zeros(MESH.n_points, dtype=bool)))
    on_side = np.flatnonzero(loaded)
    one = np.zeros((1, len(on_side), 3))
    one[0, :, 2] = 1e-3
    errors = PressErrors(on_side, 1e-3 * one, one)
    measured = replace(whole, presses=tuple(replace(p, errors=errors) for p in whole.presses))
    presses = ShapeProblem(measured, Settings())
    least = {"discretisation": 0.3, "stated": 1.0, "pose": 0.001, "rims": EDGE_DEVIATION}
    assert presses.errors.least == least
    levels = [errors["rims"] for _, errors in presses.errors.others(least)]
    assert [level for level in levels if level != EDGE_DEVIATION] == [0.5]
    model = presses.uniform()
    without = presses.data({**model.errors, "rims": 0.0})
    assert without.log_determinant < presses.data(model.errors).log_determinant
    before = Start("before", ShapeField(presses.prior), np.zeros(1), {})
    assert presses.continued(before).errors == least


def test_a_search_starts_from_the_deviation_at_rims_of_another(presses):
    field = ShapeField(presses.prior)
    model = presses.first(presses.continued(Start("before", field, np.zeros(1), {"rims": 0.2})))
    assert model.errors == {"discretisation": 0.3, "pose": 0.001, "rims": 0.2}
    assert np.exp(field.physical(model.fit.z)[0]) == pytest.approx(0.2, rel=0.1)


def test_the_result_states_the_deviation_at_rims(presses, uniform, tmp_path):
    model = uniform
    posterior = make_posterior(model, presses.sites)
    result = ShapeReconstruction(model.fit.field, model.fit.z, posterior, 1.0, (), 0.0)
    plain = replace(result, errors={"rims": 0.2}).plain()
    assert ShapeReconstruction.of(plain).rim_deviation == 0.2
    write_json(tmp_path / "shapes.json", plain)
    assert tactorch.load(tmp_path / "shapes.json").rim_deviation == 0.2
    del plain["errors"]  # as in files of earlier versions
    plain["force_deviation"] = 0.05
    plain["prior"]["outside_mm"] = None
    assert ShapeReconstruction.of(plain).errors == {"forces": 0.05}
    plain |= {"pose_deviation": 0.001, "rim_deviation": 0.1}
    assert ShapeReconstruction.of(plain).errors == {"forces": 0.05, "pose": 0.001, "rims": 0.1}
    plain["prior"]["outside_mm"] = 1.0  # of a palpation
    assert ShapeReconstruction.of(plain).errors["smooth_forces"] == 0.05
