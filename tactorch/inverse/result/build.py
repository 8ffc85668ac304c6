"""Results of the two descriptions of a field, and which of them is shown."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from tactorch.config import to_mapping
from tactorch.inverse.errors import ERRORS
from tactorch.inverse.fit.monitor import Monitor
from tactorch.inverse.fit.objective import Objective
from tactorch.inverse.fit.optimizers.base import Optimizer
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.result.lump import Confidence, Elongation, Lump, measure_depth
from tactorch.inverse.result.reconstruction import Reconstruction
from tactorch.inverse.result.regions import build_lump, find_lumps
from tactorch.inverse.result.shapes import ShapeInclusion, ShapeReconstruction
from tactorch.metrics import Inclusion
from tactorch.recording import Recording
from tactorch.versions import versions

# Part of the displacements that is neither explained nor noise, above which nothing can be told.
_MAX_UNEXPLAINED = 0.1
_MIN_PROBABILITY = 0.9  # of a lump that is reported
_COMPLETE = "no further model has more evidence"
_MAX_AT_BOUNDS = 0.2  # fraction of the volume at the bounds in a map that can be trusted


def of_inclusions(
    recording: Recording, shapes: ShapeReconstruction, config: dict[str, Any], seconds: float
) -> Reconstruction:
    """Return the result of a search of this duration (s); the configuration is of `config_of`."""
    unknown = np.zeros((0, recording.mesh.n_points, 3)), None, None
    displacements, predicted, residuals = shapes.predictions or unknown
    reasons = _reasons_of(shapes)
    found = [] if reasons else [i for i in shapes.inclusions if _is_supported(i)]
    return Reconstruction(
        mesh=recording.mesh,
        youngs=shapes.element_means(recording.mesh),
        displacements=displacements,
        history=[{"iteration": k, **r} for k, r in enumerate(shapes.history, start=1)],
        stop_reason=str(shapes.ended or _COMPLETE),
        seconds=seconds,
        config=config,
        predicted=predicted,
        residuals=residuals,
        lumps=tuple(_lump(recording, inclusion) for inclusion in found),
        background_mpa=shapes.background_mpa,
        probability=shapes.probability,
        reasons=reasons,
        warnings=(*_warnings_of(shapes), *_depth_warnings(recording, shapes)),
        shapes=shapes,
    )


def _is_supported(inclusion: ShapeInclusion) -> bool:
    """Whether an inclusion is probable, and predicts presses that it was not fitted to."""
    predicts = inclusion.predictive is None or inclusion.predictive > 0.0
    return inclusion.probability >= _MIN_PROBABILITY and predicts


def _reasons_of(result: ShapeReconstruction) -> tuple[str, ...]:
    """Return why the presses cannot tell: more than a tenth of the data is unexplained."""
    if result.unexplained <= _MAX_UNEXPLAINED:
        return ()
    reason = (
        f"the best model leaves {result.unexplained:.0%} of the displacements unexplained. "
        "Check the forces, the supports and the shape of the object, and the stated noise."
    )
    return (reason,)


def _warnings_of(result: ShapeReconstruction) -> tuple[str, ...]:
    """Return a sentence on each error of the measurement that the data show, and on the search."""
    texts = [error.sentence(result.errors.get(error.name, 0.0)) for error in ERRORS]
    if not result.at_medians:
        texts.append(
            "The presses determine the parameters of the inclusions together only, as of ones that "
            "overlap: the map is that of the best fit, and single values may be outside their "
            "intervals."
        )
    if result.ended is not None:
        text = f"The search ended early ({result.ended}): there may be more inclusions."
        if result.untried:
            text += f" Not tried any more: {', '.join(result.untried)}."
        texts.append(text)
    return tuple(filter(None, texts))


def _depth_warnings(recording: Recording, result: ShapeReconstruction) -> Iterator[str]:
    """Yield a sentence for each step of the background above a bottom of stated depth.

    A search of a palpation has steps above the bottom alone, where they have enough evidence.
    """
    stated = recording.provenance.get("depth_mm")
    if stated is None or not recording.provenance.get("block"):
        return
    for step in result.steps:
        bottom = recording.mesh.bounds[int(step.side[1] == "+"), "xyz".index(step.side[0])]
        ends = [float(stated - abs(place - bottom)) for place in step.place_90_mm]
        stiff = step.contrast > 1.0
        looks_like, other = ("at a base", "that") if stiff else ("where it is deeper", "a larger")
        yield (
            f"The forces contradict the stated depth (format.depth_mm={stated:g}): from a depth of "
            f"{stated - abs(step.place_mm - bottom):.3g} mm (90 %: {min(ends):.3g} to "
            f"{max(ends):.3g} mm) the object is {'stiffer' if stiff else 'softer'}, as "
            f"{looks_like}. Unless it has a layer there, import the file again with {other} depth, "
            "or without format.depth_mm."
        )


def _lump(recording: Recording, found: ShapeInclusion) -> Lump:
    """Return an inclusion as a lump; the truth that the recording may carry is not read."""
    mesh, shape = recording.mesh, found.shape
    center = shape.centroid_mm
    inside = shape.contains(mesh.centroids)
    if not inside.any():  # smaller than an element
        inside[np.linalg.norm(mesh.centroids - center, axis=1).argmin()] = True
    inclusion = Inclusion(
        center,
        4.0 / 3.0 * np.pi * shape.radius_mm**3,
        shape.radius_mm,
        found.youngs_mpa,
        found.background_mpa,
        inside,
        "stiff" if found.youngs_mpa > found.background_mpa else "soft",
    )
    confidence = Confidence(
        found.probability,
        found.contrast_90,
        np.array(found.center_deviation_mm),
        found.radius_90_mm,
        found.youngs_90_mpa,
    )
    depth = measure_depth(mesh, recording.presses, center, inside)
    size, elongation = shape.size_mm, Elongation.of(shape)
    return Lump(inclusion, size, depth, confidence, elongation, shape.form)


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
    reasons = _reasons(result.volume_at_bounds)
    found = () if reasons else find_lumps(mesh, youngs)
    lumps = tuple(build_lump(mesh, recording.presses, inclusion) for inclusion in found)
    background = float(np.median(youngs))
    return replace(result, lumps=lumps, background_mpa=background, reasons=reasons)


def _reasons(at_bounds: float) -> tuple[str, ...]:
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
