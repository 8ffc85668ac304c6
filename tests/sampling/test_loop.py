from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import SoftBody, make_material
from tactorch.inverse import GaussNewton, NuisancePrior, Settings
from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import MaterialSpec, Press
from tactorch.sampling import (
    ExpectedInformation,
    LargestUncertainty,
    Patch,
    SimulatedPresser,
    Step,
    UniformGrid,
    candidate_patches,
    sample,
)
from tactorch.sampling.rules import SamplingState

SETTINGS = Settings(model_error="none", optimizer=GaussNewton(max_iterations=8, tolerance=0.05))


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return box_mesh(10.0, 3, tets_per_cell=5)


@pytest.fixture(scope="module")
def presser(mesh: TetMesh) -> SimulatedPresser:
    finer = box_mesh(10.0, 4, tets_per_cell=5)
    inside = np.linalg.norm(finer.centroids - [3.0, 3.0, 7.0], axis=1) < 2.5
    return SimulatedPresser(
        body=SoftBody(finer, make_material("neo_hookean", 0.3)),
        youngs=np.where(inside, 0.5, 0.1),
        held=finer.points[:, 2] < 1e-9,
        mesh=mesh,
        mesh_held=mesh.points[:, 2] < 1e-9,
        pressure_mpa=0.005,
        noise_mm=0.01,
    )


@pytest.fixture(scope="module")
def patches(presser: SimulatedPresser) -> list[Patch]:
    return candidate_patches(presser.mesh, presser.mesh_held, 3.0, 8)


@pytest.fixture
def run(
    presser: SimulatedPresser, mesh: TetMesh, patches: list[Patch]
) -> Callable[..., list[Step]]:
    def run(rule: object, budget: int, **options: object) -> list[Step]:
        law = MaterialSpec("neo_hookean", 0.3)
        chosen = options.pop("settings", SETTINGS)
        return sample(
            presser, mesh, patches, rule, budget, chosen, material=law, start_mpa=0.1, **options
        )

    return run


@pytest.mark.parametrize("rule", [LargestUncertainty(), ExpectedInformation()])
def test_presses_differ_and_leave_a_map_each(run: Callable[..., list[Step]], rule: object) -> None:
    told: list[Step] = []
    steps = run(rule, 3, on_press=told.append)
    assert told == steps
    assert len({step.place for step in steps}) == 3
    for step in steps:
        assert step.youngs.shape == step.deviation.shape == (135,)
        assert step.deviation.min() > 0
        assert step.rms_deviation <= step.deviation.max()
    assert not np.array_equal(steps[0].youngs, steps[-1].youngs)
    assert steps[0].seconds <= steps[-1].seconds


def test_an_interruption_ends_the_session_with_what_was_measured(
    run: Callable[..., list[Step]], monkeypatch: pytest.MonkeyPatch
) -> None:
    minimize = GaussNewton.minimize

    def interrupted(self: GaussNewton, *arguments: object) -> str:
        minimize(self, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(GaussNewton, "minimize", interrupted)
    steps = run(LargestUncertainty(), 3)
    assert len(steps) == 1
    assert steps[0].press.observed.any()


def test_stops_where_the_posterior_is_narrow_enough(
    run: Callable[..., list[Step]], monkeypatch: pytest.MonkeyPatch
) -> None:
    made, press = [], SimulatedPresser.press

    def counted(self: SimulatedPresser, patch: Patch) -> Press:
        made.append(patch)
        return press(self, patch)

    monkeypatch.setattr(SimulatedPresser, "press", counted)
    assert len(run(UniformGrid(4), 4, target_deviation=1e3)) == 1
    assert len(made) == 1  # the robot does not press after the end


@pytest.mark.parametrize(
    "model_error", ["none", pytest.param("discretisation", marks=pytest.mark.slow)]
)
def test_information_is_of_the_data_the_press_would_have(
    model_error: str,
    run: Callable[..., list[Step]],
    presser: SimulatedPresser,
    patches: list[Patch],
) -> None:
    """The Jacobians foretold are those of presses made, at the same map and noise."""
    states: list[SamplingState] = []

    class Watching(UniformGrid):
        def choose(self, state: SamplingState) -> int:
            states.append(state)
            return super().choose(state)

    run(Watching(3), 3, settings=replace(SETTINGS, model_error=model_error))
    state = states[-1]
    assert state.posterior is None  # a rule that uses none gets none, not one of zero covariance
    assert state.pressed == tuple(UniformGrid(3).places(patches)[:2])
    assert set(state.remaining) | set(state.pressed) == set(range(8))
    again = state.jacobians(state.pressed)
    counts = [int(presser.plan(patches[i]).observed.sum()) for i in state.pressed]
    assert [len(rows) for rows in again] == counts
    sensitivity = [np.abs(rows).max(axis=0) for rows in again]
    expected = (np.array(sensitivity) * state.mesh.volumes.mean() / state.mesh.volumes) ** 2
    # Each press has its own share of the mesh's error, the foretold ones the median of them.
    rtol = 1e-4 if model_error == "none" else 0.5
    large = expected > 1e-3 * expected.max()
    np.testing.assert_allclose(state.credibility[large], expected[large], rtol=rtol)


def test_no_shapes_are_fitted(
    run: Callable[..., list[Step]], monkeypatch: pytest.MonkeyPatch
) -> None:
    searches: list[object] = []
    module = import_module("tactorch.inverse.invert")
    monkeypatch.setattr(module, "find_shapes", lambda *a, **k: searches.append(a))
    assert len(run(UniformGrid(2), 2)) == 2
    assert not searches


def test_nuisance_parameters_are_refused(run: Callable[..., list[Step]]) -> None:
    with pytest.raises(ConfigError, match="nuisance"):
        run(UniformGrid(2), 2, settings=replace(SETTINGS, nuisance=NuisancePrior(poisson=0.02)))


def test_the_budget_is_checked(run: Callable[..., list[Step]]) -> None:
    with pytest.raises(ConfigError, match="budget=9"):
        run(UniformGrid(3), 9)
