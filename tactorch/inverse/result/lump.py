"""Lumps: inclusions as they are reported, with depth, intervals and probability."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from tactorch.display import Summarized
from tactorch.errors import ConfigError
from tactorch.inverse.data.plain import to_plain
from tactorch.inverse.fields import InclusionShape
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import Mask
from tactorch.recording import Press

_MIN_AXIS_COSINE = 0.95  # between push and axis, for a press on a named side
_MIN_NET_FORCE = 0.1  # net force over the sum of nodal forces; below, a press grips
_MIN_RATIO = 2.0  # of the longest semi-axis to the next one, for a long lump
TAIL = 0.05  # probability outside a 90 % interval, on either side
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of a region along the push of a press.

    Attributes:
        center_mm: Depth of the region's centre, mm.
        cover_mm: Depth of its nearest element's centroid, mm.
        inward: Unit vector of the push, (3,).
        above_mm: Point of the contact above the centre, (3,), mm.
    """

    center_mm: float
    cover_mm: float
    inward: Float[np.ndarray, "3"]
    above_mm: Float[np.ndarray, "3"]

    @property
    def face(self) -> str:
        """Pressed side, such as "z+"; empty if the push is along no axis."""
        axis = int(np.abs(self.inward).argmax())
        if abs(self.inward[axis]) < _MIN_AXIS_COSINE:
            return ""
        return f"{'xyz'[axis]}{'+' if self.inward[axis] < 0 else '-'}"

    @property
    def surface(self) -> str:
        """Pressed surface in words."""
        return f"the pressed side {self.face}" if self.face else "the pressed surface"


@dataclass(frozen=True, eq=False)
class Confidence:
    """Probability and intervals of a lump.

    They account for the stated noise, the prior and the recognised errors of the measurement, but
    not for other errors of the model.

    Attributes:
        probability: Probability that the inclusion exists; in an element map, that the lump is
            stiffer (or softer) than its surroundings. There the lump was selected as the most
            conspicuous one, so that the probability is optimistic.
        contrast: 90 % interval of the contrast.
        center_deviation_mm: Standard deviation of the centre along x, y and z, (3,), mm.
        radius_mm: 90 % interval of the radius of the ball of its volume, mm; None in an element
            map, where the size has no posterior.
        youngs_mpa: 90 % interval of Young's modulus, MPa; None in an element map.
    """

    probability: float
    contrast: tuple[float, float]
    center_deviation_mm: Float[np.ndarray, "3"]
    radius_mm: tuple[float, float] | None = None
    youngs_mpa: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Elongation:
    """Length and widths of a lump that is much longer than wide.

    Attributes:
        length_mm: Length, mm.
        widths_mm: Smallest and largest width across it, mm.
        direction: Unit vector along it, (3,), whose largest component is positive.
    """

    length_mm: float
    widths_mm: tuple[float, float]
    direction: Float[np.ndarray, "3"]

    @staticmethod
    def of(shape: InclusionShape) -> "Elongation | None":
        """Return the elongation of a shape; None if it is not twice as long as wide."""
        longest, second, third = shape.semi_axes_mm
        if longest < _MIN_RATIO * second:
            return None
        direction = np.array(shape.axes[0])
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        return Elongation(2.0 * longest, (2.0 * third, 2.0 * second), direction)

    def text(self) -> str:
        """Return length, direction and widths in words."""
        along = ", ".join(f"{x + 0.0:.2f}" for x in np.round(self.direction, 2))
        widths = " x ".join(f"{width:.2g}" for width in self.widths_mm)
        return f"{self.length_mm:.2g} mm long along ({along}) and {widths} mm across"


