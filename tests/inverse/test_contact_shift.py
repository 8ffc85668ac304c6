"""Shifts of contacts, against loads that are displaced."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import Discretisation
from tactorch.fem.elements import ELEMENTS
from tactorch.inverse import Settings, find_shapes
from tactorch.inverse.errors import MeasuredPresses
from tactorch.inverse.errors.shift import ContactShift, shifted_forces
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.mesh import box_mesh
from tactorch.mesh.tractions import LoadedSurface
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate
from tactorch.simulation.patch import patch_forces
from tactorch.simulation.plan import PressSite

MESH = box_mesh(10.0, 6, tets_per_cell=5)
STEP_MM = 0.2


def disc(x: float, y: float) -> np.ndarray:
    """Nodal forces of a uniform pressure on a disc."""
    whole = Discretisation(MESH, ELEMENTS["tet4"])
    return 0.005 * patch_forces(whole, PressSite("z+", (x, y, 10.0)), 3.0)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_patterns_are_changes_by_displaced_loads(element: str) -> None:
    plan = PressPlan(("z+",), (0.005, 0.01), patch_radius_mm=3.0)
    recording = simulate(make_phantom("uniform_cube"), plan, mesh=MESH)

    def at(x: float, y: float) -> InverseProblem:
        first, second = (replace(p, forces=disc(x, y)) for p in recording.presses)
        presses = (first, replace(second, forces=2.0 * first.forces))
        return InverseProblem(replace(recording, presses=presses), element=element)

    youngs, problem = np.full(MESH.n_tets, 0.2), at(5.0, 5.0)
    evaluation = problem.evaluate(youngs)
    patterns = ContactShift().patterns(MeasuredPresses(problem, [(0, 1)], evaluation))
    loaded = LoadedSurface.of(MESH.surface, disc(5.0, 5.0))
    per_mm = patterns / np.sqrt(loaded.areas.sum() / np.pi)
    for along in ([STEP_MM, 0.0], [0.0, STEP_MM]):
        there, back = (at(*(5.0 + sign * np.array(along))) for sign in (1.0, -1.0))
        ends = [np.concatenate(p.evaluate(youngs).predicted) for p in (there, back)]
        change = problem.data.scale * (ends[0] - ends[1]) / (2.0 * STEP_MM)
        shift, *_ = np.linalg.lstsq(per_mm, change, rcond=None)
        assert np.linalg.norm(shift) == pytest.approx(1.0, abs=0.1)
        assert np.linalg.norm(per_mm @ shift - change) < 0.1 * np.linalg.norm(change)


def test_a_shift_keeps_the_force_and_changes_the_moment() -> None:
    forces = disc(4.0, 5.5)
    radius = np.sqrt(LoadedSurface.of(MESH.surface, forces).areas.sum() / np.pi)
    changes = shifted_forces(MESH, forces)
    assert changes.sum(axis=1) == pytest.approx(0.0, abs=1e-12)
    moments = np.cross(MESH.points, changes).sum(axis=1)
    directions = np.cross(moments, forces.sum(axis=0)) / (radius * np.sum(forces.sum(axis=0) ** 2))
    assert directions @ directions.T == pytest.approx(np.eye(2), abs=1e-9)
    alone = np.zeros_like(forces)
    alone[MESH.surface.nodes()[0], 2] = 1.0
    assert not shifted_forces(MESH, alone).any()


def test_a_search_tries_shifts_on_request() -> None:
    plan = PressPlan(("z+",), (0.005,), patch_radius_mm=3.0)
    recording = simulate(make_phantom("uniform_cube"), plan, mesh=MESH, element="tet10")
    assert "shift" not in [e.name for e in ShapeProblem(recording, Settings()).errors.errors]
    presses = ShapeProblem(recording, Settings(), requested=["shift"])
    levels = [e.get("shift") for _, e in presses.errors.others(presses.errors.least)]
    assert set(levels) == {None, *ContactShift.levels}
    assert presses.data({"shift": 0.1}).log_determinant > 1.0
    with pytest.raises(ConfigError, match=r"errors=shfit is unknown.*'shift'"):
        find_shapes(recording, errors=["shfit"])


def test_presses_without_forces_have_no_shift() -> None:
    recording = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)
    (press,) = recording.presses
    moved = np.where(press.forces != 0.0, -0.1, 0.0)
    given = {"forces": 0.0 * press.forces, "fixed": moved != 0.0, "prescribed": moved}
    both = replace(recording, presses=(press, replace(press, **given)))
    problem = InverseProblem(both)
    presses = MeasuredPresses(problem, [(0,), (1,)], problem.evaluate(np.full(MESH.n_tets, 0.2)))
    assert ContactShift().least(presses) == 0.0
    patterns = ContactShift().patterns(presses)
    assert patterns.shape == (sum(problem.data.counts), 2)
    assert not patterns[problem.data.counts[0] :].any()
    alone = InverseProblem(replace(both, presses=both.presses[1:]))
    assert ContactShift().least(MeasuredPresses(alone)) is None
