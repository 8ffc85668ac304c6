"""Searches through the equilibrium of gel and object: derivatives, and a ball from its markers.

The presses are solved on another, finer mesh.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.interpolate import CloughTocher2DInterpolator

from tactorch.errors import CancelledError, ConfigError, MeshError
from tactorch.inverse import Settings
from tactorch.inverse.fields import BALL, InclusionShape, ShapeField, ShapePrior
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.forward.gel import GelProblem, has_markers, pressed, within_contacts
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.gel import SensorSearch, _are_near
from tactorch.inverse.search.gel_correction import gel_sites, with_gel_errors
from tactorch.inverse.search.model import Model, TimeLimit
from tactorch.inverse.search.search import _through_gel, find_shapes
from tactorch.mesh import Box, Sphere, box_mesh
from tactorch.phantoms import Phantom
from tactorch.recording import GelReading, MaterialSpec, Press, Recording
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.touch import TouchOptions, TouchScene

LAYER = GelLayer(4.0, 0.12, 0.45, size_mm=(14.0, 14.0))
SENSOR = SensorDescription(
    "small", (140, 140), (0.1, 0.1), LAYER, MarkerGrid(11, 11, (1.2, 1.2), 0.3)
)
CENTER, RADIUS, YOUNGS, AROUND = (5.5, 4.6, 6.8), 2.0, 0.8, 0.2
MATERIAL = MaterialSpec("neo_hookean", 0.45)
NOISE = 5e-4
DEPTHS = (0.4, 0.8)


def poses() -> list[np.ndarray]:
    """Sensor above the top of the cube, and in front of its side x+."""
    top, side = np.eye(4), np.eye(4)
    top[:3, :3] = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
    top[:3, 3] = (5.0, 5.0, 10.0)
    side[:3, :3] = [(0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)]
    side[:3, 3] = (10.0, 5.0, 5.0)
    return [top, side]


def make_recording(moved: list[np.ndarray]) -> Recording:
    """Displacements of the markers in two presses of each side, on a mesh of 6 cells a side."""
    mesh, presses = box_mesh(10.0, 6), []
    markers, nothing = SENSOR.markers.positions_mm, np.zeros((len(mesh.points), 3))
    for number, one in enumerate(moved):
        first, axis = poses()[number // 2], (2, 0)[number // 2]
        pose = first.copy()
        pose[:3, 3] += DEPTHS[number % 2] * pose[:3, 2]
        fixed = np.repeat(np.abs(mesh.points[:, axis, None]) < 1e-9, 3, axis=1)
        gel = GelReading(
            LAYER.numbers, pose, first, markers, one,
            np.hypot(NOISE, 0.01 * np.linalg.norm(one, axis=1)), np.array([0.03, 0.01, 1e-3]),
        )  # fmt: skip
        forces = np.where(mesh.points[:, axis, None] > 9.99, 0.01 * pose[:3, 2], 0.0)
        presses.append(Press(forces, ~fixed, nothing + 0.1, fixed=fixed, gel=gel, noise_mm=0.01))
    return Recording(mesh, tuple(presses), MATERIAL, check_units=False)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Presses in which markers do not move."""
    return make_recording([np.zeros(SENSOR.markers.positions_mm.shape)] * 4)


@pytest.fixture(scope="module")
def solved() -> Recording:
    """Presses as they are, without noise, solved on finer meshes."""
    phantom = Phantom(Box((5.0, 5.0, 5.0), 10.0), ((Sphere(CENTER, RADIUS), YOUNGS),), AROUND)
    markers, moved = SENSOR.markers.positions_mm, []
    for pose, held in zip(poses(), ("z-", "x-"), strict=True):
        options = TouchOptions(gel_edge_mm=0.65, gel_layers=6, held=0.0, held_side=held)
        scene = TouchScene(phantom, box_mesh(10.0, 17), MATERIAL, SENSOR, options)
        for press in scene.press(pose, [np.array([0.0, 0.0, depth]) for depth in DEPTHS]):
            between = CloughTocher2DInterpolator(
                press.gel_points[:, :2], press.gel_displacement[:, :2]
            )
            moved.append(between(markers))
    return make_recording(moved)


def field_and_truth(recording: Recording) -> tuple[ShapeField, np.ndarray]:
    field = ShapeField(ShapePrior.of(recording.mesh, AROUND), (BALL,))
    values = np.array([np.log(AROUND), *CENTER, np.log(RADIUS), np.log(YOUNGS / AROUND)])
    return field, field.standard(values)


