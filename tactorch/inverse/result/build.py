"""Results of the two descriptions of a field, and which of them is shown."""

from dataclasses import replace
from typing import Any

import numpy as np

from tactorch.config import to_mapping
from tactorch.inverse.fit.monitor import Monitor
from tactorch.inverse.fit.objective import Objective
from tactorch.inverse.fit.optimizers.base import Optimizer
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.result.inclusions import lumps_of, reasons_of, warnings_of
from tactorch.inverse.result.reconstruction import Reconstruction, volume_at_bounds
from tactorch.inverse.result.regions import build_lump, find_lumps
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.mesh.quadrature import element_means
from tactorch.recording import Recording
from tactorch.versions import versions

_SAMPLES = 4  # along an edge of an element, for its mean modulus
_MAX_AT_BOUNDS = 0.2  # fraction of the volume at the bounds in a map that can be trusted


def of_inclusions(
    recording: Recording, shapes: ShapeReconstruction, config: dict[str, Any], seconds: float
) -> Reconstruction:
    """Return the result whose description is inclusions.

    Args:
        recording: The presses.
        shapes: Result of the search.
        config: Settings, versions and provenance, see `config_of`.
        seconds: Duration of the search, s.
    """
    predictions = shapes.predictions
    moved = np.zeros((0, recording.mesh.n_points, 3))
    history = [{"iteration": k, **r} for k, r in enumerate(shapes.history, start=1)]
    reasons = reasons_of(shapes)
    return Reconstruction(
        mesh=recording.mesh,
        youngs=element_means(recording.mesh, shapes.youngs_at, _SAMPLES),
        displacements=moved if predictions is None else predictions.displacements,
        history=history,
        stop_reason="no further model has more evidence",
        seconds=seconds,
        config=config,
        predicted=None if predictions is None else predictions.data,
        residuals=None if predictions is None else predictions.residuals,
        lumps=() if reasons else lumps_of(recording, shapes),
        background_mpa=shapes.background_mpa,
        probability=shapes.probability,
        reasons=reasons,
        warnings=warnings_of(shapes),
        shapes=shapes,
    )


def of_elements(
    objective: Objective, settings: Settings, optimizer: Optimizer, monitor: Monitor
) -> Reconstruction:
    """Return the element map of an optimizer that has ended."""
    recording = objective.problem.recording
    point = monitor.point
    if point is None:  # resumed and stopped before a step
        assert monitor.best is not None
        point = objective.at(monitor.best)
    reason = monitor.reason or monitor.ended
    assert reason is not None
    predictions = Predictions.of(point.evaluation, recording)
    result = Reconstruction(
        mesh=recording.mesh,
        youngs=point.youngs,
        displacements=predictions.displacements,
        history=monitor.history,
        stop_reason=reason,
        seconds=monitor.seconds,
        nuisance=point.nuisance_estimates(monitor.history[-1].get("weight", 0.0)),
        predicted=predictions.data,
        residuals=predictions.residuals,
        config=config_of(recording, settings, optimizer),
    )
    return with_lumps(result, recording)


def with_lumps(result: Reconstruction, recording: Recording) -> Reconstruction:
    """Return an element map with its lumps, their depths, and reasons not to trust it."""
    mesh, youngs = result.mesh, result.youngs
    reasons = _reasons(result)
    found = () if reasons else find_lumps(mesh, youngs)
    lumps = tuple(build_lump(mesh, recording.presses, inclusion) for inclusion in found)
    background = float(np.median(youngs))
    return replace(result, lumps=lumps, background_mpa=background, reasons=reasons)


def _reasons(result: Reconstruction) -> tuple[str, ...]:
    at_bounds = volume_at_bounds(result.mesh, result.youngs, result.config)
    if not at_bounds > _MAX_AT_BOUNDS:
        return ()
    reason = (
        f"{at_bounds:.0%} of the map is at a bound of Young's modulus. If the bounds are right, "
        "presses or model are off by more than the noise that is stated: give noise.mm larger, or "
        "estimate what is wrong (nuisance)."
    )
    return (reason,)


def config_of(
    recording: Recording, settings: Settings, optimizer: Optimizer | None = None
) -> dict[str, Any]:
    """Return the settings of an inversion, versions and provenance as plain JSON values."""
    return {
        "settings": to_mapping(settings),
        "optimizer": to_mapping(optimizer or settings.optimizer, "optimizer"),
        "material": to_mapping(recording.material),
        "recording": recording.provenance,
        "versions": versions(),
    }
