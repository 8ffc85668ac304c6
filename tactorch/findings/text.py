"""Text of findings, shared by the command line, the report and live runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.findings.confidence import Confidence
from tactorch.findings.depth import Depth
from tactorch.metrics import Inclusion

# Probabilities above which a lump is certain, and below which it is doubtful.
_CERTAIN, _DOUBTFUL = 0.99, 0.9


@dataclass(frozen=True)
class Fact:
    """One quantity of a finding.

    Attributes:
        label: Name of the quantity.
        value: Value with unit.
        note: Definition or further values.
    """

    label: str
    value: str
    note: str = ""


def headline(inclusion: Inclusion | None) -> str:
    """Return the finding in one line.

    Args:
        inclusion: Most conspicuous inclusion of the map, or None.
    """
    if inclusion is None:
        return "No inclusion stands out"
    if inclusion.side == "stiff":
        return f"A stiff inclusion, {inclusion.contrast:.2g} times as stiff as its surroundings"
    return f"A soft inclusion, {1 / inclusion.contrast:.2g} times softer than its surroundings"


def describe_inclusion(inclusion: Inclusion, depth: Depth | None) -> str:
    """Return location, depth and size of an inclusion as a sentence."""
    below = (
        "" if depth is None else f", its centre {depth.center_mm:.1f} mm below {_surface(depth)}"
    )
    return (
        f"It is at {_point(inclusion)}{below}, and has the volume of a ball of diameter"
        f" {2 * inclusion.equivalent_radius_mm:.1f} mm."
    )


def inclusion_facts(
    inclusion: Inclusion, depth: Depth | None, confidence: Confidence | None
) -> list[Fact]:
    """Return location, size, modulus and probability of an inclusion.

    Args:
        inclusion: The inclusion.
        depth: Depth below the presses, or None if unknown.
        confidence: Confidence by the posterior, or None if it was not computed.
    """
    point = _point(inclusion)
    location = (
        Fact("Location", point)
        if depth is None
        else Fact("Depth", f"{depth.center_mm:.1f} mm", f"below {_surface(depth)}; at {point}")
    )
    return [
        location,
        Fact(
            "Size",
            f"{2 * inclusion.equivalent_radius_mm:.1f} mm",
            f"diameter of a ball of its volume, {inclusion.volume_mm3:.3g} mm³",
        ),
        Fact(
            "Young's modulus",
            format_modulus(inclusion.mean_mpa),
            f"mean; {format_modulus(inclusion.background_mpa)} in its surroundings",
        ),
        _probability(inclusion, confidence),
    ]


def format_modulus(value: float) -> str:
    """Return a modulus with two significant digits and its unit."""
    return f"{value:#.2g}".rstrip(".") + " MPa"


def summarize_inclusion(inclusion: Inclusion | None, median_mpa: float) -> str:
    """Return location, size and modulus of an inclusion as one sentence.

    Args:
        inclusion: Most conspicuous inclusion of the map, or None.
        median_mpa: Median modulus of the map, MPa.
    """
    if inclusion is None:
        return f"No inclusion stands out; Young's modulus is {median_mpa:.3g} MPa."
    x, y, z = inclusion.center_mm
    return (
        f"A {inclusion.side} inclusion at ({x:.2f}, {y:.2f}, {z:.2f}) mm, with the volume of a "
        f"ball of radius {inclusion.equivalent_radius_mm:.2f} mm: {inclusion.mean_mpa:.3g} MPa on "
        f"average in {inclusion.background_mpa:.3g} MPa."
    )


def summarize_plain(values: Mapping[str, Any] | None, median_mpa: float) -> str:
    """Return a table cell for an inclusion in plain values, as of `Inclusion.plain`."""
    if values is None:
        return f"none; {median_mpa:.3g} MPa"
    x, y, z = values["center_mm"]
    return (
        f"{values['side']} at ({x:.1f}, {y:.1f}, {z:.1f}) mm, radius "
        f"{values['equivalent_radius_mm']:.1f} mm: {values['mean_mpa']:.3g} MPa in "
        f"{values['background_mpa']:.3g}"
    )


def describe_lump(
    inclusion: Inclusion,
    size_mm: Float[np.ndarray, "3"],
    depth: Depth | None,
    confidence: Confidence | None,
) -> str:
    """Return location, depth, size, contrast and confidence of a lump in up to three sentences.

    Args:
        inclusion: The lump.
        size_mm: Size along x, y and z, mm.
        depth: Depth below the presses, or None if unknown.
        confidence: Confidence by the posterior, or None if it was not computed.
    """
    side = inclusion.side
    ratio = inclusion.contrast if side == "stiff" else 1.0 / inclusion.contrast
    point = ", ".join(f"{x:.2f}" for x in inclusion.center_mm)
    below = "" if depth is None else f", {depth.center_mm:.2f} mm below {_surface(depth)}"
    text = (
        f"A {side} lump at ({point}) mm{below}, {' x '.join(f'{x:.2g}' for x in size_mm)} mm (the "
        f"volume of a ball of radius {inclusion.equivalent_radius_mm:.2g} mm), {ratio:.2g} times "
        f"as {side} as its surroundings ({inclusion.mean_mpa:.3g} in "
        f"{inclusion.background_mpa:.3g} MPa)."
    )
    return text if confidence is None else f"{text} {_describe_confidence(inclusion, confidence)}"


def _describe_confidence(inclusion: Inclusion, confidence: Confidence) -> str:
    side, probability = inclusion.side, confidence.probability
    percent = "more than 99.9 %" if probability > 0.999 else f"{100 * probability:.3g} %"
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    text = (
        f"Given noise and prior, its probability is {percent}, it is at least "
        f"{confidence.at_least(side):.2g} times as {side} (95 %), and the standard deviation of "
        f"its centre is {deviation:.2g} mm."
    )
    if probability < _DOUBTFUL:
        return f"{text} Do not rely on it without more presses."
    return text if probability >= _CERTAIN else f"{text} More presses can confirm it."


def _probability(inclusion: Inclusion, confidence: Confidence | None) -> Fact:
    if confidence is None:
        return Fact("Probability", "unknown", "the uncertainty was not computed")
    percent = 100 * confidence.probability
    kind = "stiffer" if inclusion.side == "stiff" else "softer"
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    return Fact(
        "Probability",
        "over 99.9 %" if percent > 99.9 else f"{percent:.3g} %",
        f"that it is {kind} than its surroundings, given noise and prior; at least"
        f" {confidence.at_least(inclusion.side):.2g} times (95 %); standard deviation of its"
        f" centre {deviation:.2g} mm",
    )


def _surface(depth: Depth) -> str:
    return f"the pressed side {depth.face}" if depth.face else "the pressed surface"


def _point(inclusion: Inclusion) -> str:
    x, y, z = inclusion.center_mm
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"
