"""The words for a result, shared by the command line, the report, notebooks and live runs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tactorch.inverse.result.lump import Confidence, Elongation, Lump
from tactorch.inverse.result.reconstruction import Reconstruction
from tactorch.inverse.result.shapes import Alternative

_UNCERTAIN = 0.1  # width of the interval of a depth, over the depth, from which it is reported
# Probabilities above which a lump is certain, and below which it is doubtful.
_CERTAIN, _DOUBTFUL = 0.99, 0.9
_SURE = 0.999  # probability above which the excess is not stated


class Fact(NamedTuple):
    """One quantity of a lump; the note has its interval, definition or further values."""

    label: str
    value: str
    note: str = ""


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
    modulus = f"Young's modulus is {result.background_mpa:.3g} MPa"
    if result.shapes is not None:
        modulus += f" (90 %: {_span(result.shapes.background_90_mpa)} MPa)"
    found = [f"Nothing found: no lump stands out; {modulus}."]
    if result.lumps:
        first = [] if result.shapes is not None else ["In the element map:"]
        found = [*first, *map(describe_lump, result.lumps)]
    return [*found, *describe_steps(result), *describe_alternatives(result)]


def describe_steps(result: Reconstruction) -> list[str]:
    """Return a sentence for each layer, skin or base beyond a plane."""
    return [
        f"Where {step.side[0]} {'<' if step.side[1] == '-' else '>'} {step.place_mm:.3g} mm, "
        f"Young's modulus is {step.contrast:.2g} times that of the rest; 90 % intervals are "
        f"{_span(step.place_90_mm)} mm and {_span(step.contrast_90, 2)} times."
        for step in (result.shapes.steps if result.shapes is not None else ())
    ]


def describe_alternatives(result: Reconstruction) -> list[str]:
    """Return a sentence on other models that explain the presses about as well.

    There is none where the lumps are not all inclusions of the model, whose probability is stated.
    """
    shapes = result.shapes
    if shapes is None or len(result.lumps) != len(shapes.inclusions) or not shapes.alternatives:
        return []
    others = shapes.alternatives
    own = _percent(1.0 - sum(other.probability for other in others))
    texts = [f"{_describe_other(other)} ({_percent(other.probability)})" for other in others]
    return [
        "Other models explain the presses about as well. The one above has a probability of "
        f"{own}; or there is {', or '.join(texts)}."
    ]


def _describe_other(other: Alternative) -> str:
    """Return the inclusions and steps of an alternative in words."""
    parts = []
    for shape in other.shapes:
        word = "stiff" if shape.contrast > 1.0 else "soft"
        times = max(shape.contrast, 1.0 / shape.contrast)
        size, long = _size(shape.size_mm, Elongation.of(shape), shape.form)
        where = f"a {long}{word} {shape.form} at {_point(shape.centroid_mm)}, {size}"
        parts.append(f"{where}, {times:.2g} times as {word} as its surroundings")
    for side, place, contrast in other.steps:
        axis, sign = side[0], "<" if side[1] == "-" else ">"
        where = f"{axis} {sign} {place:.3g} mm"
        parts.append(f"a step to {contrast:.2g} times the modulus where {where}")
    return " and ".join(parts) or "no lump"


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
        return f"A stiff {lump.form}, {contrast:.2g} times as stiff as its surroundings"
    return f"A soft {lump.form}, {1 / contrast:.2g} times softer than its surroundings"


def lead(result: Reconstruction) -> str:
    """Return the finding in one or two sentences below the headline."""
    if result.reasons:
        return " ".join(reason[0].upper() + reason[1:] for reason in result.reasons)
    if not result.lumps:
        modulus = format_modulus(result.background_mpa)
        if steps := describe_steps(result):
            return " ".join([f"Young's modulus is {modulus}.", *steps])
        return f"Young's modulus is {modulus} and nearly uniform where the presses resolve it."
    lump = result.lumps[0]
    first = f"{_headline(lump)}. " if len(result.lumps) > 1 else ""
    depth, diameter = lump.depth, 2 * lump.inclusion.equivalent_radius_mm
    centre = "" if depth is None else f"its centre {depth.center_mm:.1f} mm below {depth.surface}, "
    point = _point(lump.inclusion.center_mm)
    return f"{first}It is at {point}, {centre}and has the volume of a ball of {diameter:.1f} mm."


def describe_lump(lump: Lump) -> str:
    """Return location, depth, size, contrast and intervals in up to three sentences."""
    inclusion, depth, side = lump.inclusion, lump.depth, lump.inclusion.side
    ratio = inclusion.contrast if side == "stiff" else 1.0 / inclusion.contrast
    below = "" if depth is None else f", {depth.center_mm:.2f} mm below {depth.surface}"
    size, long = _size(lump.size_mm, lump.elongation, lump.form)
    text = (
        f"A {long}{side} {lump.form} at {_point(inclusion.center_mm, 2)}{below}, {size} "
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


def _size(size_mm: Iterable[float], elongation: Elongation | None, form: str) -> tuple[str, str]:
    """Return the size of a lump in words, and an adjective."""
    if elongation is not None:
        return elongation.text(), "long " * (form == "lump")
    return f"{' x '.join(f'{x:.2g}' for x in size_mm)} mm", ""


def _confidence(lump: Lump, confidence: Confidence) -> str:
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    parts = [f"{_span(confidence.contrast, 2)} for the ratio of moduli"]
    if confidence.youngs_mpa is not None:
        parts = [f"{_span(confidence.youngs_mpa, 2)} MPa for its modulus"]
    if confidence.radius_mm is not None:
        parts.insert(0, f"{_span(confidence.radius_mm)} mm for that radius")
    depth, depths = lump.depth, lump.depth_90_mm
    if depth and depths and depths[1] - depths[0] > _UNCERTAIN * depth.center_mm:
        parts.append(f"{_span(depths, 2)} mm for its depth")
    many = "90 % intervals are" if len(parts) > 1 else "the 90 % interval is"
    stated = ", ".join(parts[:-1]) + " and " * (len(parts) > 1) + parts[-1]
    return (
        f"Given noise and prior, its probability is {_percent(confidence.probability)}, {many} "
        f"{stated}, and the standard deviation of its centre is {deviation:.2g} mm."
    )


def lump_facts(lump: Lump) -> list[Fact]:
    """Return location, size, modulus and probability, each with its 90 % interval."""
    inclusion, depth, confidence = lump.inclusion, lump.depth, lump.confidence
    point, diameter = _point(inclusion.center_mm), 2 * inclusion.equivalent_radius_mm
    location = Fact("Location", point)
    if depth is not None:
        within = f"{_within(lump.depth_90_mm, 3)}below {depth.surface}; at {point}"
        location = Fact("Depth", _length(depth.center_mm, lump.depth_90_mm), within)
    radii = None if confidence is None else confidence.radius_mm
    diameters = None if radii is None else (2 * radii[0], 2 * radii[1])
    volume = f"diameter of a ball of its volume, {inclusion.volume_mm3:.3g} mm³"
    volume = _within(diameters, 3) + volume
    youngs = None if confidence is None else confidence.youngs_mpa
    kind = "mean; " if youngs is None else _within(youngs)
    background = f"{kind}{format_modulus(inclusion.background_mpa)} in its surroundings"
    return [
        location,
        Fact("Size", _length(diameter, diameters), volume),
        Fact("Young's modulus", format_modulus(inclusion.mean_mpa), background),
        _probability(lump),
    ]


def _probability(lump: Lump) -> Fact:
    confidence, side = lump.confidence, lump.inclusion.side
    if confidence is None:
        return Fact("Probability", "unknown", "the uncertainty was not computed")
    is_shape = confidence.radius_mm is not None
    what = "that the inclusion exists" if is_shape else f"that it is {side}er than its surroundings"
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    return Fact(
        "Probability",
        _percent(confidence.probability).replace("more than", "over"),
        f"{what}, given noise and prior; 90 % interval of the ratio of moduli "
        f"{_span(confidence.contrast, 2)}; standard deviation of its centre {deviation:.2g} mm",
    )


def _length(value_mm: float, within_mm: Sequence[float] | None) -> str:
    """Return a length with the digits of its interval."""
    return f"{value_mm:.1f} mm" if within_mm is None else f"{value_mm:#.3g} mm"


def format_modulus(value: float) -> str:
    """Return a modulus with two significant digits and its unit."""
    return f"{value:#.2g}".rstrip(".") + " MPa"


def summarize_plain(values: Mapping[str, Any] | None, background_mpa: float) -> str:
    """Return a table cell for a lump as of `Lump.plain`, with its 90 % intervals, or for none."""
    if values is None:
        return f"none; {background_mpa:.3g} MPa"
    radius = _interval(values.get("equivalent_radius_90_mm"))
    youngs = _interval(values.get("mean_90_mpa"))
    return (
        f"{values['side']} at {_point(values['center_mm'])}, radius "
        f"{values['equivalent_radius_mm']:.1f}{radius} mm: {values['mean_mpa']:.3g}{youngs} MPa in "
        f"{values['background_mpa']:.3g}"
    )


def summarize_finding(values: Mapping[str, Any]) -> str:
    """Return a table cell for a result in plain values, as of `Reconstruction.plain`."""
    if values["status"] == "cannot tell":
        return "cannot tell"
    first, *others = values["lumps"] or [None]
    more = f"; {len(others)} more" if others else ""
    return summarize_plain(first, values["background_mpa"]) + more


def _percent(probability: float) -> str:
    if probability > _SURE:
        return f"more than {100 * _SURE:.1f} %"
    return f"{100 * probability:.3g} %"


def _span(ends: Sequence[float], digits: int = 3) -> str:
    return f"{ends[0]:.{digits}g} to {ends[1]:.{digits}g}"


def _within(ends: Sequence[float] | None, digits: int = 2) -> str:
    return "" if ends is None else f"90 %: {_span(ends, digits)}; "


def _interval(ends: Sequence[float] | None) -> str:
    return "" if ends is None else f" ({_span(ends, 2)})"


def _point(center_mm: Any, digits: int = 1) -> str:
    return f"({', '.join(f'{x:.{digits}f}' for x in center_mm)}) mm"
