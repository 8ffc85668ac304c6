"""Findings from shapes that were fitted to the presses."""

import numpy as np
from jaxtyping import Float

from tactorch.findings.elongation import Elongation
from tactorch.findings.finding import Confidence, Finding, Lump, measure_depth
from tactorch.inverse.errors import ERRORS
from tactorch.inverse.shapes import Ellipsoid, ShapeInclusion, ShapeReconstruction
from tactorch.metrics import Inclusion
from tactorch.recording import Recording

# Part of the displacements that is neither explained nor noise, above which nothing can be told.
MAX_UNEXPLAINED = 0.1
_MIN_PROBABILITY = 0.9  # of a lump that is reported


def build_shape_finding(recording: Recording, result: ShapeReconstruction) -> Finding:
    """Return the inclusions of a search for shapes as lumps, with depths and intervals.

    Inclusions whose probability is below 90 % are omitted. Where the best model leaves more than a
    tenth of the displacements unexplained, beyond the noise, the presses cannot tell.

    Args:
        recording: Presses; the truth is not read.
        result: Result of `find_shapes` for this recording.
    """
    background, probability = result.background_mpa, result.probability
    texts = [error.sentence(result.errors.get(error.name, 0.0)) for error in ERRORS]
    notes = tuple(filter(None, texts))
    if result.unexplained > MAX_UNEXPLAINED:
        reason = (
            f"the best model leaves {result.unexplained:.0%} of the displacements unexplained. "
            "Check the forces, the supports and the shape of the object, and the stated noise."
        )
        return Finding(recording.mesh, (), background, (reason,), probability, notes, result)
    lumps = tuple(
        _lump(recording, inclusion)
        for inclusion in result.inclusions
        if inclusion.probability >= _MIN_PROBABILITY
    )
    return Finding(recording.mesh, lumps, background, (), probability, notes, result)


def _lump(recording: Recording, found: ShapeInclusion) -> Lump:
    mesh, shape = recording.mesh, found.shape
    center = np.array(shape.center_mm)
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
    return Lump(inclusion, _extent(shape), depth, confidence, Elongation.of(shape))


def _extent(shape: Ellipsoid) -> Float[np.ndarray, "3"]:
    """Size along x, y and z, mm."""
    half = np.array(shape.semi_axes_mm)[:, None] * np.array(shape.axes)
    return 2.0 * np.linalg.norm(half, axis=0)
