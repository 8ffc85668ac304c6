"""What a map shows, in numbers and in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.findings.confidence import Confidence, confidence_of
from tactorch.findings.depth import Depth, lay_under
from tactorch.findings.lumps import find_lumps
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import Side
from tactorch.recording import Recording
from tactorch.uncertainty import GaussianPosterior

#: Chances up to which a lump is called likely, and below which it is rejected.
_SURE, _DOUBTFUL = 0.99, 0.9


@dataclass(frozen=True, eq=False)
class Lump:
    """A lump: what stands out, how deep it lies, and how sure it is.

    Attributes:
        inclusion: Place, size, moduli and elements.
        size_mm: Of its bounding box along x, y and z, (3,), mm.
        depth: Under what was pressed; None where nothing was.
        confidence: By the posterior; None without one.
    """

    inclusion: Inclusion
    size_mm: Float[np.ndarray, "3"]
    depth: Depth | None
    confidence: Confidence | None

    def plain(self) -> dict[str, Any]:
        """Return plain values: mm, MPa, mm^3."""
        found, depth, sure = self.inclusion, self.depth, self.confidence
        values: dict[str, Any] = {
            **found.plain(),
            "contrast": float(found.contrast),
            "size_mm": [float(x) for x in self.size_mm],
        }
        if depth is not None:
            values |= {
                "depth_mm": depth.center_mm,
                "cover_mm": depth.cover_mm,
                "under": depth.face or [float(x) for x in depth.above_mm],
            }
        if sure is not None:
            values |= {
                "probability": sure.probability,
                "contrast_90": list(sure.contrast),
                "center_deviation_mm": [float(x) for x in sure.center_deviation_mm],
            }
        return values

    def text(self) -> str:
        """Say it in one sentence or three."""
        found = self.inclusion
        ratio = found.contrast if found.side == "stiff" else 1.0 / found.contrast
        kind = "stiff" if found.side == "stiff" else "soft"
        sentences = [
            f"A {kind} lump {self._place()}, {_by(self.size_mm)} mm (as large as a ball of radius"
            f" {found.equivalent_radius_mm:.2g} mm), {ratio:.2g} times as {kind} as what surrounds"
            f" it ({found.mean_mpa:.3g} in {found.background_mpa:.3g} MPa)."
        ]
        if self.confidence is not None:
            sentences.append(_certainty(self.confidence, found.side))
        return " ".join(sentences)

    def _place(self) -> str:
        at = f"at ({', '.join(f'{x:.2f}' for x in self.inclusion.center_mm)}) mm"
        if self.depth is None:
            return at
        side = f"the pressed side {self.depth.face}" if self.depth.face else "what was pressed"
        return f"{at}, {self.depth.center_mm:.2f} mm under {side}"


@dataclass(frozen=True, eq=False)
class Finding:
    """All that stands out in a map.

    Attributes:
        lumps: The most conspicuous first.
        background_mpa: Median modulus over the elements, MPa.
    """

    lumps: tuple[Lump, ...]
    background_mpa: float

    def plain(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "background_mpa": self.background_mpa,
            "lumps": [lump.plain() for lump in self.lumps],
        }

    def text(self) -> str:
        """Say it for a person."""
        if not self.lumps:
            return f"No lump stands out; Young's modulus is {self.background_mpa:.3g} MPa."
        return "\n".join(lump.text() for lump in self.lumps)


def finding_of(
    recording: Recording,
    youngs: Float[np.ndarray, " m"],
    posterior: GaussianPosterior | None = None,
    *,
    most: int = 5,
) -> Finding:
    """Tell what stands out in a map of the object that was pressed.

    Args:
        recording: The presses; its truth is not read.
        youngs: Map, (m,), MPa.
        posterior: Of the same map; without it nothing is said of how sure the lumps are.
        most: Lumps at most.

    Raises:
        MeshError: The map is not over the elements of the recording's mesh, or a modulus of it
            not above 0.
    """
    mesh = recording.mesh
    lumps = [
        Lump(
            inclusion=found,
            size_mm=_extent(mesh, found),
            depth=lay_under(mesh, recording.presses, found.center_mm, found.elements),
            confidence=None if posterior is None else confidence_of(mesh, found, posterior),
        )
        for found in find_lumps(mesh, youngs, most=most)
    ]
    return Finding(tuple(lumps), float(np.median(youngs)))


def _extent(mesh: TetMesh, found: Inclusion) -> Float[np.ndarray, "3"]:
    """Sides of the box around a lump's elements, as of a body of even density.

    The corners of elements that a lump only touches would make it too large: the box is that of
    the ellipsoid with the same second moments.
    """
    weights = mesh.volumes * found.elements
    offsets = mesh.centroids - found.center_mm
    within = np.ptp(mesh.points[mesh.tets], axis=1) ** 2 / 20.0  # about the element's second moment
    moments = (weights @ (offsets**2 + within)) / weights.sum()
    return 2.0 * np.sqrt(5.0 * moments)


def _certainty(sure: Confidence, side: Side) -> str:
    deviation = float(np.linalg.norm(sure.center_deviation_mm))
    said = (
        f"By noise and prior it is there with {_percent(sure.probability)}, at least"
        f" {sure.at_least(side):.2g} times as {side} (95 %), its centre known to"
        f" {deviation:.2g} mm."
    )
    if sure.probability < _DOUBTFUL:
        return f"{said} Do not believe it without more presses."
    return said if sure.probability >= _SURE else f"{said} More presses would clarify it."


def _percent(chance: float) -> str:
    return "more than 99.9 %" if chance > 0.999 else f"{100 * chance:.3g} %"


def _by(lengths: Sequence[float] | Float[np.ndarray, " k"]) -> str:
    return " x ".join(f"{x:.2g}" for x in lengths)
