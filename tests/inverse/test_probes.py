"""Presses by rigid probes in an inverse problem."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import NewtonOptions
from tactorch.fem.contact import Ball, FlatPunch
from tactorch.inverse import IncrementalInversion, InverseProblem, NoiseModel, find_shapes
from tactorch.inverse.data.nuisance import NuisancePrior
from tactorch.inverse.data.observations import group_by_contact
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.forces import Forces
from tactorch.inverse.errors.pose import Pose
from tactorch.inverse.fields import FAMILIES, ShapeField, ShapePrior, Sites
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.inverse.forward.footprint import Footprint, largest_depth, loaded_nodes
from tactorch.mesh import box_mesh, face_nodes
from tactorch.recording import (
    ForceReading,
    MaterialSpec,
    Press,
    ProbePose,
    Recording,
    SurfaceReading,
)

MESH = box_mesh(10.0, 4, tets_per_cell=5)
BALL = Ball(4.0)
YOUNGS = 0.2 * np.exp(0.2 * np.random.default_rng(0).standard_normal(MESH.n_tets))
AXES = np.vstack([np.eye(3, 6), [[0.1, 0.2, 0.3, 0.5, -0.4, 0.2]]])
SURFACE = SurfaceReading(
    np.array([[2.0, 3.0, 10.0], [8.0, 8.5, 9.9]]),
    np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]]),
    np.array([0.1, 0.1]),
    np.array([0.01, 0.02]),
)


FIXED = np.zeros((MESH.n_points, 3), dtype=bool)
FIXED[face_nodes(MESH, "z-")] = True


def _press(x: float, y: float, depth: float, **changes) -> Press:
    fields = {
        "probe": ProbePose(BALL, np.array([x, y, 14.0 - depth])),
        "force": ForceReading(AXES, np.ones(4), np.full(4, 0.01), np.array([5.0, 5.0, 10.0])),
        "name": f"({x}, {y})",
    }
    return Press.by_probe(n_points=MESH.n_points, fixed=FIXED, **{**fields, **changes})


def _seen() -> Press:
    """A press whose surface a camera sees as well."""
    observed = np.zeros((MESH.n_points, 3), dtype=bool)
    observed[face_nodes(MESH, "z+")[:5]] = True
    displacement = np.where(observed, 0.01, np.nan)
    return _press(
        4.0, 6.0, 0.7, observed=observed, displacement=displacement, noise_mm=0.01, surface=SURFACE
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Presses of which the data are those of the map, with linear elements."""
    presses = (_press(5.0, 5.0, 1.0), _press(5.0, 5.0, 0.6), _seen())
    first = Recording(MESH, presses, MaterialSpec("neo_hookean", 0.4))
    predicted = _problem(first).evaluate(YOUNGS).predicted
    measured = []
    for press, values in zip(presses, predicted, strict=True):
        assert press.force is not None
        measured.append(replace(press, force=replace(press.force, values=values[-4:])))
    return replace(first, presses=tuple(measured))


def _problem(recording: Recording, element: str = "tet4") -> InverseProblem:
    return InverseProblem(recording, element=element, newton=NewtonOptions(rtol=1e-12))


@pytest.mark.parametrize("element", ["tet4", pytest.param("tet10", marks=pytest.mark.slow)])
def test_derivatives_are_finite_differences(recording: Recording, element: str) -> None:
    problem = _problem(recording, element)
    evaluation = problem.evaluate(YOUNGS)
    jacobian = evaluation.jacobian()
    assert jacobian.shape == (problem.n_data, MESH.n_tets) == (4 + 4 + 15 + 2 + 4, MESH.n_tets)
    change, step = YOUNGS * np.random.default_rng(1).standard_normal(len(YOUNGS)), 1e-5
    plus, minus = (problem.evaluate(YOUNGS + s * step * change).residuals for s in (1, -1))
    expected = (plus - minus) / (2.0 * step)
    atol = 1e-6 * np.abs(expected).max()
    np.testing.assert_allclose(jacobian @ change, expected, atol=atol)
    np.testing.assert_allclose(evaluation.jacobian_times(change), expected, atol=atol)
    columns, fields = evaluation.linear_response(change[None])
    np.testing.assert_allclose(columns[:, 0], expected, atol=atol)
    assert len(fields) == 3
    weights = np.random.default_rng(2).standard_normal(len(expected))
    np.testing.assert_allclose(
        evaluation.transpose_times(weights), jacobian.T @ weights, rtol=1e-9, atol=1e-9
    )


