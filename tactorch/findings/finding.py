"""Lumps of a map as numbers with intervals."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.findings.confidence import Confidence, compute_confidence
from tactorch.findings.depth import Depth, measure_depth
from tactorch.findings.lumps import find_lumps
from tactorch.findings.text import describe_lump
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.recording import Recording
from tactorch.uncertainty import GaussianPosterior


@dataclass(frozen=True, eq=False)
class Lump:
    """A lump with its depth and confidence.

    Attributes:
        inclusion: Location, size, moduli and elements.
        size_mm: Size along x, y and z, (3,), mm.
        depth: Depth below the presses; None if no press pushes.
        confidence: Confidence by the posterior; None without a posterior.
    """

    inclusion: Inclusion
    size_mm: Float[np.ndarray, "3"]
    depth: Depth | None
    confidence: Confidence | None

    def plain(self) -> dict[str, Any]:
        """Return plain values: mm, MPa, mm^3."""
        inclusion, depth, confidence = self.inclusion, self.depth, self.confidence
        values: dict[str, Any] = {
            **inclusion.plain(),
            "contrast": float(inclusion.contrast),
            "size_mm": [float(x) for x in self.size_mm],
        }
        if depth is not None:
            values |= {
                "depth_mm": depth.center_mm,
                "cover_mm": depth.cover_mm,
                "under": depth.face or [float(x) for x in depth.above_mm],
            }
        if confidence is not None:
            values |= {
                "probability": confidence.probability,
                "contrast_90": list(confidence.contrast),
                "center_deviation_mm": [float(x) for x in confidence.center_deviation_mm],
            }
        return values

    def text(self) -> str:
        """Return the lump as text, see `tactorch.findings.text.describe_lump`."""
        return describe_lump(self.inclusion, self.size_mm, self.depth, self.confidence)


@dataclass(frozen=True, eq=False)
class Finding:
    """All lumps of a map.

    Attributes:
        lumps: Lumps, the most conspicuous first.
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
        """Return the finding as text, one line per lump."""
        if not self.lumps:
            return f"No lump stands out; Young's modulus is {self.background_mpa:.3g} MPa."
        return "\n".join(lump.text() for lump in self.lumps)


def build_finding(
    recording: Recording,
    youngs: Float[np.ndarray, " m"],
    posterior: GaussianPosterior | None = None,
    *,
    max_lumps: int = 5,
) -> Finding:
    """Find the lumps of a map, and measure their depth and confidence.

    Args:
        recording: Presses; the truth is not read.
        youngs: Map, (m,), MPa.
        posterior: Posterior of the same map; without it the lumps have no confidence.
        max_lumps: Largest number of lumps.

    Returns:
        The lumps and the background.

    Raises:
        MeshError: The map does not fit the recording's mesh, or a modulus is not above 0.
    """
    mesh = recording.mesh
    lumps = [
        Lump(
            inclusion=inclusion,
            size_mm=_size(mesh, inclusion),
            depth=measure_depth(mesh, recording.presses, inclusion.center_mm, inclusion.elements),
            confidence=(
                None if posterior is None else compute_confidence(mesh, inclusion, posterior)
            ),
        )
        for inclusion in find_lumps(mesh, youngs, max_lumps=max_lumps)
    ]
    return Finding(tuple(lumps), float(np.median(youngs)))


def _size(mesh: TetMesh, inclusion: Inclusion) -> Float[np.ndarray, "3"]:
    """Axes of the ellipsoid with the second moments of the elements.

    The bounding box of the elements would be too large: it holds corners far from the lump.
    """
    weights = mesh.volumes * inclusion.elements
    offsets = mesh.centroids - inclusion.center_mm
    within = np.ptp(mesh.points[mesh.tets], axis=1) ** 2 / 20.0  # approximate moment of an element
    moments = (weights @ (offsets**2 + within)) / weights.sum()
    return 2.0 * np.sqrt(5.0 * moments)