@pytest.fixture(scope="module")
def problem(recording: Recording) -> GelProblem:
    return GelProblem(recording, AROUND, cells=7)


def test_derivatives_are_those_of_differences(problem: GelProblem, recording: Recording) -> None:
    field, z = field_and_truth(recording)
    family = ShapesOnSites(field, gel_sites(recording.mesh))
    evaluation = problem.evaluate(family.at(z).youngs)
    jacobian = family.at(z).jacobian(evaluation)
    for k in (0, len(z) - 1):
        ends = []
        for step in (0.02, -0.02):
            other = z + step * np.eye(len(z))[k]
            ends.append(problem.evaluate(family.at(other).youngs, starts=evaluation.displacements))
        expected = (ends[0].residuals - ends[1].residuals) / 0.04
        size = np.linalg.norm(expected)
        assert np.linalg.norm(jacobian[:, k] - expected) < 0.03 * size


def moved_sensor(recording: Recording, change: np.ndarray) -> Recording:
    """Presses with a sensor that is moved, with its motion, by a change in its frame at first."""
    presses = []
    for press in recording.presses:
        first = press.gel.first_pose
        whole = first @ change @ np.linalg.inv(first)
        poses = {name: whole @ getattr(press.gel, name) for name in ("pose", "first_pose")}
        presses.append(replace(press, gel=replace(press.gel, **poses)))
    return replace(recording, presses=tuple(presses), check_units=False)


def test_errors_of_gel_and_pose_are_what_they_change(
    problem: GelProblem, recording: Recording
) -> None:
    """One column for the gel of all presses, and three for the pose of each contact."""
    field, z = field_and_truth(recording)
    youngs = ShapesOnSites(field, gel_sites(recording.mesh)).at(z).youngs
    evaluation = problem.evaluate(youngs)
    columns = evaluation.uncertain(problem.contact_of, problem.readings)
    assert columns.shape == (len(evaluation.residuals), 1 + 2 * 3)
    half = len(columns) // 2
    assert not columns[half:, 1:4].any()
    assert not columns[:half, 4:].any()

    def change(other: Recording) -> np.ndarray:
        found = GelProblem(other, AROUND, cells=7).evaluate(youngs).residuals
        return found - evaluation.residuals

    # A stiffer gel: the log-modulus has a deviation of 0.03.
    stiffer = [
        replace(p, gel=replace(p.gel, layer=replace(LAYER, youngs_mpa=0.12 * 1.01).numbers))
        for p in recording.presses
    ]
    expected = change(replace(recording, presses=tuple(stiffer))) * 0.03 / np.log(1.01)
    assert np.linalg.norm(columns[:, 0] - expected) < 0.05 * np.linalg.norm(expected)
    # A sensor that is 0.01 mm further along its axis than stated, and one that is tilted.
    deeper, tilted = np.eye(4), np.eye(4)
    deeper[2, 3] = 0.01
    c, s = np.cos(1e-3), np.sin(1e-3)
    tilted[1:3, 1:3] = [(c, -s), (s, c)]
    found, expected = columns[:, 1] + columns[:, 4], change(moved_sensor(recording, deeper))
    assert np.linalg.norm(found - expected) < 0.1 * np.linalg.norm(expected)
    # That of a tilt leaves out that the press turns too, which lowers it with the depth.
    found, expected = columns[:, 2] + columns[:, 5], change(moved_sensor(recording, tilted))
    for k, (least, most) in enumerate([(0.6, 0.9), (0.35, 0.6)] * 2):
        one, other = (np.split(values, 4)[k] for values in (found, expected))
        assert np.corrcoef(one, other)[0, 1] > 0.9
        assert least < one @ other / (one @ one) < most
    # Two sensors have two gels.
    other = replace(problem.readings[-1], layer=replace(LAYER, thickness_mm=3.9).numbers)
    two = evaluation.uncertain(problem.contact_of, [*problem.readings[:-1], other])
    assert two.shape[1] == columns.shape[1] + 1


