"""`find`: shapes that are fitted to the presses, else regions of the map."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tactorch
from tactorch.errors import CancelledError, ConfigError, ConvergenceError
from tactorch.findings import Finding, Status, build_finding, build_shape_finding, find
from tactorch.inverse import GaussNewton, Reconstruction, Settings, invert
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.shapes import KeptRims, ShapeReconstruction
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate

SETTINGS = Settings(model_error="none", optimizer=GaussNewton(max_iterations=3))


@pytest.fixture(scope="module")
def recording() -> Recording:
    plan = PressPlan(("z+",), (0.01,))
    phantom = make_phantom("cube_sphere", radius=0.45)
    return simulate(phantom, plan, mesh=box_mesh(10.0, 3, tets_per_cell=5))


@pytest.fixture(scope="module")
def result(recording: Recording) -> Reconstruction:
    return invert(recording, SETTINGS, show_progress=False)


@pytest.fixture
def shapes(recording: Recording) -> ShapeReconstruction:
    """A ball of 0.8 MPa in 0.2 MPa."""
    field = ShapeField(ShapePrior.of(recording.mesh, 0.2), (BALL,))
    z = field.standard(np.array([np.log(0.2), 5.0, 5.0, 6.0, np.log(2.0), np.log(4.0)]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 4e-4 * np.eye(len(z)))
    return ShapeReconstruction(field, z, posterior, 1.0, (50.0,), 50.0)


def at_its_bounds(result: Reconstruction) -> Reconstruction:
    return replace(result, youngs=np.full_like(result.youngs, 100.0))


@pytest.fixture
def replace_search(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], list[dict[str, Any]]]:
    """Return a function that replaces the search for shapes by a result or an error."""

    def replaced(outcome: Any) -> list[dict[str, Any]]:
        calls: list[dict[str, Any]] = []

        def search(recording: Recording, settings: Settings, **options: Any) -> Any:
            calls.append({"settings": settings, **options})
            if isinstance(outcome, Exception):
                raise outcome
            return outcome

        monkeypatch.setattr("tactorch.findings.search.find_shapes", search)
        return calls

    return replaced


def same(one: Finding, other: Finding) -> bool:
    return one.plain() == other.plain()


def test_it_is_a_public_name() -> None:
    assert tactorch.find is find


def test_lumps_are_the_shapes_that_are_fitted(
    recording: Recording, shapes: ShapeReconstruction, replace_search: Any
) -> None:
    (calls, stop) = replace_search(shapes), lambda: False
    passed_on = {"start": shapes, "stop": stop, "kept": KeptRims()}
    finding = find(recording, settings=SETTINGS, max_lumps=2, **passed_on)
    assert finding.shapes is shapes
    assert same(finding, build_shape_finding(recording, shapes))
    assert calls == [{"settings": SETTINGS, "max_shapes": 2, **passed_on}]


def test_settings_are_those_of_the_map(
    recording: Recording, result: Reconstruction, shapes: ShapeReconstruction, replace_search: Any
) -> None:
    (calls, _) = replace_search(shapes), find(recording, result)
    assert calls[0]["settings"].model_error == "none"
    find(recording)
    assert calls[1]["settings"] == Settings()


@pytest.mark.parametrize("error", [ConvergenceError("the body collapses."), MemoryError()])
def test_where_no_shapes_can_be_fitted_lumps_are_regions_of_the_map(
    recording: Recording, result: Reconstruction, error: Exception, replace_search: Any
) -> None:
    replace_search(error)
    finding = find(recording, result, uncertainty=False)
    assert finding.shapes is None
    assert same(replace(finding, notes=()), build_finding(recording, result.youngs))
    reason = str(error).rstrip(".") or "not enough memory"
    note = f"The finding is that of the map: no shapes can be fitted ({reason})."
    assert finding.notes == (note,)
    assert finding.text().endswith(note)
    with pytest.raises(type(error)):
        find(recording)


def test_a_map_that_cannot_be_trusted_cannot_tell(
    recording: Recording, result: Reconstruction, replace_search: Any
) -> None:
    replace_search(ConvergenceError("the body collapses"))
    wrong = at_its_bounds(result)
    finding = find(recording, wrong)
    assert finding.status is Status.UNKNOWN
    assert finding.reasons == wrong.warnings
    assert "the body collapses" in finding.notes[0]


def test_a_search_that_is_stopped_has_no_finding(
    recording: Recording, result: Reconstruction, replace_search: Any
) -> None:
    replace_search(CancelledError("stopped"))
    with pytest.raises(CancelledError):
        find(recording, result)


def test_regions_have_a_confidence_if_it_can_be_computed(
    recording: Recording, result: Reconstruction, replace_search: Any
) -> None:
    calls = replace_search(ConvergenceError("not called"))
    finding = find(recording, result, shapes=False)
    assert all(lump.confidence is not None for lump in finding.lumps)
    assert finding.lumps
    assert not finding.notes
    finding = find(recording, result, shapes=False, uncertainty=False)
    assert all(lump.confidence is None for lump in finding.lumps)
    unknown = replace(result, config={"settings": {"misfit": "unknown"}})
    finding = find(recording, unknown, shapes=False)
    assert finding.lumps
    assert finding.lumps[0].confidence is None
    assert finding.notes[0].startswith("The confidence cannot be computed (")
    assert not calls


def test_wrong_arguments_are_refused(recording: Recording, result: Reconstruction) -> None:
    with pytest.raises(ConfigError, match="give the reconstruction"):
        find(recording, shapes=False)
    with pytest.raises(ConfigError, match="max_lumps=0"):
        find(recording, result, max_lumps=0)


def test_a_large_mesh_has_the_finding_of_its_map(
    recording: Recording,
    result: Reconstruction,
    shapes: ShapeReconstruction,
    replace_search: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = replace_search(shapes)
    monkeypatch.setattr("tactorch.findings.search.MAX_ELEMENTS", recording.mesh.n_tets - 1)
    finding = find(recording, result, uncertainty=False)
    assert finding.shapes is None
    assert f"the mesh has {recording.mesh.n_tets} elements" in finding.notes[0]
    assert not calls
    with pytest.raises(ConfigError, match="find_shapes to fit them all the same"):
        find(recording)
    monkeypatch.setattr("tactorch.findings.search.MAX_ELEMENTS", recording.mesh.n_tets)
    assert find(recording, result).shapes is shapes
