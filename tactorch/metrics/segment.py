"""Segmentation of a map, and its inclusion, by a threshold that is robust to outlier elements.

In the logarithm of the moduli, two levels minimise the absolute deviation: background and
inclusion, each a volume-weighted median. The threshold is half way between them, iterated to
convergence (T. W. Ridler and S. Calvard, "Picture thresholding using an iterative selection
method", IEEE Trans. Syst. Man Cybern. 8 (1978), 630-632). Elements at a bound therefore do not move
it. Scores (`tactorch.metrics.scores`) and lumps (`tactorch.inverse.find_lumps`) use it.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.display import Summarized
from tactorch.errors import MeshError
from tactorch.mesh import TetMesh

Side = Literal["stiff", "soft"]
Field = Float[np.ndarray, " m"]  # a value per element
Mask = Bool[np.ndarray, " m"]

# Smallest relative distance of the extreme from the background in a field with an inclusion.
MIN_CONTRAST = 0.02
_MAX_VOLUME_FRACTION = 0.5  # a larger region is background
_MAX_ITERATIONS, _CANDIDATE_LEVELS = 50, 100


@dataclass(frozen=True, eq=False, repr=False)
class Inclusion(Summarized):
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
    elements: Mask
    side: Side

    def summary(self) -> str:
        """Return location, size and moduli in a line of text."""
        center = ", ".join(f"{x:.2f}" for x in self.center_mm)
        return (
            f"{self.side}, at ({center}) mm, radius {self.equivalent_radius_mm:.3g} mm: "
            f"{self.mean_mpa:.3g} in {self.background_mpa:.3g} MPa"
        )

    @staticmethod
    def measure(
        mesh: TetMesh,
        youngs: Field,
        elements: Mask,
        side: Side,
        background_mpa: float,
        center_mm: Float[np.ndarray, "3"],
    ) -> "Inclusion":
        """Return the inclusion of these elements, with its volume and mean modulus."""
        volume = float(mesh.volumes[elements].sum())
        radius = float(np.cbrt(3 * volume / (4 * np.pi)))
        mean = float(volume_mean(mesh, youngs, elements))
        return Inclusion(center_mm, volume, radius, mean, background_mpa, elements, side)

    @property
    def contrast(self) -> float:
        """Modulus of the inclusion over that of the background."""
        return self.mean_mpa / self.background_mpa

    def plain(self) -> dict[str, Any]:
        """Return all but the elements as plain values, mm and MPa."""
        names = ("volume_mm3", "equivalent_radius_mm", "mean_mpa", "background_mpa")
        numbers = {name: float(getattr(self, name)) for name in names}
        return {"side": self.side, "center_mm": [float(x) for x in self.center_mm], **numbers}


def find_inclusion(mesh: TetMesh, youngs: Field) -> Inclusion | None:
    """Find the largest face-connected region of the segmented map (`tactorch.metrics.segment`).

    `tactorch.inverse.find_lump`, which the commands use, takes the most conspicuous region.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.

    Returns:
        The inclusion; None if the map stays within 2 % of its background.
    """
    check_field("youngs", youngs, mesh)
    side = inclusion_side(mesh, youngs)
    if side is None:
        return None
    mask = segment(mesh, youngs, side)
    parts = connected_parts(mesh, mask)
    elements = max(parts, key=lambda part: float(mesh.volumes[part].sum()))
    background = float(volume_mean(mesh, youngs, ~mask))
    center = volume_mean(mesh, mesh.centroids, elements)
    return Inclusion.measure(mesh, youngs, elements, side, background, center)


def inclusion_side(mesh: TetMesh, values: Field) -> Side | None:
    """Return whether the field's inclusion is stiff or soft; None if it has none.

    The side is that of the extreme with the larger ratio to the background.
    """
    background, means = weighted_median(values, mesh.volumes), neighbourhood_mean(mesh, values)
    stiffer, softer = float(means.max()) / background, background / float(means.min())
    if max(stiffer, softer) <= 1 + MIN_CONTRAST:
        return None
    return "stiff" if stiffer >= softer else "soft"


def segment(mesh: TetMesh, youngs: Field, side: Side) -> Mask:
    """Return the elements that are stiffer or softer than the background.

    An inclusion fills less than half of the body. The mask is empty if nothing stands out.
    """
    sign = 1.0 if side == "stiff" else -1.0
    values, volumes = sign * np.log(youngs), mesh.volumes
    background = weighted_median(values, volumes)
    highest = float(neighbourhood_mean(mesh, values).max())
    mask = np.zeros(len(values), dtype=bool)
    if highest - background < np.log1p(MIN_CONTRAST):
        return mask
    level = _level(values, volumes, background)
    for _ in range(_MAX_ITERATIONS):
        moved = values > (background + level) / 2
        too_large = volumes[moved].sum() > _MAX_VOLUME_FRACTION * volumes.sum()
        if not moved.any() or too_large or (moved == mask).all():
            break
        mask = moved
        level = weighted_median(values[mask], volumes[mask])
        background = weighted_median(values[~mask], volumes[~mask])
    return mask


def _level(values: Field, volumes: Field, background: float) -> float:
    """Return the second level that minimises the absolute deviation, given the background."""
    fractions = (np.arange(_CANDIDATE_LEVELS) + 0.5) / _CANDIDATE_LEVELS
    best_gain, best_level = -np.inf, float(values.max())
    for cut in background + (values.max() - background) * fractions:
        above = values > cut
        if volumes[above].sum() > _MAX_VOLUME_FRACTION * volumes.sum():
            continue
        level = weighted_median(values[above], volumes[above])
        reduction = values[above] - background - np.abs(values[above] - level)
        gain = float(volumes[above] @ reduction)
        if gain > best_gain:
            best_gain, best_level = gain, level
    return best_level


def volume_mean(
    mesh: TetMesh, values: Float[np.ndarray, " m ..."], mask: Mask
) -> Float[np.ndarray, "..."]:
    """Average `values` over the volume of the elements in `mask`."""
    return np.asarray(np.average(values[mask], axis=0, weights=mesh.volumes[mask]))


def weighted_median(values: Field, weights: Field) -> float:
    """Return the value below which half of the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    # The slack absorbs round-off where exactly half of the weight is reached.
    return float(values[order[np.searchsorted(total, total[-1] * 0.5 * (1 - 1e-12))]])