def test_motions_of_probes_are_finite_differences(recording: Recording) -> None:
    recording = replace(recording, presses=recording.presses[::2])
    problem = _problem(recording, "tet10")
    motions = problem.evaluate(YOUNGS).probe_motions()
    for k, axis in ((0, 2), (1, 0)):
        seen = []
        for sign in (1.0, -1.0):
            moved = _problem(recording, "tet10")
            contacts = list(problem._contacts)
            shift = sign * 1e-5 * np.eye(3)[axis]
            contacts[k] = replace(contacts[k], position_mm=contacts[k].position_mm + shift)
            moved.__dict__["_contacts"] = contacts
            seen.append(np.split(moved.evaluate(YOUNGS).residuals, moved.data.begins[1:])[k])
        expected = (seen[0] - seen[1]) / 2e-5
        atol = 1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(motions[k][:, axis], expected, atol=atol)


def test_presses_at_one_place_share_the_error_of_the_pose(recording: Recording) -> None:
    problem = _problem(recording)
    evaluation = problem.evaluate(YOUNGS)
    patterns = Pose().patterns(MeasuredPresses(problem, linearised=evaluation))
    assert patterns.shape == (29, 6)  # two places
    motions = evaluation.probe_motions()
    np.testing.assert_allclose(patterns[:8, :3], 1.0 * np.vstack(motions[:2]), rtol=2e-3)
    assert not patterns[8:, :3].any()


def test_the_uniform_modulus_follows_from_forces_alone(recording: Recording) -> None:
    uniform = np.full(MESH.n_tets, 0.07)
    predicted = _problem(recording).evaluate(uniform).predicted
    presses = []
    for press, values in zip(recording.presses[:2], predicted[:2], strict=True):
        presses.append(replace(press, force=replace(press.force, values=values)))
    forces_only = replace(recording, presses=tuple(presses))
    fit = uniform_fit(_problem(forces_only))
    # The stiffness of the contact is that of another modulus than in the presses.
    assert fit.youngs_mpa == pytest.approx(0.07, rel=0.02)


def test_force_patterns_are_relative_errors_of_the_measured_force(recording: Recording) -> None:
    evaluation = _problem(recording).evaluate(YOUNGS)
    presses = MeasuredPresses(_problem(recording), linearised=evaluation)
    patterns = Forces().patterns(presses).toarray()
    assert patterns.shape == (29, 3)
    first = recording.presses[0].force
    np.testing.assert_allclose(patterns[:4, 0], first.values / first.deviations)
    assert not patterns[8:25, 2].any()  # displacements are not affected


def test_a_probe_that_does_not_touch_is_named(recording: Recording) -> None:
    away = replace(recording.presses[1], probe=ProbePose(BALL, np.array([5.0, 5.0, 15.0])))
    problem = _problem(replace(recording, presses=(recording.presses[0], away)))
    with pytest.raises(ConfigError, match=r"press '\(5.0, 5.0\)'.*1 mm away"):
        problem.evaluate(YOUNGS)


def test_nuisance_of_the_sensor_is_refused_with_a_probe(recording: Recording) -> None:
    with pytest.raises(ConfigError, match="force_scale cannot be estimated"):
        InverseProblem(recording, nuisance=NuisancePrior(force_scale=0.1))


@pytest.mark.parametrize(
    ("probe", "height_mm", "radius_mm"),
    [(Ball(4.0), 13.0, 2.0), (FlatPunch(2.5), 9.4, 2.5)],
)
def test_footprints_are_those_of_hertz_and_of_the_punch(probe, height_mm, radius_mm) -> None:
    pose = ProbePose(probe, np.array([5.2, 4.9, height_mm]))
    footprint = Footprint.of(pose, MESH)
    assert footprint.radius_mm == pytest.approx(radius_mm, rel=0.08)
    across = np.linalg.norm(footprint.points[:, :2] - [5.2, 4.9], axis=1)
    assert across.max() == pytest.approx(radius_mm, rel=0.1)
    at_rim = np.linalg.norm(footprint.rim[:, :2] - [5.2, 4.9], axis=1)
    assert at_rim.min() > 0.7 * radius_mm
    press = _press(5.2, 4.9, 1.0, probe=pose)
    nodes = MESH.points[loaded_nodes(press, MESH)]
    assert len(nodes)
    assert np.linalg.norm(nodes[:, :2] - [5.2, 4.9], axis=1).max() <= radius_mm + 1e-9


