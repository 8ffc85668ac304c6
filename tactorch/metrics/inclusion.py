"""The inclusion of a map, without the truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import TetMesh
from tactorch.metrics.checks import check_on_mesh
from tactorch.metrics.segment import (
    Side,
    connected_parts,
    inclusion_side,
    segment,
    volume_mean,
)


@dataclass(frozen=True, eq=False)
class Inclusion:
    """A connected region that is stiffer or softer than the background.

    Attributes:
        center_mm: Centroid, (3,), mm.
        volume_mm3: Volume, mm^3.
        equivalent_radius_mm: Radius of the sphere of that volume, mm.
        mean_mpa: Mean modulus over its volume, MPa.
        background_mpa: Mean modulus over the volume of the background, MPa.
        elements: Its elements, (m,).
        side: "stiff" or "soft".
    """

    center_mm: Float[np.ndarray, "3"]
    volume_mm3: float
    equivalent_radius_mm: float
    mean_mpa: float
    background_mpa: float
    elements: Bool[np.ndarray, " m"]
    side: Side

    @staticmethod
    def measure(
        mesh: TetMesh,
        youngs: Float[np.ndarray, " m"],
        elements: Bool[np.ndarray, " m"],
        side: Side,
        background_mpa: float,
        center_mm: Float[np.ndarray, "3"],
    ) -> "Inclusion":
        """Return the inclusion of these elements, with its volume and mean modulus."""
        volume = float(mesh.volumes[elements].sum())
        return Inclusion(
            center_mm=center_mm,
            volume_mm3=volume,
            equivalent_radius_mm=float(np.cbrt(3 * volume / (4 * np.pi))),
            mean_mpa=float(volume_mean(mesh, youngs, elements)),
            background_mpa=background_mpa,
            elements=elements,
            side=side,
        )

    @property
    def contrast(self) -> float:
        """Modulus of the inclusion over that of the background."""
        return self.mean_mpa / self.background_mpa

    def plain(self) -> dict[str, Any]:
        """Return all but the elements as plain values, mm and MPa."""
        return {
            "side": self.side,
            "center_mm": [float(x) for x in self.center_mm],
            "volume_mm3": float(self.volume_mm3),
            "equivalent_radius_mm": float(self.equivalent_radius_mm),
            "mean_mpa": float(self.mean_mpa),
            "background_mpa": float(self.background_mpa),
        }


def find_inclusion(mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> Inclusion | None:
    """Find the largest face-connected region of the segmented map (`tactorch.metrics.segment`).

    `tactorch.findings.find_lump`, which the commands use, is more robust to outlier elements.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.

    Returns:
        The inclusion; None if the map stays within 2 % of its background.

    Raises:
        MeshError: The field does not fit the mesh.
    """
    check_on_mesh(mesh, "youngs", youngs)
    side = inclusion_side(mesh, youngs)
    if side is None:
        return None
    mask = segment(mesh, youngs, side)
    parts = connected_parts(mesh, mask)
    elements = max(parts, key=lambda part: float(mesh.volumes[part].sum()))
    background = float(volume_mean(mesh, youngs, ~mask))
    center = volume_mean(mesh, mesh.centroids, elements)
    return Inclusion.measure(mesh, youngs, elements, side, background, center)
