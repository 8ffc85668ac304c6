"""Finding the inclusion in a map, without knowing the truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.mesh import TetMesh
from tactorch.metrics.checks import check_on_mesh
from tactorch.metrics.segment import Side, segment, standing_out, volume_mean


@dataclass(frozen=True, eq=False)
class Inclusion:
    """A connected region that is stiffer or softer than what surrounds it.

    Attributes:
        center_mm: Centroid of its volume, (3,), mm.
        volume_mm3: Volume, mm^3.
        equivalent_radius_mm: Radius of the sphere of that volume, mm.
        mean_mpa: Mean modulus over its volume, MPa.
        background_mpa: Mean modulus over the volume of all that does not stand out, MPa.
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
    """Find the largest region that stands out of a map; None where nothing does.

    Elements past half way from the background to the extreme are taken, stiff or soft
    (`tactorch.metrics.segment` has the rule); of these the face-connected region of largest
    volume. Maps that stay within 2 % of their background have none.
    `tactorch.findings.find_lump`, which the commands use, is more robust to outliers.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.

    Raises:
        MeshError: The field is not over the elements of the mesh.
    """
    check_on_mesh(mesh, "youngs", youngs)
    side = standing_out(mesh, youngs)
    if side is None:
        return None
    outstanding = segment(mesh, youngs, side)
    elements = _largest_region(mesh, outstanding)
    volume = float(mesh.volumes[elements].sum())
    return Inclusion(
        center_mm=volume_mean(mesh, mesh.centroids, elements),
        volume_mm3=volume,
        equivalent_radius_mm=float(np.cbrt(3 * volume / (4 * np.pi))),
        mean_mpa=float(volume_mean(mesh, youngs, elements)),
        background_mpa=float(volume_mean(mesh, youngs, ~outstanding)),
        elements=elements,
        side=side,
    )


def _largest_region(mesh: TetMesh, mask: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Return the face-connected part of `mask` with the largest volume."""
    pairs = mesh.adjacency.pairs
    kept = pairs[mask[pairs].all(axis=1)]
    graph = coo_array((np.ones(len(kept)), (kept[:, 0], kept[:, 1])), shape=(mesh.n_tets,) * 2)
    _, labels = connected_components(graph, directed=False)
    volumes = np.bincount(labels, weights=np.where(mask, mesh.volumes, 0.0))
    return mask & (labels == np.argmax(volumes))