@dataclass(frozen=True, eq=False, repr=False)
class Lump(Summarized):
    """A lump with its depth and confidence.

    Attributes:
        inclusion: Location, size, moduli and elements.
        size_mm: Size along x, y and z, (3,), mm.
        depth: Depth below the presses; None if no press pushes.
        confidence: Confidence by the posterior; None without a posterior.
        elongation: Length, widths and direction of a long lump; None for others and in an element
            map.
        form: Noun for its form, such as "ring"; "lump" for balls, ellipsoids and element maps.
    """

    inclusion: Inclusion
    size_mm: Float[np.ndarray, "3"]
    depth: Depth | None
    confidence: Confidence | None
    elongation: Elongation | None = None
    form: str = "lump"

    def summary(self) -> str:
        """Return location, size and moduli, with depth and probability, in a line of text."""
        depth = "" if self.depth is None else f", {self.depth.center_mm:.3g} mm deep"
        known = self.confidence
        likely = "" if known is None else f", probability {known.probability:.3g}"
        return f"{self.inclusion.summary()}{depth}{likely}"

    def stored(self) -> dict[str, Any]:
        """Return all as plain JSON values; the inverse of `of_stored`."""
        plain = to_plain(self)
        plain["inclusion"]["elements"] = np.flatnonzero(self.inclusion.elements).tolist()
        return plain

    @staticmethod
    def of_stored(values: Mapping[str, Any], n_elements: int) -> "Lump":
        """Return a lump from plain JSON values, in a mesh of so many elements."""
        inclusion = dict(values["inclusion"])
        elements = np.zeros(n_elements, dtype=bool)
        elements[inclusion.pop("elements")] = True
        center = np.array(inclusion.pop("center_mm"))
        return Lump(
            Inclusion(center_mm=center, elements=elements, **inclusion),
            np.array(values["size_mm"]),
            _of_plain(Depth, values["depth"], ("inward", "above_mm")),
            _of_plain(Confidence, values["confidence"], ("center_deviation_mm",)),
            _of_plain(Elongation, values["elongation"], ("direction",)),
            values.get("form", "lump"),
        )

    def plain(self) -> dict[str, Any]:
        """Return plain values for users: mm, MPa, mm^3."""
        inclusion, depth, confidence = self.inclusion, self.depth, self.confidence
        sizes = {"contrast": float(inclusion.contrast), "size_mm": self.size_mm.tolist()}
        values = inclusion.plain() | sizes | {"form": self.form}
        if depth is not None:
            values |= {
                "depth_mm": depth.center_mm,
                "cover_mm": depth.cover_mm,
                "under": depth.face or depth.above_mm.tolist(),
            }
        if (depths := self.depth_90_mm) is not None:
            values["depth_90_mm"] = list(depths)
        if self.elongation is not None:
            values |= to_plain(self.elongation)
        if confidence is not None:
            values |= {
                "probability": confidence.probability,
                "contrast_90": list(confidence.contrast),
                "center_deviation_mm": confidence.center_deviation_mm.tolist(),
            }
            if confidence.radius_mm is not None and confidence.youngs_mpa is not None:
                values |= {
                    "equivalent_radius_90_mm": list(confidence.radius_mm),
                    "mean_90_mpa": list(confidence.youngs_mpa),
                }
        return values

    @property
    def depth_90_mm(self) -> tuple[float, float] | None:
        """90 % interval of the centre's depth along the push, mm; None if one is not known."""
        if self.depth is None or self.confidence is None:
            return None
        deviation = float(np.linalg.norm(self.confidence.center_deviation_mm * self.depth.inward))
        half = float(ndtri(1.0 - TAIL)) * deviation
        return max(self.depth.center_mm - half, 0.0), self.depth.center_mm + half


def _of_plain(kind: type[_T], values: Mapping[str, Any] | None, arrays: Sequence[str]) -> _T | None:
    if values is None:
        return None
    pairs = {name: np.array(part) if name in arrays else part for name, part in values.items()}
    intervals = {name: tuple(part) for name, part in pairs.items() if isinstance(part, list)}
    return kind(**pairs | intervals)


def measure_depth(
    mesh: TetMesh, presses: Sequence[Press], center_mm: Float[np.ndarray, "3"], elements: Mask
) -> Depth | None:
    """Return the depth of a region below the press that is nearest to it; None if no press pushes.

    The surface of a press is that of the nodes it loads; above the region it is taken at the node
    nearest to the line through the centre along the push. Where only probes push, it is at the one
    whose axis is nearest to the centre.
    """
    if not elements.any():
        raise ConfigError("the region has no element; give one with at least one.")
    depths = []
    for press in presses:
        total = press.forces.sum(axis=0)
        length = float(np.linalg.norm(total))
        if not length > _MIN_NET_FORCE * np.linalg.norm(press.forces, axis=1).sum():
            continue  # forces cancel: gripping is no push
        inward, loaded = total / length, mesh.points[np.any(press.forces != 0, axis=1)]
        above = loaded[np.argmin(_distances(center_mm - loaded, inward))]
        depths.append(_depth(mesh, center_mm, elements, above, inward))
    poses = [press.probe for press in presses if press.probe is not None]
    if poses and not any(depths):
        inward = np.array([-pose.rotation[:, 2] for pose in poses])
        positions = np.array([pose.position_mm for pose in poses])
        nearest = int(np.argmin(_distances(center_mm - positions, inward)))
        closest = closest_points(mesh.points, mesh.surface.triangles, positions[nearest][None])
        depths = [_depth(mesh, center_mm, elements, closest.points[0], inward[nearest])]
    return min(filter(None, depths), key=lambda depth: depth.center_mm, default=None)


def _distances(
    apart: Float[np.ndarray, "n 3"], axes: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the lengths of vectors across axes."""
    across = apart - (apart * axes).sum(axis=1, keepdims=True) * axes
    return np.linalg.norm(across, axis=1)


def _depth(
    mesh: TetMesh,
    center_mm: Float[np.ndarray, "3"],
    elements: Mask,
    above: Float[np.ndarray, "3"],
    inward: Float[np.ndarray, "3"],
) -> Depth | None:
    """Return the depth of a region below a point of the surface; None if it is not below."""
    center = float((center_mm - above) @ inward)
    cover = float(((mesh.centroids[elements] - above) @ inward).min())
    return Depth(center, cover, inward, center_mm - center * inward) if center > 0 else None
