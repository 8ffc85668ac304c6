"""What was found, in words that stand at the top: where, how stiff, how sure, what not to believe.

`finding` is the one place where a report's words on the map come from.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.findings import Confidence, find_lump
from tactorch.metrics import Inclusion
from tactorch.recording import Recording
from tactorch.report.belief import Judgement
from tactorch.report.runs import Run

_ALARM = "DO NOT TRUST THIS MAP"
_FACTOR = 2.0  # a modulus that is not known to within it is told as unknown
_WORTH_TELLING = 0.02  # of the volume
_MOST_CHI = 1.5  # standard deviations that a fit may be off


@dataclass(frozen=True)
class Fact:
    """One number at the top: what it is, its value, and a few words more."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True, eq=False)
class Finding:
    """What a person should know first.

    Attributes:
        headline: The finding in one line.
        text: It in a sentence or two.
        facts: Where, how large, how stiff, how sure.
        alarms: Why the map should not be trusted at all.
        cautions: What else not to believe.
        inclusion: The region that is told of, if one stands out.
    """

    headline: str
    text: str
    facts: list[Fact]
    alarms: list[str]
    cautions: list[str]
    inclusion: Inclusion | None


def finding(run: Run, judged: Judgement) -> Finding:
    """Say what a run has found and how far to believe it."""
    mesh = run.found.mesh
    inclusion = find_lump(mesh, run.found.youngs)
    fit = math.sqrt(float(run.summary.get("chi2", math.nan)))
    fitted = Fact(
        "Fit", f"{fit:.2g} SD", "of the displacements' noise; near 1 or less is a good fit"
    )
    facts = [] if inclusion is None else _facts(run, judged, inclusion)
    median = float(np.median(run.found.youngs))
    if inclusion is None:
        facts.append(Fact("Stiffness", _mpa(median), "median"))
    plain = f"Young's modulus is {_mpa(median)}, much the same wherever the presses tell of it."
    return Finding(
        headline="No inclusion stands out" if inclusion is None else _headline(inclusion),
        text=plain if inclusion is None else _sentence(run, inclusion),
        facts=[*facts, fitted],
        alarms=[line for line in run.text.splitlines() if line.startswith(_ALARM)],
        cautions=_cautions(run, judged, inclusion, fit),
        inclusion=inclusion,
    )


def _headline(inclusion: Inclusion) -> str:
    ratio = inclusion.contrast
    if inclusion.side == "stiff":
        return f"A stiff inclusion, {ratio:.2g} times as stiff as what surrounds it"
    return f"A soft inclusion, {1 / ratio:.2g} times softer than what surrounds it"


def _sentence(run: Run, inclusion: Inclusion) -> str:
    x, y, z = inclusion.center_mm
    depth, side = _depth(run, inclusion)
    return (
        f"It lies at ({x:.1f}, {y:.1f}, {z:.1f}) mm, its centre {depth:.1f} mm below {side}, and is"
        f" as large as a ball {2 * inclusion.equivalent_radius_mm:.1f} mm across."
    )


def _facts(run: Run, judged: Judgement, inclusion: Inclusion) -> list[Fact]:
    x, y, z = inclusion.center_mm
    depth, side = _depth(run, inclusion)
    facts = [
        Fact("Where", f"{depth:.1f} mm deep", f"below {side}; at ({x:.1f}, {y:.1f}, {z:.1f}) mm"),
        Fact(
            "Size",
            f"{2 * inclusion.equivalent_radius_mm:.1f} mm",
            f"across, as a ball of its {inclusion.volume_mm3:.3g} mm³",
        ),
        Fact(
            "Stiffness",
            _mpa(inclusion.mean_mpa),
            f"on average; what surrounds it has {_mpa(inclusion.background_mpa)}",
        ),
    ]
    if judged.belief is None:
        return [*facts, Fact("How sure", "not told", "the uncertainty was not computed")]
    if judged.belief.sure is None:
        return [*facts, Fact("How sure", "not told", "the uncertainty was not computed")]
    return [*facts, _sureness(inclusion, judged.belief.sure)]


