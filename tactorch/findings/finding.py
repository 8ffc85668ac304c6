"""Lumps of a map with their depth below the presses and their confidence."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from tactorch.display import Displayed
from tactorch.errors import ConfigError
from tactorch.findings.elongation import Elongation
from tactorch.findings.lumps import Mask, adjacent_elements, find_lumps
from tactorch.inverse import ShapeReconstruction
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import Side, volume_mean
from tactorch.recording import Press, Recording
from tactorch.uncertainty import GaussianPosterior

_MIN_AXIS_COSINE = 0.95  # between push and axis, for a press on a named side
_MIN_NET_FORCE = 0.1  # net force over the sum of nodal forces; below, a press grips
_UNCERTAIN = 0.1  # width of the interval of a depth, over the depth, from which it is reported
_TAIL = 0.05  # probability outside a 90 % interval, on either side
# Probabilities above which a lump is certain, and below which it is doubtful.
_CERTAIN, _DOUBTFUL = 0.99, 0.9


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

    They account for the stated noise and the prior, but not for model errors. The lump was
    selected as the most conspicuous one, so its probability is optimistic. The logarithm of the
    contrast is taken as normally distributed about that of the map, `Inclusion.contrast`.

    Attributes:
        probability: Probability that the lump is stiffer (or softer) than its surroundings; of a
            shape, that it exists.
        contrast: 90 % interval of the contrast.
        center_deviation_mm: Standard deviation of the centre along x, y and z, (3,), mm.
        radius_mm: 90 % interval of the radius of the ball of its volume, mm; None for regions of a
            map, whose size has no posterior.
        youngs_mpa: 90 % interval of Young's modulus, MPa; None for regions of a map.
    """

    probability: float
    contrast: tuple[float, float]
    center_deviation_mm: Float[np.ndarray, "3"]
    radius_mm: tuple[float, float] | None = None
    youngs_mpa: tuple[float, float] | None = None

    @property
    def percent(self) -> str:
        """The probability in words."""
        if self.probability > 0.999:
            return "more than 99.9 %"
        return f"{100 * self.probability:.3g} %"

    def at_least(self, side: Side) -> float:
        """Return the 95 % lower bound of the factor by which the lump is stiffer (or softer).

        It is below 1 where the probability is below 95 %. An upper bound is not given: total
        variation shrinks contrasts, so that the true one is often larger.
        """
        return self.contrast[0] if side == "stiff" else 1.0 / self.contrast[1]

    def bound_text(self, side: Side) -> str:
        """Return the bound of `at_least` in words."""
        ratio = self.at_least(side)
        if ratio <= 1:
            return f"it may not be {side}er at all (95 %)"
        return f"it is at least {ratio:.2g} times as {side} (95 %)"