def test_markers_at_rest_are_errors_that_presses_have_in_common(
    problem: GelProblem, recording: Recording
) -> None:
    """A marker has one error for each component in all presses, of half of its variance."""
    columns, count = problem.marker_errors.toarray(), len(SENSOR.markers.positions_mm)
    assert columns.shape == (len(problem.data.values), 2 * count)
    np.testing.assert_array_equal(columns, np.tile(np.eye(2 * count), (4, 1)))
    stated = np.concatenate([np.repeat(r.deviations_mm, 2) for r in problem.readings])
    np.testing.assert_allclose(1.0 / problem.data.scale, stated / np.sqrt(2.0))
    # Those of another sensor have others.
    press = recording.presses[-1]
    layer = replace(LAYER, thickness_mm=3.9).numbers
    presses = (*recording.presses[:-1], replace(press, gel=replace(press.gel, layer=layer)))
    two = GelProblem(replace(recording, presses=presses, check_units=False), AROUND, cells=7)
    assert two.marker_errors.shape[1] == 4 * count


def test_errors_of_the_discretisation_are_smooth_and_belong_to_a_contact(
    recording: Recording,
) -> None:
    """Covariance of the data where the modulus of the gel and the pose are certain."""
    moving = make_recording([0.02 * SENSOR.markers.positions_mm] * 4)
    certain = [replace(p, gel=replace(p.gel, uncertain=np.zeros(3))) for p in moving.presses]
    problem = GelProblem(replace(moving, presses=tuple(certain)), AROUND, cells=7)
    field, z = field_and_truth(recording)
    evaluation = problem.evaluate(ShapesOnSites(field, gel_sites(recording.mesh)).at(z).youngs)
    data = with_gel_errors(problem, evaluation, [np.full(n, 1e-3) for n in problem.data.counts])
    np.testing.assert_allclose(data.values, problem.data.values - 1e-3)
    assert data.correlated is not None
    patterns = data.correlated.patterns / data.scale[:, None]
    covariance = (patterns @ patterns.T).reshape(4, -1, 2, 4, len(SENSOR.markers.positions_mm), 2)
    remaining, size = 1e-4, np.sqrt(np.mean(moving.presses[0].gel.displacement_mm ** 2))
    smooth = np.hypot(0.003 * size, remaining)
    at_rest = moving.presses[0].gel.deviations_mm[60] ** 2 / 2
    assert covariance[0, 60, 0, 0, 60, 0] == pytest.approx(
        remaining**2 + smooth**2 + at_rest, rel=1e-2
    )
    # A neighbour, the other component, the other press of the contact, and the other contact.
    beside = covariance[0, 60, 0, 0, 61, 0] - remaining**2
    assert 0.8 * smooth**2 < beside < smooth**2
    assert covariance[0, 60, 0, 0, 61, 1] == pytest.approx(remaining**2)
    assert covariance[0, 60, 0, 1, 61, 0] == pytest.approx(beside + remaining**2)
    assert covariance[0, 60, 0, 2, 61, 0] == pytest.approx(0.0, abs=1e-15)
    assert covariance[0, 60, 0, 2, 60, 0] == pytest.approx(at_rest)


@pytest.mark.slow
def test_a_ball_is_found_from_the_markers(solved: Recording) -> None:
    """Modulus, radius and place, by the markers alone.

    Without noise, what is left is the error of the discretisation, which intervals allow for.
    """
    found = find_shapes(solved, Settings(method="inclusions"))
    assert found.through_gel
    assert found.chi2 < 0.1
    (lump,) = found.inclusions
    assert np.linalg.norm(np.subtract(lump.shape.center_mm, CENTER)) < 0.05
    assert lump.radius_90_mm.low < RADIUS < lump.radius_90_mm.high
    assert lump.youngs_90_mpa.low < YOUNGS < lump.youngs_90_mpa.high
    assert lump.youngs_90_mpa.high < 1.8 * lump.youngs_90_mpa.low
    assert found.background_mpa == pytest.approx(AROUND, rel=0.05)
    assert lump.shape.radius_mm == pytest.approx(RADIUS, rel=0.05)
    assert lump.youngs_mpa == pytest.approx(YOUNGS, rel=0.2)
    # Predictions are of the nodes of the object, in all presses: the first one is from above.
    assert found.predictions is not None
    moved, points = found.predictions.displacements, solved.mesh.points
    assert moved.shape == (4, len(points), 3)
    middle = np.linalg.norm(points - (5.0, 5.0, 10.0), axis=1).argmin()
    assert -DEPTHS[1] < moved[1, middle, 2] < 1.5 * moved[0, middle, 2] < 0.0
    middle = np.linalg.norm(points - (10.0, 5.0, 5.0), axis=1).argmin()
    assert -DEPTHS[1] < moved[3, middle, 0] < 1.5 * moved[2, middle, 0] < 0.0


