"""Errors of the places of contacts: presses beside the places that are reported."""

from dataclasses import replace

import numpy as np
import pytest

import tactorch
from tactorch.fem import Discretisation, SoftBody, Supports, make_material
from tactorch.fem.elements import ELEMENTS
from tactorch.fem.transfer import Transfer
from tactorch.files import write_json
from tactorch.inverse import Settings, find_shapes
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.shapes.correction import Correction
from tactorch.inverse.shapes.field import ShapeField
from tactorch.inverse.shapes.model import PLACE_DEVIATIONS, Errors, make_posterior
from tactorch.inverse.shapes.places import along_surface, moved_load, place_patterns
from tactorch.inverse.shapes.problem import ShapeProblem
from tactorch.inverse.shapes.result import ShapeReconstruction, ShapeState
from tactorch.mesh import Box, Sphere, box_mesh, face_nodes
from tactorch.mesh.tractions import LoadedSurface
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.simulation.patch import patch_forces
from tactorch.simulation.plan import PressSite

RADIUS_MM, PRESSURE_MPA, POISSON = 2.5, 0.005, 0.45
MESH = box_mesh(10.0, 8, tets_per_cell=5)
LINEAR, QUADRATIC = (Discretisation(MESH, ELEMENTS[name]) for name in ("tet4", "tet10"))
BALL = Sphere((5.0, 5.5, 6.5), 2.0)
CENTERS = tuple((x, y, 10.0) for x in (3.0, 7.0) for y in (3.0, 7.0))
SHIFTS = 0.4 * np.array([[1.0, 0.0, 0.0], [-0.6, 0.8, 0.0], [0.0, -1.0, 0.0], [0.8, 0.6, 0.0]])
TOP = np.array([0.0, 0.0, 1.0])


def recorded(shifts, relative_noise=0.0, mesh=MESH):
    """Presses of a cube with a ball that are displaced from where they report, by tet10."""
    youngs = np.where(BALL.contains(mesh.centroids), 1.0, 0.2)
    body = SoftBody(mesh, make_material("neo_hookean", POISSON), element="tet10")
    bottom, of_mesh = (face_nodes(m, "z-") for m in (mesh, MESH))
    springs, springs_of_mesh = np.zeros((mesh.n_points, 3)), np.zeros((MESH.n_points, 3))
    springs_of_mesh[of_mesh] = 1.0
    springs[bottom] = len(of_mesh) / len(bottom)
    rng, presses = np.random.default_rng(0), []
    for k, (center, shift) in enumerate(zip(CENTERS, shifts, strict=True)):
        places = [PressSite("z+", tuple(np.array(center) + s)) for s in (0.0 * shift, shift)]
        forces = PRESSURE_MPA * patch_forces(LINEAR, places[0], RADIUS_MM)
        actual = PRESSURE_MPA * patch_forces(body.discretisation, places[1], RADIUS_MM)
        actual *= forces.sum() / actual.sum()
        search = body.search(youngs, actual, Supports(springs=springs))
        motion = search.run(None).require().displacement
        distance = np.linalg.norm(MESH.points - center, axis=1)
        nodes = np.flatnonzero((distance < RADIUS_MM) & (MESH.points[:, 2] > 9.999))
        displacement = np.full((MESH.n_points, 3), np.nan)
        displacement[nodes] = Transfer.between(body.discretisation, MESH.points[nodes] + shift)(
            motion
        )
        noise = (relative_noise or 0.01) * float(np.std(displacement[nodes]))
        if relative_noise:
            displacement[nodes] += noise * rng.standard_normal((len(nodes), 3))
        observed = np.zeros((MESH.n_points, 3), dtype=bool)
        observed[nodes] = True
        presses.append(
            Press(
                forces,
                observed,
                displacement,
                springs=springs_of_mesh,
                noise_mm=noise,
                direction=-TOP,
                name=f"patch {k}",
            )
        )
    return Recording(MESH, tuple(presses), MaterialSpec("neo_hookean", POISSON))


@pytest.fixture(scope="module")
def misplaced():
    return recorded(SHIFTS, relative_noise=0.01)


@pytest.mark.parametrize("discretisation", [LINEAR, QUADRATIC], ids=["tet4", "tet10"])
def test_a_moved_load_has_no_total_and_the_moment_of_its_motion(discretisation):
    forces = patch_forces(LINEAR, PressSite("z+", (4.0, 6.0, 10.0)), RADIUS_MM)
    direction = np.array([0.6, -0.8, 0.0])
    change = moved_load(discretisation, forces, direction)
    points = np.concatenate([MESH.points, MESH.points[discretisation.edges].mean(axis=1)])
    np.testing.assert_allclose(change.sum(axis=0), 0.0, atol=1e-12)
    first_moment = np.einsum("nc,nd->cd", points[: len(change)], change)
    np.testing.assert_allclose(
        first_moment, np.outer(direction, forces.sum(axis=0)), atol=1e-9 * np.abs(forces).sum()
    )
    assert not change[points[: len(change), 2] < 9.999].any()


