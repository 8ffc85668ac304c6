"""Shifts of contacts, against sensors that press and observe beside the recorded places."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.fem import Discretisation
from tactorch.fem.elements import ELEMENTS
from tactorch.fem.transfer import Transfer
from tactorch.inverse import Settings
from tactorch.inverse.errors import ErrorModel, MeasuredPresses
from tactorch.inverse.errors.shift import ContactShift, shifts
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.inverse.search.proposals import propose
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Press, Recording
from tactorch.simulation import PressPlan, simulate
from tactorch.simulation.patch import patch_forces
from tactorch.simulation.plan import PressSite

MESH = box_mesh(10.0, 8, tets_per_cell=5)
LINEAR = Discretisation(MESH, ELEMENTS["tet4"])
STEP_MM, RADIUS_MM = 0.2, 2.5


def disc(x: float, y: float) -> np.ndarray:
    """Nodal forces of a uniform pressure on a disc."""
    return 0.01 * patch_forces(LINEAR, PressSite("z+", (x, y, 10.0)), RADIUS_MM)


def pressed(*contacts: tuple[float, float]) -> Recording:
    """A cube under discs on its top, observed where they press."""
    plan = PressPlan(("z+",), (0.01,), patch_radius_mm=RADIUS_MM)
    recording = simulate(make_phantom("uniform_cube"), plan, mesh=MESH)
    (press,) = recording.presses

    def at(x: float, y: float) -> Press:
        near = np.hypot(*(MESH.points[:, :2] - [x, y]).T) < RADIUS_MM
        observed = np.repeat((near & (MESH.points[:, 2] > 9.9))[:, None], 3, axis=1)
        moved = np.where(observed, [0.0, 0.0, -0.1], np.nan)
        return replace(press, forces=disc(x, y), observed=observed, displacement=moved)

    return replace(recording, presses=tuple(at(*contact) for contact in contacts))


def with_ball() -> np.ndarray:
    """Moduli of elements with a stiff ball beside the contacts, MPa."""
    center = MESH.points[MESH.tets].mean(axis=1)
    return np.where(np.linalg.norm(center - [6.5, 4.0, 7.0], axis=1) < 2.0, 1.0, 0.2)


def seen(contact: tuple[float, float], shift: np.ndarray, youngs: np.ndarray) -> np.ndarray:
    """Displacements that a displaced sensor observes, mm."""
    recording = pressed(contact)
    (press,) = recording.presses
    there = replace(press, forces=disc(*(np.array(contact) + shift)))
    problem = InverseProblem(replace(recording, presses=(there,)), element="tet10")
    points = MESH.points[press.observed.any(axis=1)] + [*shift, 0.0]
    transfer = Transfer.between(problem.body.discretisation, points)
    return transfer(problem.evaluate(youngs).displacements[0])


def test_patterns_are_changes_by_a_displaced_sensor() -> None:
    contact = 3.0, 5.0  # the disc ends 0.5 mm from a side
    youngs, recording = with_ball(), pressed(contact)
    problem = InverseProblem(recording, element="tet10")
    evaluation = problem.evaluate(youngs)
    patterns = ContactShift().patterns(MeasuredPresses(problem, [(0,)], evaluation))
    along = shifts(MESH, recording.presses[0])
    assert along.shape == (2, 3)
    assert along @ along.T == pytest.approx(np.eye(2) * (along**2).sum(axis=1))
    for pattern, direction in zip(patterns.T, along, strict=True):
        radius = np.linalg.norm(direction)
        step = STEP_MM * direction[:2] / radius
        ends = [seen(contact, sign * step, youngs) for sign in (1.0, -1.0)]
        change = (ends[0] - ends[1]).ravel() / (2.0 * STEP_MM)
        found = pattern / problem.data.scale / radius
        assert found @ change / (change @ change) == pytest.approx(1.0, abs=0.03)
        assert np.linalg.norm(found - change) < 0.2 * np.linalg.norm(change)


class Recorded(ContactShift):
    """Shifts whose estimates are kept."""

    amplitudes = np.zeros(0)

    def nonlinear_changes(
        self, presses: MeasuredPresses, amplitudes: np.ndarray
    ) -> dict[int, np.ndarray]:
        self.amplitudes = amplitudes
        return super().nonlinear_changes(presses, amplitudes)


@pytest.mark.slow
def test_large_shifts_change_more_than_the_patterns() -> None:
    recording = pressed((3.0, 5.0), (5.0, 5.0))
    problem = InverseProblem(recording, element="tet10")
    evaluation, contacts = problem.evaluate(with_ball()), [(0,), (1,)]
    presses = MeasuredPresses(problem, contacts, evaluation)
    amplitudes = np.array([0.15, -0.1, 0.1, 0.15])
    changes = ContactShift().nonlinear_changes(presses, amplitudes)
    linear = np.split(
        ContactShift().patterns(presses) @ amplitudes / problem.data.scale, problem.data.begins[1:]
    )
    observed = [u + changes[i] for i, u in enumerate(evaluation.predicted)]
    moved = problem.data.shifted(
        [new - old.values for new, old in zip(observed, problem.data.observations, strict=True)]
    )
    presses = replace(presses, problem=problem.with_data(moved))
    error = Recorded()
    errors = ErrorModel(presses, [error])
    errors.linearise(evaluation, "quadratic")
    found = errors.remainders({"shift": 0.2}, evaluation)
    assert error.amplitudes == pytest.approx(amplitudes, abs=0.03)
    for i, remainder in enumerate(found):
        beyond = changes[i] - linear[i]
        assert 0.02 < np.linalg.norm(beyond) / np.linalg.norm(changes[i]) < 0.5
        assert np.linalg.norm(remainder - beyond) < 0.35 * np.linalg.norm(beyond)
    assert not any(change.any() for change in errors.remainders({}, evaluation))


def test_contacts_that_fill_a_side_are_not_shifted() -> None:
    recording = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)
    (press,) = recording.presses
    assert not len(shifts(MESH, press))
    assert ContactShift().least(MeasuredPresses(InverseProblem(recording), [(0,)])) is None
    moved = np.where(press.forces != 0.0, -0.1, 0.0)
    given = replace(press, forces=0.0 * press.forces, fixed=moved != 0.0, prescribed=moved)
    assert not len(shifts(MESH, given))
    near_an_edge = pressed((2.6, 5.0)).presses[0]  # some of its outline is at the edge
    assert len(shifts(MESH, near_an_edge)) == 2


def test_a_search_tries_shifts() -> None:
    presses = ShapeProblem(pressed((5.0, 5.0)), Settings())
    levels = [e.get("shift") for _, e in presses.errors.others(presses.errors.least)]
    assert set(levels) == {None, *ContactShift.levels}
    assert presses.data({"shift": 0.1}).log_determinant > 1.0


@pytest.mark.slow
def test_an_inclusion_under_misplaced_contacts_is_proposed_with_their_shifts() -> None:
    contacts = [(3.0, 3.0), (3.0, 7.0), (5.0, 5.0), (7.0, 3.0), (7.0, 7.0)]
    recording, random = pressed(*contacts), np.random.default_rng(0)
    presses = []
    for press, contact in zip(recording.presses, contacts, strict=True):
        angle = random.uniform(0.0, 2.0 * np.pi)
        moved = seen(contact, 0.4 * np.array([np.cos(angle), np.sin(angle)]), with_ball())
        sigma = 0.01 * float(np.sqrt(np.mean(moved**2)))
        displacement = press.displacement.copy()
        displacement[press.observed] = moved.ravel() + sigma * random.standard_normal(moved.size)
        presses.append(replace(press, displacement=displacement, noise_mm=sigma))
    provenance = {"inverse_crime": True, "element": "tet10"}
    recording = replace(recording, presses=tuple(presses), provenance=provenance)
    problem = ShapeProblem(recording, Settings(), max_shapes=1)
    found = {p.what: p.trial.chi2 for p in propose(problem, problem.uniform())}
    best = min(found, key=found.__getitem__)
    assert "ball" in best
    assert "misplaced" in best
    apart = [chi2 for what, chi2 in found.items() if ("ball" in what) != ("misplaced" in what)]
    assert found[best] < 0.7 * min(apart)
