"""Maps and shapes from the forces on a ball at many places, without inverse crime."""

import sys
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.errors import CancelledError, ConfigError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.contact import Ball
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.inverse import NuisancePrior, Settings, find_shapes, invert, invert_map
from tactorch.inverse.data.observations import CorrelatedNoise
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.fit.starts import homogeneous
from tactorch.inverse.forward.palpation import (
    PalpationProblem,
    group_places,
    is_palpation,
)
from tactorch.inverse.result.build import of_inclusions
from tactorch.inverse.search.base import SearchProblem
from tactorch.inverse.search.model import Model, Proposal
from tactorch.inverse.search.palpation import PalpationSearch, at_some_places
from tactorch.mesh import TetMesh, box_mesh, face_nodes
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording

BALL, BACKGROUND, LUMP = 3.0, 0.05, 0.5
SIZE, HEIGHT = 24.0, 10.0
CENTER, RADIUS = np.array([3.0, -2.0, -4.0]), 3.0
DEPTHS, NOISE = (0.5, 1.0, 1.5), 0.003


def block(edge: float, height: float = HEIGHT) -> tuple[TetMesh, np.ndarray]:
    counts = [round(SIZE / edge), round(SIZE / edge), round(height / edge)]
    mesh = box_mesh(
        (SIZE, SIZE, height), counts, center_mm=(0.0, 0.0, -height / 2), tets_per_cell=5
    )
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    fixed.setflags(write=False)
    return mesh, fixed


def positions() -> np.ndarray:
    axis = np.arange(-8.0, 8.1, 4.0)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


@cache
def measured(lump: bool) -> np.ndarray:
    """Forces on another, finer mesh; (places, depths)."""
    mesh, fixed = block(2.0)
    nothing = np.zeros((mesh.n_points, 3))
    body = SoftBody(mesh, make_material("linear", 0.45), element="tet10")
    places = [BallPlace(np.array([*xy, 0.0]), np.array([0.0, 0.0, 1.0]), BALL, DEPTHS[-1])
              for xy in positions()]  # fmt: skip
    youngs = np.full(mesh.n_tets, BACKGROUND)
    if lump:
        youngs[np.linalg.norm(mesh.centroids - CENTER, axis=1) < RADIUS] = LUMP
    indented = Indentation(body, Supports(fixed, nothing, nothing), places).at(youngs)
    count = len(places)
    which = np.repeat(np.arange(count), len(DEPTHS))
    return indented.press(which, np.tile(DEPTHS, count)).force_n.reshape(count, -1)


def recording(
    lump: bool = True, seed: int = 0, deviation_mm: float = 0.02, height: float = HEIGHT
) -> Recording:
    mesh, fixed = block(3.0, height)
    rng = np.random.default_rng(seed)
    presses = []
    for xy, forces in zip(positions(), measured(lump), strict=True):
        for step, (depth, force) in enumerate(zip(DEPTHS, forces, strict=True)):
            pose = ProbePose(Ball(BALL), np.array([*xy, BALL - depth]), deviation_mm=deviation_mm)
            value = force + NOISE * rng.standard_normal()
            reading = ForceReading.along((0.0, 0.0, 1.0), value, NOISE)
            presses.append(
                Press.by_probe(pose, mesh.n_points, force=reading, fixed=fixed, step=step)
            )
    return Recording(mesh, tuple(presses), MaterialSpec("linear", 0.45))