def test_a_moved_load_is_the_change_of_the_integrals():
    """A smooth pressure that ends at the edges of triangles, moved by a small distance."""

    def load(center):
        distance = np.linalg.norm(MESH.points[:, :2] - center, axis=1)
        traction = np.exp(-((distance / 2.0) ** 2))[:, None] * TOP
        return traction

    top = face_nodes(MESH, "z+")
    values = np.zeros((MESH.n_points, 3))
    values[top] = load(np.array([5.0, 5.0]))[top]
    loaded = LoadedSurface.of(MESH.surface, values)
    forces = loaded.mass @ values
    direction, step = np.array([0.6, 0.8, 0.0]), 0.05
    expected = []
    for sign in (1.0, -1.0):
        moved = np.zeros_like(values)
        moved[top] = load(np.array([5.0, 5.0]) + sign * step * direction[:2])[top]
        expected.append(loaded.mass @ moved)
    change = moved_load(LINEAR, forces, direction)
    inner = np.abs(MESH.points[:, :2] - 5.0).max(axis=1) < 4.0
    difference = change - (expected[0] - expected[1]) / (2.0 * step)
    assert np.linalg.norm(difference[inner]) < 0.1 * np.linalg.norm(change[inner])


@pytest.mark.parametrize(("discretisation", "degree"), [(LINEAR, 1), (QUADRATIC, 2)])
def test_derivatives_along_the_surface_are_exact(discretisation, degree):
    points = np.concatenate([MESH.points, MESH.points[discretisation.edges].mean(axis=1)])
    x, y, z = points[: discretisation.n_nodes].T
    direction = np.array([0.6, -0.8, 0.0])
    bend = degree - 1
    field = np.column_stack([2.0 * x + bend * x * y, y - z, bend * y**2 + x])
    slope = along_surface(discretisation, field, direction, TOP)
    top = face_nodes(MESH, "z+")
    x, y = MESH.points[top, :2].T
    exact = np.column_stack([
        0.6 * (2.0 + bend * y) - 0.8 * bend * x, np.full(len(top), -0.8), 0.6 - 1.6 * bend * y
    ])  # fmt: skip
    np.testing.assert_allclose(slope[top], exact, atol=1e-10)
    assert not slope[face_nodes(MESH, "z-")].any()


def test_patterns_explain_presses_beside_their_places():
    """Presses solved at the true places, against those at the reported ones."""
    moved, still = recorded(SHIFTS), recorded(np.zeros((4, 3)))
    problem = InverseProblem(still, element="tet10")
    evaluation = problem.evaluate(np.where(BALL.contains(MESH.centroids), 1.0, 0.2))
    contacts = Correction.of(problem, "tet10", "auto").movable
    assert len(contacts) == len(CENTERS)
    patterns = place_patterns(still, evaluation, contacts, 0.0)
    assert patterns.shape[1] == 2 * len(CENTERS)
    begins = [*evaluation.data.begins, len(patterns)]
    for k, (one, other) in enumerate(zip(moved.presses, still.presses, strict=True)):
        scale = evaluation.data.observations[k].scale
        effect = scale * (one.displacement - other.displacement)[one.observed]
        columns = patterns[begins[k] : begins[k + 1], 2 * k : 2 * k + 2]
        amplitudes = np.linalg.lstsq(columns, effect, rcond=None)[0]
        assert np.linalg.norm(effect - columns @ amplitudes) < 0.2 * np.linalg.norm(effect)
        assert np.linalg.norm(amplitudes) == pytest.approx(0.4 / contacts[k][1].radius_mm, rel=0.25)
        # Patterns of one contact do not reach the others.
        others = np.delete(patterns[begins[k] : begins[k + 1]], [2 * k, 2 * k + 1], axis=1)
        assert not others.any()
    norms = np.sort(np.linalg.norm(patterns, axis=0))
    few = place_patterns(still, evaluation, contacts, float(norms[3:5].mean()))
    assert few.shape[1] == 4


def test_the_search_may_take_contacts_as_misplaced(misplaced):
    presses = ShapeProblem(misplaced, Settings())
    assert presses.has_places
    model = presses.uniform()
    others = dict(presses.least_errors.others(presses.least_errors, True, True))
    assert {errors.places for errors in others.values()} == {0.0, *PLACE_DEVIATIONS}
    assert others["contacts misplaced by 10%"] == presses.least_errors._replace(places=0.1)
    plain, wrong = (presses.data(model.errors._replace(places=p)) for p in (0.0, 0.1))
    assert plain.log_determinant < wrong.log_determinant
    before = ShapeState(ShapeField(presses.prior), np.zeros(1), 0.0, 0.001, 0.0, 0.1)
    assert presses.continued(before).errors == Errors(0.0, 0.001, 0.0, 0.1)


def test_the_result_states_how_far_contacts_are_misplaced(misplaced, tmp_path):
    presses = ShapeProblem(misplaced, Settings())
    model = presses.uniform()
    posterior = make_posterior(model, presses.sites)
    result = ShapeReconstruction(model.fit.field, model.fit.z, posterior, 1.0, (), 0.0)
    plain = replace(result, place_deviation=0.1).plain()
    write_json(tmp_path / "shapes.json", plain)
    assert tactorch.load(tmp_path / "shapes.json").place_deviation == 0.1
    del plain["place_deviation"]  # as in files of earlier versions
    assert ShapeReconstruction.of(plain).place_deviation == 0.0


@pytest.mark.slow
def test_misplaced_contacts_are_recognised():
    """Presses on a finer mesh that follows the ball."""
    phantom = Phantom(Box((5.0,) * 3, (10.0,) * 3), [(BALL, 1.0)], 0.2)
    mesh = phantom.mesh(0.9, conforming=True)
    result = find_shapes(recorded(SHIFTS, 0.01, mesh), max_shapes=2)
    assert result.place_deviation >= 0.1
    assert result.chi2 < 1.3
    (inclusion,) = result.inclusions
    assert np.linalg.norm(np.subtract(inclusion.shape.center_mm, BALL.center_mm)) < 0.5
    honest = find_shapes(recorded(0.0 * SHIFTS, 0.01, mesh), max_shapes=2)
    assert honest.place_deviation == 0.0