def _sureness(inclusion: Inclusion, sure: Confidence) -> Fact:
    chance = 100 * sure.probability
    kind = "stiffer" if inclusion.side == "stiff" else "softer"
    apart = float(np.linalg.norm(sure.center_deviation_mm))
    return Fact(
        "How sure",
        "over 99.9 %" if chance > 99.9 else f"{chance:.3g} %",
        f"that it is {kind} than what surrounds it, by noise and prior: at least"
        f" {sure.at_least(inclusion.side):.2g} times (95 %); its centre is known to {apart:.2g} mm",
    )


def _mpa(value: float) -> str:
    """Two digits, also where the second is a 0."""
    return f"{value:#.2g}".rstrip(".") + " MPa"


def _depth(run: Run, inclusion: Inclusion) -> tuple[float, str]:
    """How far the centre of an inclusion is from the nearest of the surface that was pressed."""
    mesh, surface = run.found.mesh, run.found.mesh.surface
    chosen = np.ones(len(surface.areas), dtype=bool)
    side = "the surface"
    if run.recording is not None:
        pressed = _pressed_nodes(run.recording)[surface.triangles].all(axis=1)
        if pressed.any():
            chosen, side = pressed, "the nearest place pressed"
    corners = mesh.points[surface.triangles[chosen]]
    return float(_distances(np.asarray(inclusion.center_mm), corners).min()), side


def _pressed_nodes(recording: Recording) -> Bool[np.ndarray, " n"]:
    return np.any([press.forces.any(axis=1) for press in recording.presses], axis=0)


def _distances(
    point: Float[np.ndarray, "3"], corners: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, " k"]:
    """Distance of a point from triangles: over each one's face, or from points along its edges."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("kj,kj->k", point - a, normal)
    foot = point - height[:, None] * normal
    turns = [np.cross(q - p, foot - p) for p, q in ((a, b), (b, c), (c, a))]
    over = np.all([np.einsum("kj,kj->k", turn, normal) >= 0 for turn in turns], axis=0)
    edges = [_from_segment(point, p, q) for p, q in ((a, b), (b, c), (c, a))]
    return np.where(over, np.abs(height), np.min(edges, axis=0))


def _from_segment(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    along = end - start
    share = np.einsum("kj,kj->k", point - start, along) / np.einsum("kj,kj->k", along, along)
    return np.linalg.norm(start + np.clip(share, 0, 1)[:, None] * along - point, axis=1)


def _cautions(run: Run, judged: Judgement, inclusion: Inclusion | None, fit: float) -> list[str]:
    found, told = run.found, []
    if fit > _MOST_CHI:
        told.append(
            "The map does not explain the presses: they are missed by"
            f" {fit:.2g} standard deviations."
        )
    if judged.belief is not None:
        volumes = found.mesh.volumes
        wide = ~(judged.belief.spread <= _FACTOR - 1.0)  # at a bound too
        share = float(volumes[wide].sum() / volumes.sum())
        if share > _WORTH_TELLING:
            told.append(
                f"In {100 * share:.0f} % of the volume the modulus is not known to within a factor"
                " of two."
            )
    if inclusion is not None and "total_variation" in str(_prior(run)):
        told.append(
            "How stiff the inclusion is: the prior (total variation) draws it towards what"
            " surrounds it, so that the true contrast is often larger than the one shown, and"
            " intervals within it are too narrow."
        )
    if run.recording is not None and _noise_assumed(run, run.recording):
        told.append(
            "The noise of the displacements was not stated but assumed; if it is larger, fine"
            " detail of the map is noise, and intervals are too narrow."
        )
    for name, estimate in found.nuisance.items():
        if not np.isfinite(estimate.deviation).any():
            told.append(f"The estimate of {name}: how sure it is was not computed.")
        elif not estimate.is_informative:
            told.append(f"The estimate of {name}: the presses tell little of it.")
    return told


def _prior(run: Run) -> object:
    prior = run.found.config.get("settings", {}).get("regularization", "")
    return prior.get("name", "") if isinstance(prior, dict) else prior


def _noise_assumed(run: Run, recording: Recording) -> bool:
    stated = run.found.config.get("settings", {}).get("noise", {}).get("mm") is not None
    return (
        not stated
        and recording.unloaded is None
        and any(press.noise_mm is None for press in recording.presses)
    )