def test_markers_within_the_contact_are_used(problem: GelProblem, recording: Recording) -> None:
    """The contact ends at the edges of the cube, 5 mm from the axis of the sensor."""
    field, z = field_and_truth(recording)
    youngs = ShapesOnSites(field, gel_sites(recording.mesh)).at(z).youngs
    rims = problem.rims(problem.evaluate(youngs))
    assert rims[0].size_mm == pytest.approx(10.0, rel=0.1)
    left, numbers = within_contacts(recording, rims, 0.08)
    assert numbers == [*range(len(recording.presses))]
    markers = left.presses[0].gel.markers_mm
    assert 25 <= len(markers) <= 81
    assert np.abs(markers).max() < 5.0
    assert np.abs(markers).max() > 3.0
    assert len(left.presses[0].gel.displacement_mm) == len(markers)
    # A press with few of them is left out.
    few = recording.presses[0].gel
    few = replace(few, markers_mm=few.markers_mm[:3] * 0.1, displacement_mm=np.zeros((3, 2)),
                  deviations_mm=few.deviations_mm[:3])  # fmt: skip
    presses = (replace(recording.presses[0], gel=few), *recording.presses[1:])
    some = replace(recording, presses=presses, check_units=False)
    fewer, numbers = within_contacts(some, rims, 0.08)
    assert numbers == [1, 2, 3]
    assert len(fewer.presses) == 3
    with pytest.raises(ConfigError, match="no press has 6 markers within its contact"):
        within_contacts(recording, rims, 2.0)


def test_equilibria_are_taken_over(problem: GelProblem, recording: Recording) -> None:
    """The same equilibrium is found from that of another problem, at once."""
    field, z = field_and_truth(recording)
    youngs = ShapesOnSites(field, gel_sites(recording.mesh)).at(z).youngs
    first = problem.evaluate(youngs)
    backwards = replace(recording, presses=recording.presses[::-1], check_units=False)
    other, numbers = GelProblem(backwards, AROUND, cells=7), [*range(len(recording.presses))][::-1]
    found = other.evaluate(youngs, starts=other.take_over(first, numbers))
    for i, number in enumerate(numbers):
        assert found._presses[i].equilibrium.iterations <= 1
        np.testing.assert_allclose(found.predicted[i], first.predicted[number], atol=1e-9)


def test_presses_before_first_touch_are_left_out(recording: Recording) -> None:
    first = recording.presses[0]
    apart = first.gel.first_pose.copy()
    apart[:3, 3] -= 0.2 * apart[:3, 2]
    presses = (replace(first, gel=replace(first.gel, pose=apart)), *recording.presses[1:])
    kept, numbers = pressed(replace(recording, presses=presses, check_units=False), AROUND)
    assert numbers == [1, 2, 3]
    assert [press.gel for press in kept.presses] == [p.gel for p in recording.presses[1:]]


def searched(recording: Recording, stop: bool = False) -> ShapeReconstruction | None:
    """Result of a search through gel and object."""
    limit = TimeLimit(None, lambda: stop)
    return _through_gel(recording, Settings(), limit, 4, None, lambda what: None)


def test_presses_without_markers_are_searched_by_forces(
    recording: Recording, caplog: pytest.LogCaptureFixture
) -> None:
    first, rest = recording.presses[0], recording.presses[1:]
    none = tuple(replace(press, gel=None) for press in recording.presses)
    assert has_markers(recording)
    assert not has_markers(replace(recording, presses=none))
    assert not caplog.text
    bare = replace(recording, presses=(replace(first, gel=None, name="bare"), *rest))
    assert not has_markers(bare)
    assert "press 'bare' and 0 others have no markers" in caplog.text
    # A sensor that turns has no equilibrium here, and forces are those of the gel.
    turned = first.gel.pose.copy()
    turned[:3, :3] = turned[:3, :3] @ _turn(0.1)
    presses = (replace(first, gel=replace(first.gel, pose=turned)), *rest)
    assert searched(replace(recording, presses=presses)) is None
    assert "turns by 5.7 degrees after first contact" in caplog.text