@pytest.fixture(scope="module")
def with_lump() -> Recording:
    return recording()


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupt each search once it has found an inclusion."""
    search = sys.modules[find_shapes.__module__]
    propose = search.propose

    def interrupted(problem: SearchProblem, model: Model) -> list[Proposal]:
        if model.fit.field.parts:
            raise KeyboardInterrupt
        return propose(problem, model)

    monkeypatch.setattr(search, "propose", interrupted)


def test_which_recordings_are_palpations(with_lump: Recording) -> None:
    assert is_palpation(with_lump)
    assert not is_palpation(replace(with_lump, material=MaterialSpec("neo_hookean", 0.45)))
    other = np.array(with_lump.presses[1].fixed)
    other[-1] = ~other[-1]
    presses = (with_lump.presses[0], replace(with_lump.presses[1], fixed=other))
    assert not is_palpation(replace(with_lump, presses=presses))
    moment = ForceReading(np.eye(6)[3:4], np.ones(1), np.ones(1))
    assert not is_palpation(
        replace(with_lump, presses=(replace(with_lump.presses[0], force=moment),))
    )


def test_places_are_the_axes_of_presses(with_lump: Recording) -> None:
    poses = [press.probe for press in with_lump.presses if press.probe is not None]
    places, first = group_places(poses)
    assert places.tolist() == np.repeat(np.arange(25), 3).tolist()
    assert first.tolist() == list(range(0, 75, 3))
    aside = replace(poses[1], position_mm=poses[1].position_mm + np.array([0.5, 0.0, 0.0]))
    assert len(group_places([poses[0], aside])[1]) == 2


def test_sparse_patterns_are_those_of_dense_ones() -> None:
    rng = np.random.default_rng(0)
    places = np.array([0, 0, 1, 1, 1, 2, 2, 0, 2])
    patterns = sp.csr_matrix((rng.standard_normal(9), (np.arange(9), places)))
    errors, values = CorrelatedNoise(patterns), rng.standard_normal((9, 4))
    dense = CorrelatedNoise(patterns.toarray())
    assert errors.whiten(values) == pytest.approx(dense.whiten(values))
    assert errors.whiten(values[:, 0]) == pytest.approx(dense.whiten(values[:, 0]))
    assert errors.log_determinant == pytest.approx(dense.log_determinant)
    factors = rng.uniform(1.0, 2.0, 9)
    wide = errors.widened(factors).whiten(values)
    assert wide == pytest.approx(dense.widened(factors).whiten(values))


def test_derivatives_agree_with_differences_and_with_each_other(with_lump: Recording) -> None:
    problem, rng = PalpationProblem(with_lump), np.random.default_rng(1)
    youngs = BACKGROUND * np.exp(0.2 * rng.standard_normal(problem.n_elements))
    change, weights = youngs * rng.standard_normal(len(youngs)), rng.standard_normal(problem.n_data)
    evaluation = problem.evaluate(youngs)
    along = evaluation.jacobian_times(change)
    step = 1e-2
    ends = [problem.evaluate(youngs + s * step * change).residuals for s in (1.0, -1.0)]
    assert along == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.02, abs=0.02)
    assert weights @ along == pytest.approx(evaluation.transpose_times(weights) @ change, rel=1e-4)
    assert evaluation.jacobian() @ change == pytest.approx(along, rel=1e-3, abs=1e-3)
    assert evaluation.linear_response(change[None])[0][:, 0] == pytest.approx(
        along, rel=1e-3, abs=1e-3
    )
    points = np.repeat(youngs[:, None], 4, axis=1)
    by_point = problem.evaluate(points)
    assert by_point.residuals == pytest.approx(evaluation.residuals, rel=1e-3, abs=1e-3)
    each, _ = by_point.linear_response(np.repeat(change[:, None], 4, axis=1).reshape(1, -1))
    assert each[:, 0] == pytest.approx(along, rel=1e-3, abs=1e-3)


def test_the_uniform_modulus_is_found_without_iteration() -> None:
    problem = PalpationProblem(recording(lump=False))
    assert problem.contact_mpa == pytest.approx(BACKGROUND, rel=0.02)
    youngs = np.full(problem.n_elements, problem.contact_mpa)
    # Less than one: 3 % of the forces and the depths are counted as uncertain.
    assert problem.evaluate(youngs).chi2 < 1.0


def test_the_map_shows_the_lump(with_lump: Recording) -> None:
    result = invert_map(with_lump, Settings(), start_mpa=homogeneous, show_progress=False)
    assert result.displacements.shape == (0, with_lump.mesh.n_points, 3)
    ratio = np.log(result.youngs / np.median(result.youngs)).clip(0.0)
    center = ratio @ with_lump.mesh.centroids / ratio.sum()
    assert np.abs(center - CENTER)[:2].max() < 1.0
    inside = np.linalg.norm(with_lump.mesh.centroids - CENTER, axis=1) < 2.0
    assert result.youngs[inside].mean() > 1.15 * BACKGROUND
    outside = np.linalg.norm(with_lump.mesh.centroids - CENTER, axis=1) > 6.0
    assert np.median(result.youngs[outside]) == pytest.approx(BACKGROUND, rel=0.1)
    assert result.history[-1]["chi2"] < 1.3


def test_shapes_find_the_lump_and_none_where_there_is_none(with_lump: Recording) -> None:
    found = find_shapes(with_lump)
    assert len(found.inclusions) == 1
    inclusion = found.inclusions[0]
    center = np.array(inclusion.shape.center_mm)
    assert np.abs(center - CENTER)[:2].max() < 0.5
    assert abs(center - CENTER)[2] < 3.0 * max(inclusion.center_deviation_mm[2], 0.2)
    assert inclusion.youngs_mpa > 2.0 * BACKGROUND
    assert inclusion.probability > 0.99
    assert not find_shapes(recording(lump=False, seed=1)).inclusions


def test_a_base_at_an_unknown_depth_is_found() -> None:
    higher = recording(height=24.0)
    found = find_shapes(higher)
    (step,), (inclusion,) = found.steps, found.inclusions
    assert step.side == "z-"
    assert step.place_90_mm.low < -HEIGHT < step.place_90_mm.high < 0.0
    assert step.contrast_90.low > 1.5  # a base that is fixed stands for any large contrast
    stated = replace(higher, provenance={"depth_mm": 24.0, "block": True})
    (warning,) = of_inclusions(stated, found, {}, 0.0).warnings
    assert "contradict the stated depth (format.depth_mm=24)" in warning
    center = np.array(inclusion.shape.center_mm)
    np.testing.assert_allclose(center[:2], CENTER[:2], atol=0.6)
    assert center[2] == pytest.approx(CENTER[2], abs=1.5)
    assert inclusion.probability > 0.99


def test_some_places_are_far_from_each_other(with_lump: Recording) -> None:
    part = at_some_places(with_lump, 9)
    assert part is not None
    assert len(part.presses) == 9 * len(DEPTHS)
    contacts = np.unique([press.probe.position_mm[:2] for press in part.presses], axis=0)
    apart = np.linalg.norm(contacts[:, None] - contacts, axis=2) + 100.0 * np.eye(9)
    assert apart.min() > 5.0  # the lattice of all has 4
    assert at_some_places(with_lump, 13) is None


def test_a_search_on_a_part_of_many_places_comes_first(
    with_lump: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = sys.modules[find_shapes.__module__]
    part = with_lump.select(range(20 * len(DEPTHS)))
    monkeypatch.setattr(search, "at_some_places", lambda recording, count: part)
    found = find_shapes(with_lump)
    records = [record["model"] for record in found.history]
    assert records[0] == "uniform"
    assert records[1].startswith("ball at")
    assert "the model before" in records
    (inclusion,) = found.inclusions
    assert np.abs(np.array(inclusion.shape.center_mm) - CENTER)[:2].max() < 0.5
    assert found.predictions is not None
    assert len(found.predictions.data) == len(with_lump.presses)


@pytest.mark.slow
def test_a_search_that_ends_at_the_first_places_keeps_their_model(
    with_lump: Recording, interrupted: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = sys.modules[find_shapes.__module__]
    part = with_lump.select(range(20 * len(DEPTHS)))
    monkeypatch.setattr(search, "at_some_places", lambda recording, count: part)
    ended = find_shapes(with_lump)
    assert ended.ended is StopReason.INTERRUPTED
    assert len(ended.inclusions) == 1
    assert "the model before" in [record["model"] for record in ended.history]
    # A stop at the first fit to all places leaves it, too.
    fit = PalpationSearch.fit

    def stopped(problem: PalpationSearch, *start: Any, **options: Any) -> Model:
        if len(problem.full.recording.presses) == len(with_lump.presses):
            raise CancelledError("stopped")
        return fit(problem, *start, **options)

    monkeypatch.setattr(PalpationSearch, "fit", stopped)
    with pytest.raises(CancelledError) as error:
        find_shapes(with_lump)
    assert error.value.reached is not None
    assert len(error.value.reached.field.families) == 1


def test_nuisance_parameters_are_refused(with_lump: Recording) -> None:
    with pytest.raises(ConfigError, match="poisson: nuisance parameters are not estimated"):
        invert_map(with_lump, Settings(nuisance=NuisancePrior(poisson=0.02)))


def test_a_ball_clear_of_the_object_or_pulled_is_refused(with_lump: Recording) -> None:
    press = with_lump.presses[0]
    far = replace(press.probe, position_mm=press.probe.position_mm + np.array([0.0, 0.0, 5.0]))
    presses = (replace(press, probe=far, name="far"),)
    with pytest.raises(ConfigError, match="press 'far': its ball does not touch"):
        PalpationProblem(replace(with_lump, presses=presses))
    pulled = tuple(
        replace(p, force=replace(p.force, values=-p.force.values)) for p in with_lump.presses
    )
    problem = PalpationProblem(replace(with_lump, presses=pulled))
    with pytest.raises(ConfigError, match="pull the ball"):
        _ = problem.contact_mpa


def test_ctrl_c_keeps_the_inclusions_found_so_far(with_lump: Recording, interrupted: None) -> None:
    found = invert(with_lump)
    assert found.stop_reason == "interrupted"
    assert len(found.lumps) == 1
    assert "The search ended early (interrupted): there may be more inclusions." in found.warnings
