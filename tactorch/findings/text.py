"""Text of findings, shared by the command line, the report and live runs."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tactorch.findings.finding import Finding, Lump, Status
from tactorch.metrics import Inclusion


class Fact(NamedTuple):
    """One quantity of a finding; the note has its definition or further values."""

    label: str
    value: str
    note: str = ""


def describe_finding(finding: Finding, presses: int, total: int) -> str:
    """Return the text of a finding, and whether it is of the map or of fewer presses than all."""
    if presses < total:
        return f"Of the first {presses} of {total} presses:\n{finding.text()}"
    if finding.shapes is None and finding.lumps:
        return f"In the map:\n{finding.text()}"
    return finding.text()


def headline(inclusion: Inclusion | None) -> str:
    """Return the most conspicuous inclusion of a map, or that there is none, in one line."""
    if inclusion is None:
        return "No inclusion stands out"
    if inclusion.side == "stiff":
        return f"A stiff inclusion, {inclusion.contrast:.2g} times as stiff as its surroundings"
    return f"A soft inclusion, {1 / inclusion.contrast:.2g} times softer than its surroundings"


def describe_lump(lump: Lump) -> str:
    """Return location, depth and size as a sentence."""
    depth, diameter = lump.depth, 2 * lump.inclusion.equivalent_radius_mm
    centre = "" if depth is None else f"its centre {depth.center_mm:.1f} mm below {depth.surface}, "
    point = _point(lump.inclusion.center_mm)
    return f"It is at {point}, {centre}and has the volume of a ball of diameter {diameter:.1f} mm."


def lump_facts(lump: Lump) -> list[Fact]:
    """Return location, size, modulus and probability."""
    inclusion, depth = lump.inclusion, lump.depth
    point, diameter = _point(inclusion.center_mm), 2 * inclusion.equivalent_radius_mm
    location = Fact("Location", point)
    if depth is not None:
        location = Fact("Depth", f"{depth.center_mm:.1f} mm", f"below {depth.surface}; at {point}")
    volume = f"diameter of a ball of its volume, {inclusion.volume_mm3:.3g} mm³"
    background = f"mean; {format_modulus(inclusion.background_mpa)} in its surroundings"
    return [
        location,
        Fact("Size", f"{diameter:.1f} mm", volume),
        Fact("Young's modulus", format_modulus(inclusion.mean_mpa), background),
        _probability(lump),
    ]


def format_modulus(value: float) -> str:
    """Return a modulus with two significant digits and its unit."""
    return f"{value:#.2g}".rstrip(".") + " MPa"


def summarize_inclusion(inclusion: Inclusion | None, median_mpa: float) -> str:
    """Return the inclusion of a map (None: no inclusion) and its modulus as one sentence."""
    if inclusion is None:
        return f"No inclusion stands out; Young's modulus is {median_mpa:.3g} MPa."
    return (
        f"A {inclusion.side} inclusion at {_point(inclusion.center_mm, 2)}, with the volume of a "
        f"ball of radius {inclusion.equivalent_radius_mm:.2f} mm: {inclusion.mean_mpa:.3g} MPa on "
        f"average in {inclusion.background_mpa:.3g} MPa."
    )


def summarize_plain(values: Mapping[str, Any] | None, median_mpa: float) -> str:
    """Return a table cell for an inclusion in plain values, with its 90 % intervals.

    Args:
        values: Values of `Inclusion.plain` or `Lump.plain`; None if there is no inclusion.
        median_mpa: Young's modulus of the object then, MPa.
    """
    if values is None:
        return f"none; {median_mpa:.3g} MPa"
    radius = _interval(values.get("equivalent_radius_90_mm"))
    youngs = _interval(values.get("mean_90_mpa"))
    return (
        f"{values['side']} at {_point(values['center_mm'])}, radius "
        f"{values['equivalent_radius_mm']:.1f}{radius} mm: {values['mean_mpa']:.3g}{youngs} MPa in "
        f"{values['background_mpa']:.3g}"
    )


def summarize_finding(values: Mapping[str, Any]) -> str:
    """Return a table cell for a finding in plain values, as of `Finding.plain`."""
    if values["status"] == Status.UNKNOWN:
        return "cannot tell"
    first, *others = values["lumps"] or [None]
    more = f"; {len(others)} more" if others else ""
    return summarize_plain(first, values["background_mpa"]) + more


def _probability(lump: Lump) -> Fact:
    if lump.confidence is None:
        return Fact("Probability", "unknown", "the uncertainty was not computed")
    confidence, side = lump.confidence, lump.inclusion.side
    percent = 100 * confidence.probability
    deviation = float(np.linalg.norm(confidence.center_deviation_mm))
    return Fact(
        "Probability",
        "over 99.9 %" if percent > 99.9 else f"{percent:.3g} %",
        f"that it is {'stiffer' if side == 'stiff' else 'softer'} than its surroundings, given "
        f"noise and prior; {confidence.bound_text(side)}; standard deviation of its centre "
        f"{deviation:.2g} mm",
    )


def _interval(ends: Sequence[float] | None) -> str:
    return "" if ends is None else f" ({ends[0]:.2g} to {ends[1]:.2g})"


def _point(center_mm: Any, digits: int = 1) -> str:
    return f"({', '.join(f'{x:.{digits}f}' for x in center_mm)}) mm"