@dataclass(frozen=True, eq=False)
class Lump:
    """A lump with its depth and confidence.

    Attributes:
        inclusion: Location, size, moduli and elements.
        size_mm: Size along x, y and z, (3,), mm.
        depth: Depth below the presses; None if no press pushes.
        confidence: Confidence by the posterior; None without a posterior.
        elongation: Length, widths and direction of a long lump; None for others and for regions of
            a map.
    """

    inclusion: Inclusion
    size_mm: Float[np.ndarray, "3"]
    depth: Depth | None
    confidence: Confidence | None
    elongation: Elongation | None = None

    def plain(self) -> dict[str, Any]:
        """Return plain values: mm, MPa, mm^3."""
        inclusion, depth, confidence = self.inclusion, self.depth, self.confidence
        values = inclusion.plain()
        values |= {"contrast": float(inclusion.contrast), "size_mm": self.size_mm.tolist()}
        if depth is not None:
            values |= {
                "depth_mm": depth.center_mm,
                "cover_mm": depth.cover_mm,
                "under": depth.face or depth.above_mm.tolist(),
            }
        if (depths := self.depth_90_mm) is not None:
            values["depth_90_mm"] = list(depths)
        if self.elongation is not None:
            values |= self.elongation.plain()
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
        half = float(ndtri(1.0 - _TAIL)) * deviation
        return max(self.depth.center_mm - half, 0.0), self.depth.center_mm + half

    def text(self) -> str:
        """Return location, depth, size, contrast and confidence in up to three sentences."""
        inclusion, side, depth = self.inclusion, self.inclusion.side, self.depth
        ratio = inclusion.contrast if side == "stiff" else 1.0 / inclusion.contrast
        point = ", ".join(f"{x:.2f}" for x in inclusion.center_mm)
        below = "" if depth is None else f", {depth.center_mm:.2f} mm below {depth.surface}"
        size, kind = f"{' x '.join(f'{x:.2g}' for x in self.size_mm)} mm", f"A {side} lump"
        if self.elongation is not None:
            size, kind = self.elongation.text(), f"A long {side} lump"
        text = (
            f"{kind} at ({point}) mm{below}, {size} "
            f"(the volume of a ball of radius {inclusion.equivalent_radius_mm:.2g} mm), "
            f"{ratio:.2g} times as {side} as its surroundings ({inclusion.mean_mpa:.3g} in "
            f"{inclusion.background_mpa:.3g} MPa)."
        )
        if self.confidence is None:
            return text
        probability, percent = self.confidence.probability, self.confidence.percent
        deviation = float(np.linalg.norm(self.confidence.center_deviation_mm))
        bounds = self.confidence.bound_text(side)
        if self.confidence.radius_mm is not None and self.confidence.youngs_mpa is not None:
            radius, youngs = self.confidence.radius_mm, self.confidence.youngs_mpa
            bounds = (
                f"90 % intervals are {radius[0]:.3g} to {radius[1]:.3g} mm for that radius and "
                f"{youngs[0]:.2g} to {youngs[1]:.2g} MPa for its modulus"
            )
            depths = self.depth_90_mm
            if depth and depths and depths[1] - depths[0] > _UNCERTAIN * depth.center_mm:
                bounds += f", {depths[0]:.2g} to {depths[1]:.2g} mm for its depth"
        text += (
            f" Given noise and prior, its probability is {percent}, {bounds}, and the standard "
            f"deviation of its centre is {deviation:.2g} mm."
        )
        if probability < _DOUBTFUL:
            return f"{text} Do not rely on it without more presses."
        return text if probability >= _CERTAIN else f"{text} More presses can confirm it."


class Status(StrEnum):
    """Outcome of a search for lumps."""

    FOUND = "found"
    NOTHING = "nothing found"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True, eq=False, repr=False)
class Finding(Displayed):
    """The outcome of a search for lumps.

    Attributes:
        mesh: The object.
        lumps: Lumps, the most conspicuous first; none if the status is not `FOUND`.
        background_mpa: Young's modulus of the background, MPa.
        reasons: Reasons for which the presses cannot tell, as sentences; usually none.
        probability: Probability that there is any lump; None where it was not computed.
        notes: Sentences on errors of the recording that the presses show, and on what could not be
            computed.
        shapes: Shapes that the lumps describe; None if they are regions of a map.
    """

    mesh: TetMesh
    lumps: tuple[Lump, ...]
    background_mpa: float
    reasons: tuple[str, ...] = ()
    probability: float | None = None
    notes: tuple[str, ...] = ()
    shapes: ShapeReconstruction | None = None

    @property
    def status(self) -> Status:
        """Whether lumps were found, nothing was found, or the presses cannot tell."""
        if self.reasons:
            return Status.UNKNOWN
        return Status.FOUND if self.lumps else Status.NOTHING

    def plain(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "status": str(self.status),
            "reasons": list(self.reasons),
            "notes": list(self.notes),
            "probability": self.probability,
            "background_mpa": self.background_mpa,
            "lumps": [lump.plain() for lump in self.lumps],
        }

    def summary(self) -> str:
        """Return the finding as text; see `text`."""
        return self.text()

    def text(self) -> str:
        """Return the finding as text, one line per lump or reason, and per note."""
        return "\n".join([self._result(), *self.notes])

    def _result(self) -> str:
        if self.status is Status.UNKNOWN:
            return "\n".join(f"Cannot tell whether there is a lump: {r}" for r in self.reasons)
        if self.status is Status.NOTHING:
            return (
                "Nothing found: no lump stands out; Young's modulus is "
                f"{self.background_mpa:.3g} MPa."
            )
        return "\n".join(lump.text() for lump in self.lumps)


