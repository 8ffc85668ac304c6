"""Text of what a map shows, as displayed by the report."""

from dataclasses import dataclass

import numpy as np

from tactorch.findings.confidence import Confidence
from tactorch.findings.depth import Depth
from tactorch.metrics import Inclusion


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
