"""Lumps of inclusions that were fitted to the presses, and what the presses say beside them."""

import numpy as np

from tactorch.inverse.errors import ERRORS
from tactorch.inverse.result.elongation import Elongation
from tactorch.inverse.result.lump import Confidence, Lump, measure_depth
from tactorch.inverse.result.shapes import ShapeInclusion, ShapeReconstruction
from tactorch.metrics import Inclusion
from tactorch.recording import Recording

# Part of the displacements that is neither explained nor noise, above which nothing can be told.
MAX_UNEXPLAINED = 0.1
_MIN_PROBABILITY = 0.9  # of a lump that is reported


def lumps_of(recording: Recording, result: ShapeReconstruction) -> tuple[Lump, ...]:
    """Return the inclusions whose probability is 90 % or more as lumps, with depths and intervals.

    Args:
        recording: Presses; the truth is not read.
        result: Result of `find_shapes` for this recording.
    """
    found = (i for i in result.inclusions if i.probability >= _MIN_PROBABILITY)
    return tuple(_lump(recording, inclusion) for inclusion in found)


def reasons_of(result: ShapeReconstruction) -> tuple[str, ...]:
    """Return why the presses cannot tell: more than a tenth of the data is unexplained."""
    if result.unexplained <= MAX_UNEXPLAINED:
        return ()
    reason = (
        f"the best model leaves {result.unexplained:.0%} of the displacements unexplained. "
        "Check the forces, the supports and the shape of the object, and the stated noise."
    )
    return (reason,)


def warnings_of(result: ShapeReconstruction) -> tuple[str, ...]:
    """Return a sentence on each error of the measurement that the data show."""
    texts = [error.sentence(result.errors.get(error.name, 0.0)) for error in ERRORS]
    return tuple(filter(None, texts))


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
    return Lump(inclusion, 2.0 * shape.half_size_mm, depth, confidence, Elongation.of(shape))