def build_finding(
    recording: Recording,
    youngs: Float[np.ndarray, " m"],
    posterior: GaussianPosterior | None = None,
    *,
    max_lumps: int = 5,
    reasons: Sequence[str] = (),
) -> Finding:
    """Return the lumps of a map with their depth and confidence, and the background.

    Args:
        recording: Presses; the truth is not read.
        youngs: Map, (m,), MPa.
        posterior: Posterior of the same map; without it the lumps have no confidence.
        max_lumps: Largest number of lumps.
        reasons: Reasons not to trust the map, such as `Reconstruction.warnings`.
    """
    mesh = recording.mesh
    if reasons:
        return Finding(mesh, (), float(np.median(youngs)), tuple(reasons))
    lumps = (
        build_lump(mesh, recording.presses, inclusion, posterior)
        for inclusion in find_lumps(mesh, youngs, max_lumps=max_lumps)
    )
    return Finding(mesh, tuple(lumps), float(np.median(youngs)))


def build_lump(
    mesh: TetMesh, presses: Sequence[Press], lump: Inclusion, posterior: GaussianPosterior | None
) -> Lump:
    """Measure size, depth and confidence of an inclusion."""
    # The size is that of the ellipsoid with the second moments of the elements. Their bounding box
    # would be too large: it holds corners far from the lump.
    offsets = mesh.centroids - lump.center_mm
    within = np.ptp(mesh.points[mesh.tets], axis=1) ** 2 / 20.0  # approximate moment of an element
    size = 2.0 * np.sqrt(5.0 * volume_mean(mesh, offsets**2 + within, lump.elements))
    depth = measure_depth(mesh, presses, lump.center_mm, lump.elements)
    confidence = None if posterior is None else compute_confidence(mesh, lump, posterior)
    return Lump(lump, size, depth, confidence)


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
        across = loaded - center_mm
        across = across - (across @ inward)[:, None] * inward
        above = loaded[np.argmin(np.linalg.norm(across, axis=1))]
        center = float((center_mm - above) @ inward)
        cover = float(((mesh.centroids[elements] - above) @ inward).min())
        if center > 0:
            depths.append(Depth(center, cover, inward, center_mm - center * inward))
    if not depths:
        return _depth_below_probe(mesh, presses, center_mm, elements)
    return min(depths, key=lambda depth: depth.center_mm)


def _depth_below_probe(
    mesh: TetMesh, presses: Sequence[Press], center_mm: Float[np.ndarray, "3"], elements: Mask
) -> Depth | None:
    poses = [press.probe for press in presses if press.probe is not None]
    if not poses:
        return None
    inward = np.array([-pose.rotation[:, 2] for pose in poses])
    positions = np.array([pose.position_mm for pose in poses])
    apart = center_mm - positions
    across = apart - (apart * inward).sum(axis=1, keepdims=True) * inward
    nearest = int(np.argmin(np.linalg.norm(across, axis=1)))
    closest = closest_points(mesh.points, mesh.surface.triangles, positions[nearest][None])
    above, push = closest.points[0], inward[nearest]
    center = float((center_mm - above) @ push)
    cover = float(((mesh.centroids[elements] - above) @ push).min())
    return Depth(center, cover, push, center_mm - center * push) if center > 0 else None


def compute_confidence(
    mesh: TetMesh, lump: Inclusion, posterior: GaussianPosterior, *, draws: int = 400, seed: int = 0
) -> Confidence:
    """Estimate the confidence of a lump of the posterior's map from samples of the posterior."""
    rng = np.random.default_rng(seed)
    x = np.clip(posterior.sample(rng, draws), *posterior.parameterization.limits)
    log_youngs = np.log(np.array([posterior.parameterization.youngs(row) for row in x]))
    near, sign = adjacent_elements(mesh, lump.elements), 1.0 if lump.side == "stiff" else -1.0
    background = volume_mean(mesh, log_youngs.T, ~near)
    # The contrast is that of the map; the samples' geometric means give its relative uncertainty.
    contrast = np.log(lump.contrast)
    deviation = (volume_mean(mesh, log_youngs.T, lump.elements) - background).std()
    low, high = np.exp(contrast + deviation * ndtri([_TAIL, 1.0 - _TAIL]))
    probability = ndtr(sign * contrast / deviation) if deviation > 0 else 1.0
    # Centres are weighted by the excess over the background.
    excess = np.maximum(sign * (log_youngs - background[:, None]), 0.0) * (mesh.volumes * near)
    centers = excess @ mesh.centroids / np.maximum(excess.sum(axis=1, keepdims=True), 1e-300)
    return Confidence(float(probability), (float(low), float(high)), centers.std(axis=0))