def _turn(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"material": MaterialSpec("neo_hookean", 0.45, {"lame_factor": 0.5})}, "lame_factor"),
        ({"material": MaterialSpec("linear", 0.45)}, "material=linear"),
        ({"density": 1e-9}, "has weight"),
    ],
)
def test_other_laws_and_weight_are_refused(
    recording: Recording, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        GelProblem(replace(recording, **change), AROUND)


def result(chi2: float, ended: StopReason | None) -> ShapeReconstruction:
    field = ShapeField(ShapePrior.of(box_mesh(10.0, 2), AROUND), (BALL,))
    z = np.zeros(field.size)
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 0.01 * np.eye(len(z)))
    return ShapeReconstruction(
        field, z, posterior, chi2, (9.0,), 9.0, {}, 0.0, (), ended=ended
    )  # fmt: skip


@pytest.mark.parametrize(
    ("chi2", "ended", "is_kept"),
    [(1.0, None, True), (4.0, None, False), (4.0, StopReason.TIME_LIMIT, True)],
)
def test_markers_that_are_not_explained_are_searched_by_forces(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
    chi2: float, ended: StopReason | None, is_kept: bool,
) -> None:  # fmt: skip
    """But not where the search was ended before it had explained them."""
    module = "tactorch.inverse.search.search"
    problem = SimpleNamespace(predictions=lambda model, recording: None)
    monkeypatch.setattr(f"{module}.SensorSearch", lambda *arguments: problem)
    monkeypatch.setattr(f"{module}._log_provisional", lambda problem: None)
    monkeypatch.setattr(f"{module}.search", lambda *arguments: (None, result(chi2, ended)))
    found = searched(recording)
    assert (found is not None) == is_kept
    assert ("mean squared residual of 4" in caplog.text) == (not is_kept)
    assert found is None or found.through_gel


def test_a_correction_that_fails_leaves_the_one_before(caplog: pytest.LogCaptureFixture) -> None:
    def fails(shapes: object) -> None:
        raise MeshError("too fine")

    search, field = SensorSearch.__new__(SensorSearch), result(1.0, None).field
    before = {"full": "data", "errors": "errors", "_correction": "mesh", "_fine_at": ()}
    vars(search).update(before, _corrected_mpa=np.ones(3), _finer=fails, _check=lambda: None)
    fit = SimpleNamespace(field=field, z=np.zeros(field.size))
    model = Mock(spec=Model)
    model.fit, model.evaluation = fit, SimpleNamespace(youngs=np.full(3, 2.0))
    assert search.precise(model) is model
    assert {name: getattr(search, name) for name in before} == before
    assert search._corrected_at is None
    assert "The error of the mesh is that of the model before: too fine" in caplog.text


def inclusion(half_mm: tuple[float, float, float], turn: np.ndarray) -> InclusionShape:
    return InclusionShape(CENTER, half_mm, tuple(map(tuple, turn)), 4.0)


def test_a_mesh_is_fine_for_inclusions_that_hardly_differ() -> None:
    ball, rod = inclusion((2.0, 2.0, 2.0), np.eye(3)), inclusion((4.0, 1.0, 1.0), np.eye(3))
    assert _are_near([ball], [inclusion((2.1, 2.0, 1.9), np.eye(3))])
    assert _are_near([ball], [inclusion((2.0, 2.0, 2.0), _turn(1.0))])
    assert not _are_near([ball], [inclusion((4.0, 2.0**0.5, 2.0**0.5), np.eye(3))])
    assert not _are_near([rod], [inclusion((4.0, 1.0, 1.0), _turn(1.0))])
    assert not _are_near([ball], [replace(ball, center_mm=(6.5, 4.6, 6.8))])
    assert not _are_near([ball], [])


def test_a_search_can_be_stopped(recording: Recording) -> None:
    with pytest.raises(CancelledError, match="was stopped before it had a result"):
        searched(recording, stop=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"springs": np.array([1.0, 2.0, 1.0])}, "springs differ along axes"),
        ({"gel": None}, "has no gel"),
    ],
)
def test_refuses_what_it_cannot_describe(
    recording: Recording, change: dict[str, np.ndarray], message: str
) -> None:
    first = recording.presses[0]
    if "springs" in change:
        change = {"springs": first.fixed * change["springs"]}
    presses = (replace(first, **change), *recording.presses[1:])
    with pytest.raises(ConfigError, match=message):
        GelProblem(replace(recording, presses=presses), AROUND)


def test_a_gel_beside_the_object_is_refused(recording: Recording) -> None:
    first = recording.presses[0]
    away = first.gel.first_pose.copy()
    away[0, 3] += 50.0
    presses = (replace(first, gel=replace(first.gel, first_pose=away, pose=away)),)
    with pytest.raises(ConfigError, match="the gel is over no part of the object"):
        GelProblem(replace(recording, presses=presses), AROUND)
