"""The words for a result, shared by the command line, the report, notebooks and live runs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.inverse.result.lump import Confidence, Lump
from tactorch.inverse.result.reconstruction import Reconstruction

_UNCERTAIN = 0.1  # width of the interval of a depth, over the depth, from which it is reported
# Probabilities above which a lump is certain, and below which it is doubtful.
_CERTAIN, _DOUBTFUL = 0.99, 0.9
_SURE = 0.999  # probability above which the excess is not stated


def summarize(result: Reconstruction) -> str:
    """Return the finding, the description and the fit in a few lines."""
    mesh, chi2 = result.mesh, f", chi2 {result.chi2:.3g}" if result.history else ""
    low, high = result.youngs.min(), result.youngs.max()
    steps = "iterations" if result.shapes is None else "models"
    lines = [
        describe(result),
        f"description: {result.name}; Young's modulus {low:.3g} to {high:.3g} MPa, background "
        f"{result.background_mpa:.3g} MPa",
        f"object: {mesh.n_points} nodes, {mesh.n_tets} tetrahedra",
        f"{result.iterations} {steps} in {result.seconds:.1f} s{chi2}: {result.stop_reason}",
        *(f"{name}: {estimate.text()}" for name, estimate in result.nuisance.items()),
    ]
    return "\n".join(lines)


def describe(result: Reconstruction, presses: int = 0, total: int = 0) -> str:
    """Return the finding as text, a line for each lump, reason and warning.

    Args:
        result: The result.
        presses: Number of presses that it is of, the first ones.
        total: Number of all presses so far.
    """
    first = [f"Of the first {presses} of {total} presses:"] if presses < total else []
    return "\n".join([*first, *_finding(result), *result.warnings])


def _finding(result: Reconstruction) -> list[str]:
    if result.reasons:
        return [f"Do not trust this result: {reason}" for reason in result.reasons]
    if not result.lumps:
        modulus = f"Young's modulus is {result.background_mpa:.3g} MPa"
        return [f"Nothing found: no lump stands out; {modulus}."]
    first = [] if result.shapes is not None else ["In the element map:"]
    return first + [describe_lump(lump) for lump in result.lumps]


def headline(result: Reconstruction) -> str:
    """Return the finding in one line."""
    if result.reasons:
        return "The presses cannot tell whether there is a lump"
    if not result.lumps:
        return "No lump stands out"
    if len(result.lumps) > 1:
        return f"{len(result.lumps)} lumps"
    return _headline(result.lumps[0])


def _headline(lump: Lump) -> str:
    contrast = lump.inclusion.contrast
    if lump.inclusion.side == "stiff":
        return f"A stiff lump, {contrast:.2g} times as stiff as its surroundings"
    return f"A soft lump, {1 / contrast:.2g} times softer than its surroundings"


def lead(result: Reconstruction) -> str:
    """Return the finding in one or two sentences below the headline."""
    if result.reasons:
        return " ".join(reason[0].upper() + reason[1:] for reason in result.reasons)
    if not result.lumps:
        modulus = format_modulus(result.background_mpa)
        return f"Young's modulus is {modulus} and nearly uniform where the presses resolve it."
    lump = result.lumps[0]
    first = f"{_headline(lump)}. " if len(result.lumps) > 1 else ""
    depth, diameter = lump.depth, 2 * lump.inclusion.equivalent_radius_mm
    centre = "" if depth is None else f"its centre {depth.center_mm:.1f} mm below {depth.surface}, "
    point = format_point(lump.inclusion.center_mm)
    return f"{first}It is at {point}, {centre}and has the volume of a ball of {diameter:.1f} mm."


def describe_lump(lump: Lump) -> str:
    """Return location, depth, size, contrast and intervals in up to three sentences."""
    inclusion, depth, side = lump.inclusion, lump.depth, lump.inclusion.side
    ratio = inclusion.contrast if side == "stiff" else 1.0 / inclusion.contrast
    below = "" if depth is None else f", {depth.center_mm:.2f} mm below {depth.surface}"
    size, kind = f"{' x '.join(f'{x:.2g}' for x in lump.size_mm)} mm", f"A {side} lump"
    if lump.elongation is not None:
        size, kind = lump.elongation.text(), f"A long {side} lump"
    text = (
        f"{kind} at {format_point(inclusion.center_mm, 2)}{below}, {size} "
        f"(the volume of a ball of radius {inclusion.equivalent_radius_mm:.2g} mm), "
        f"{ratio:.2g} times as {side} as its surroundings ({inclusion.mean_mpa:.3g} in "
        f"{inclusion.background_mpa:.3g} MPa)."
    )
    if lump.confidence is None:
        return text
    text += f" {_confidence(lump, lump.confidence)}"
    if lump.confidence.probability >= _CERTAIN:
        return text
    if lump.confidence.probability < _DOUBTFUL:
        return f"{text} Do not rely on it without more presses."
    return f"{text} More presses can confirm it."


def _confidence(lump: Lump, confidence: Confidence) -> str:
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    parts = [f"{format_span(confidence.contrast, 2)} for the ratio of moduli"]
    if confidence.youngs_mpa is not None:
        parts = [f"{format_span(confidence.youngs_mpa, 2)} MPa for its modulus"]
    if confidence.radius_mm is not None:
        parts.insert(0, f"{format_span(confidence.radius_mm)} mm for that radius")
    depth, depths = lump.depth, lump.depth_90_mm
    if depth and depths and depths[1] - depths[0] > _UNCERTAIN * depth.center_mm:
        parts.append(f"{format_span(depths, 2)} mm for its depth")
    many = "90 % intervals are" if len(parts) > 1 else "the 90 % interval is"
    stated = ", ".join(parts[:-1]) + " and " * (len(parts) > 1) + parts[-1]
    return (
        f"Given noise and prior, its probability is {format_percent(confidence.probability)}, "
        f"{many} {stated}, and the standard deviation of its centre is {deviation:.2g} mm."
    )


def format_modulus(value: float) -> str:
    """Return a modulus with two significant digits and its unit."""
    return f"{value:#.2g}".rstrip(".") + " MPa"


def format_percent(probability: float) -> str:
    """Return a probability in percent."""
    if probability > _SURE:
        return f"more than {100 * _SURE:.1f} %"
    return f"{100 * probability:.3g} %"


def format_span(ends: Sequence[float], digits: int = 3) -> str:
    """Return an interval."""
    return f"{ends[0]:.{digits}g} to {ends[1]:.{digits}g}"


def format_point(center_mm: Any, digits: int = 1) -> str:
    """Return a point, mm."""
    return f"({', '.join(f'{x:.{digits}f}' for x in center_mm)}) mm"