def neighbourhood_mean(mesh: TetMesh, values: Field) -> Field:
    """Average over the volume of each element and those that share a face with it."""
    first, second = mesh.adjacency.pairs.T
    volumes, moments = mesh.volumes, mesh.volumes * values
    elements = np.concatenate([np.arange(mesh.n_tets), first, second])
    neighbours = np.concatenate([np.arange(mesh.n_tets), second, first])
    return np.bincount(elements, moments[neighbours]) / np.bincount(elements, volumes[neighbours])


def connected_parts(mesh: TetMesh, mask: Mask) -> list[Mask]:
    """Return the masks of the face-connected parts of `mask`."""
    pairs = mesh.adjacency.pairs
    inner = pairs[mask[pairs].all(axis=1)]
    graph = coo_array((np.ones(len(inner)), (inner[:, 0], inner[:, 1])), shape=(mesh.n_tets,) * 2)
    _, labels = connected_components(graph, directed=False)
    return [mask & (labels == label) for label in np.unique(labels[mask])]


def check_field(name: str, values: Field, mesh: TetMesh | None = None) -> None:
    """Raise MeshError unless `values` are finite, above zero, and one for each element."""
    if values.ndim != 1 or not len(values):
        raise MeshError(f"{name} has shape {values.shape}; give one modulus per element")
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if len(bad):
        raise MeshError(
            f"{name} is {values[bad[0]]} at element {bad[0]} ({len(bad)} such elements); "
            "give finite moduli above 0 MPa"
        )
    if mesh is not None and len(values) != mesh.n_tets:
        raise MeshError(
            f"{name} has {len(values)} values but the mesh {mesh.n_tets} elements; "
            "use the mesh that the field belongs to"
        )