@pytest.mark.slow
def test_an_inclusion_is_found_by_the_forces_of_a_probe() -> None:
    """Presses computed on the mesh of the inversion, which is stated: the search is tested."""
    mesh = box_mesh(10.0, 6, tets_per_cell=5)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    fixed.setflags(write=False)
    dummy = ForceReading.vector((0.0, 0.0, 0.2), 0.002)
    presses = tuple(
        Press.by_probe(
            ProbePose(Ball(3.0), np.array([x, y, 13.0 - depth])),
            mesh.n_points,
            force=dummy,
            fixed=fixed,
        )
        for x in (2.0, 4.0, 6.0, 8.0)
        for y in (2.0, 4.0, 6.0, 8.0)
        for depth in (0.6, 1.2)
    )
    crime = {"inverse_crime": True, "element": "tet4"}
    first = Recording(mesh, presses, MaterialSpec("neo_hookean", 0.4), provenance=crime)
    problem = InverseProblem(first)
    field = ShapeField(ShapePrior.of(mesh, 0.2), (FAMILIES["ball"],))
    truth = np.array([np.log(0.2), 4.5, 5.5, 6.6, np.log(2.0), np.log(5.0)])
    sites = Sites.of(problem.body.assembly)
    youngs = np.exp(field.log_youngs(field.standard(truth), sites)).reshape(sites.shape)
    predicted = problem.evaluate(youngs).predicted
    rng = np.random.default_rng(0)
    noisy = [
        replace(p, force=replace(dummy, values=values + 0.002 * rng.standard_normal(3)))
        for p, values in zip(presses, predicted, strict=True)
    ]
    found = find_shapes(replace(first, presses=tuple(noisy)))
    assert len(found.inclusions) == 1
    inclusion = found.inclusions[0]
    np.testing.assert_allclose(inclusion.shape.center_mm, truth[1:4], atol=0.4)
    assert inclusion.probability > 0.95
    low, high = inclusion.youngs_90_mpa
    assert 0.3 < low < 1.0 < 1.5 * high  # 0.2 MPa around it
    assert 0.7 < found.chi2 < 1.3


def test_the_exact_hessian_is_refused(recording: Recording) -> None:
    evaluation = _problem(recording).evaluate(YOUNGS)
    with pytest.raises(ConfigError, match="exact Hessian is not known"):
        evaluation.second_order_times(YOUNGS)


def test_the_noise_of_readings_is_stated(recording: Recording) -> None:
    forces_only = replace(recording, presses=recording.presses[:2])
    assert not NoiseModel().assumed(forces_only)
    assert not NoiseModel().floored(forces_only)
    seen = replace(recording.presses[2], noise_mm=None)
    assert NoiseModel().assumed(replace(recording, presses=(recording.presses[0], seen)))


def test_forces_on_the_object_instead_of_the_probe_are_refused(recording: Recording) -> None:
    presses = tuple(
        replace(press, force=replace(press.force, values=-press.force.values))
        for press in recording.presses
    )
    with pytest.raises(ConfigError, match="pull the probe into the body"):
        _problem(replace(recording, presses=presses)).evaluate(YOUNGS)


def test_steps_that_differ_by_their_data_are_one_contact(recording: Recording) -> None:
    forces = np.zeros((MESH.n_points, 3))
    forces[face_nodes(MESH, "z+"), 2] = -1e-3
    first = replace(_seen(), probe=None, force=None, forces=forces)
    other = replace(SURFACE, displacement_mm=np.array([0.2, 0.2]))
    second = replace(first, forces=2.0 * forces, surface=other)
    assert group_by_contact((first, second)) == [(0, 1)]
    assert len(group_by_contact(recording.presses[:2])) == 2  # other depths


def test_a_probe_between_the_nodes_has_a_footprint() -> None:
    triangle = MESH.surface.triangles[
        np.argmax(MESH.points[MESH.surface.triangles].mean(axis=1)[:, 2])
    ]
    x, y, z = MESH.points[triangle].mean(axis=0)
    press = _press(x, y, 0.0, probe=ProbePose(Ball(0.5), np.array([x, y, z + 0.4])))
    assert largest_depth(press.probe, MESH) == pytest.approx(0.1, rel=0.1)
    assert loaded_nodes(press, MESH).sum() == 1
    away = ProbePose(Ball(0.5), np.array([x, y, z + 0.6]))
    with pytest.raises(ConfigError, match="does not touch the body"):
        Footprint.of(away, MESH)


def test_a_session_takes_presses_by_a_probe(recording: Recording) -> None:
    session = IncrementalInversion(recording)
    result = session.add(recording.presses[:2])
    assert len(session.recording.presses) == 2
    assert result.point.evaluation.chi2 < 2.0
