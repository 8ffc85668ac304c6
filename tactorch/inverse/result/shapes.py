"""The result of a search for shapes: inclusions with intervals, as numbers and as a field."""

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as attribute
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.special import expit

from tactorch.display import Displayed, Summarized
from tactorch.inverse.data.plain import to_plain
from tactorch.inverse.errors import Levels
from tactorch.inverse.fields import InclusionShape, ShapeField, Sites
from tactorch.inverse.fit.monitor import StopReason
from tactorch.inverse.forward.predictions import Predictions
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice

_DRAWS = 1000
_POINTS = 4  # along an edge of an element, for its mean modulus
# Attributes that files hold as they are.
_STORED = (
    "chi2", "log_odds", "log_odds_any", "errors", "unexplained", "history", "predictive",
    "at_medians", "through_gel",
)  # fmt: skip


class Interval(NamedTuple):
    """A central 90 % interval."""

    low: float
    high: float


class BackgroundStep(NamedTuple):
    """A part of the background beyond a plane, with 90 % intervals.

    Attributes:
        side: Axis across the plane, and the side of it on which the part is, such as "z-".
        place_mm: Coordinate of the plane along the axis, mm.
        place_90_mm: Interval of it, mm.
        contrast: Young's modulus of the part over that of the rest of the background.
        contrast_90: Interval of it.
    """

    side: str
    place_mm: float
    place_90_mm: Interval
    contrast: float
    contrast_90: Interval


class InclusionValues(NamedTuple):
    """An inclusion of each of several draws of the parameters of shapes."""

    center_mm: Float[np.ndarray, "draws 3"]  # of volume
    radius_mm: Float[np.ndarray, " draws"]  # of the ball of the same volume
    youngs_mpa: Float[np.ndarray, " draws"]
    background_mpa: Float[np.ndarray, " draws"]  # at the centre
    contrast: Float[np.ndarray, " draws"]  # modulus over that of the background

    @staticmethod
    def of(field: ShapeField, z: Float[np.ndarray, "draws size"], k: int) -> "InclusionValues":
        """Return inclusion k of each draw, in standard deviations of the field's prior."""
        values = field.physical(z)
        own = field.own(values, k)
        background, contrast = field.log_background(values, own.center), own.log_contrast
        logs = (own.log_radius, background + contrast, background, contrast)
        return InclusionValues(field.families[k].centroids(own), *map(np.exp, logs))


@dataclass(frozen=True, repr=False)
class ShapeInclusion(Summarized):
    """An inclusion with its uncertainty.

    Intervals are central 90 % intervals of the posterior. They account for noise, for rigid motions
    of the sensor or the object, and for errors of the forces where the data show them, but not for
    other errors of the model.

    Attributes:
        shape: Shape of the estimate, see `ShapeReconstruction`.
        youngs_mpa: Young's modulus, MPa.
        background_mpa: Young's modulus of the background at the centre, MPa.
        center_deviation_mm: Standard deviation of the centre along x, y and z, mm.
        radius_90_mm: Interval of the radius of the ball of the same volume, mm.
        youngs_90_mpa: Interval of Young's modulus, MPa.
        contrast_90: Interval of Young's modulus over that of the background.
        probability: Probability that the inclusion exists.
        predictive: Log-density of the presses of each contact, as the others predict them, over
            that of the best model without the inclusion; None where it is not known.
    """

    shape: InclusionShape
    youngs_mpa: float
    background_mpa: float
    center_deviation_mm: tuple[float, float, float]
    radius_90_mm: Interval
    youngs_90_mpa: Interval
    contrast_90: Interval
    probability: float
    predictive: float | None = None

    def summary(self) -> str:
        """Return location, size, modulus and probability in a line of text."""
        center = ", ".join(f"{x:.2f}" for x in self.shape.centroid_mm)
        (smallest, largest), (low, high) = self.radius_90_mm, self.youngs_90_mpa
        return (
            f"({center}) mm: radius {self.shape.radius_mm:.3g} mm [{smallest:.3g}, {largest:.3g}], "
            f"{self.youngs_mpa:.3g} MPa [{low:.2g}, {high:.2g}], probability {self.probability:.3g}"
        )


class Alternative(NamedTuple):
    """Other inclusions that explain the presses about as well.

    Attributes:
        probability: Its probability; those of all alternatives and of the result add up to one.
        field: The family of its shapes.
        z: Parameters of its best fit, in standard deviations of the prior.
        posterior: Posterior of its parameters.
    """

    probability: float
    field: ShapeField
    z: Float[np.ndarray, " size"]
    posterior: ShapePosterior

    @property
    def shapes(self) -> list[InclusionShape]:
        """The inclusions."""
        return list(self.field.shapes(self.z))

    @property
    def steps(self) -> list[tuple[str, float, float]]:
        """Side, place (mm) and contrast of each step of the background."""
        background, values = self.field.background, self.field.physical(self.z)
        places = [values[background.step_at(k)].tolist() for k in range(len(background.steps))]
        pairs = zip(background.steps, places, strict=True)
        return [(side, place, float(np.exp(log))) for side, (place, log) in pairs]

    def plain(self) -> dict[str, Any]:
        """Return probability, inclusions and steps as plain values, mm."""
        lumps = [
            {"form": shape.form, "center_mm": shape.centroid_mm.tolist(),
             "size_mm": shape.size_mm.tolist(),
             "equivalent_radius_mm": shape.radius_mm, "contrast": shape.contrast}
            for shape in self.shapes
        ]  # fmt: skip
        steps = [
            {"side": side, "place_mm": place, "contrast": contrast}
            for side, place, contrast in self.steps
        ]
        return {"probability": self.probability, "lumps": lumps, "steps": steps}


@dataclass(frozen=True, eq=False, repr=False)
class ShapeReconstruction(Displayed):
    """Inclusions with sharp boundaries in a background, see `Background`.

    Values and maps are those of `estimate`, which is the centre of the posterior in general. Where
    the posterior is skewed, it differs from the best fit `z`, of which chi2 and predictions are.

    Attributes:
        field: The family of the shapes, with the prior of its parameters.
        z: Parameters of the best fit, in standard deviations of the prior.
        posterior: Posterior of the parameters, where balls may be ellipsoids.
        chi2: Mean squared residual, in standard deviations.
        log_odds: For each inclusion, the log-evidence over that of the model without it.
        log_odds_any: The same for all inclusions together.
        errors: Deviations of the errors by which the data are best explained, each in its unit; see
            `tactorch.inverse.errors`. Others are zero.
        unexplained: Root mean square of what is neither explained nor noise, over that of the
            observed displacements: of the residuals beyond their noise and the recognised errors,
            and of the discrepancy of the model.
        history: The accepted models with their chi2 and log-evidence.
        predictions: Predictions of the presses; None where the result comes from a file.
        held_out: How well a contact is predicted from the others; None where it is not known. See
            `tactorch.inverse.search.held_out`.
        ended: What ended the search early, so that there may be more inclusions: Ctrl-C or the time
            limit; None by default.
        untried: Models that were proposed, and not fitted any more by such a search.
        predictive: See `ShapeInclusion`, of each inclusion.
        at_medians: Whether the estimate is at the medians of the parameters, which explain the
            presses together; else it is the best fit.
        alternatives: Other inclusions that explain the presses about as well, the most probable
            first. Intervals of inclusions include those with as many inclusions; intervals of
            elements and steps are those of the result alone.
        through_gel: Whether the search is through the equilibrium of a sensor's gel and the object.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    posterior: ShapePosterior
    chi2: float
    log_odds: tuple[float, ...]
    log_odds_any: float
    errors: Levels = attribute(default_factory=dict)
    unexplained: float = 0.0
    history: tuple[dict[str, Any], ...] = ()
    predictions: Predictions | None = None
    held_out: float | None = None
    ended: StopReason | None = None
    untried: tuple[str, ...] = ()
    predictive: tuple[float | None, ...] = ()
    at_medians: bool = True
    alternatives: tuple[Alternative, ...] = ()
    through_gel: bool = False

    def summary(self) -> str:
        """Return a description of the result in a few lines of text."""
        count = len(self.field.parts)
        inclusions = f"{count} inclusion{'' if count == 1 else 's'}"
        first = f"{inclusions} in {self.background_mpa:.3g} MPa, chi2 {self.chi2:.3g}"
        return "\n".join([first, *(found.summary() for found in self.inclusions)])

    @property
    def force_deviation(self) -> float:
        """Deviation of the forces of each press, or over the places of a palpation, relative."""
        return max(self.errors.get(name, 0.0) for name in ("forces", "smooth_forces"))

    @property
    def pose_deviation(self) -> float:
        """Deviation of rigid motions at each contact, over the observed displacements."""
        return self.errors.get("pose", 0.0)

    @property
    def rim_deviation(self) -> float:
        """Deviation of the traction at edges of the mesh at rims of contacts, over the mean."""
        return self.errors.get("rims", 0.0)

    @property
    def probability(self) -> float:
        """Probability that there is an inclusion, where all models are as likely beforehand."""
        return float(expit(self.log_odds_any)) if self.log_odds else 0.0

    @property
    def background_mpa(self) -> float:
        """Young's modulus of the background, MPa.

        It is the geometric mean where it is smooth, and that of the part without steps.
        """
        return float(np.exp(self.field.physical(self.estimate)[self.field.background.level]))

    @property
    def background_90_mpa(self) -> Interval:
        """90 % interval of it, MPa."""
        field = self.posterior.field
        return _interval(np.exp(field.physical(self.samples)[:, field.background.level]))

    @cached_property
    def estimate(self) -> Float[np.ndarray, " size"]:
        """Parameters of `field` that are reported, in standard deviations of the prior.

        Each is the median of its samples, and therefore within its interval. Where the posterior is
        that of ellipsoids for a ball, their distortions are left out. Where the medians do not
        belong together, as those of inclusions that overlap, it is the best fit.
        """
        if not self.at_medians:
            return self.z
        posterior, median = self.posterior.field, np.median(self.samples, axis=0)
        return posterior.changed(median, families=self.field.families)[1]

    def youngs_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return Young's modulus at points (mm), MPa."""
        return np.exp(self.field.log_youngs(self.estimate, Sites.at(points)))

    def element_means(self, mesh: TetMesh) -> Float[np.ndarray, " m"]:
        """Return Young's modulus averaged over the volume of each element of a mesh, MPa."""
        return self.field.mean_youngs(self.estimate, _sites(mesh))

    def log_deviation_at(
        self, points: Float[np.ndarray, "n 3"], draws: int = 200
    ) -> Float[np.ndarray, " n"]:
        """Return the standard deviation of the logarithm of Young's modulus at points (mm)."""
        sites = Sites.at(points)
        field = self.posterior.field
        return np.std([field.log_youngs(z, sites) for z in self.samples[:draws]], axis=0)

    def element_intervals(
        self, mesh: TetMesh, level: float, draws: int = 100
    ) -> Float[np.ndarray, "2 m"]:
        """Return the ends of the central interval of the mean modulus of each element, MPa.

        Where it would exclude the estimate, as in elements at a boundary, it extends to that.
        """
        field, sites, best = self.posterior.field, _sites(mesh), self.element_means(mesh)
        means = [field.mean_youngs(z, sites) for z in self.samples[:draws]]
        low, high = np.quantile(means, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
        return np.stack([np.minimum(low, best), np.maximum(high, best)])

    @cached_property
    def samples(self) -> Float[np.ndarray, "draws size"]:
        """Samples of the posterior, in standard deviations of the prior of `posterior.field`."""
        return self.posterior.samples(_DRAWS)

    @cached_property
    def inclusions(self) -> list[ShapeInclusion]:
        """The inclusions with their intervals, those of the largest log-odds first."""
        shapes = list(self.field.shapes(self.estimate))
        return [self._inclusion(k, shapes[k]) for k in self.order]

    @cached_property
    def steps(self) -> list[BackgroundStep]:
        """The steps of the background with their intervals."""
        background, draws = self.field.background, self.posterior.field.physical(self.samples)
        best, found = self.field.physical(self.estimate), []
        for k, side in enumerate(background.steps):
            own = background.step_at(k)
            places, logs = draws[:, own].T
            place, log_contrast = best[own].tolist()
            intervals = _interval(places), _interval(np.exp(logs))
            contrast = float(np.exp(log_contrast))
            found.append(BackgroundStep(side, place, intervals[0], contrast, intervals[1]))
        return found

    @property
    def order(self) -> tuple[int, ...]:
        """Numbers of `inclusions` among those of the field."""
        return tuple(np.argsort(-np.array(self.log_odds), kind="stable").tolist())

    def _draws(self, k: int) -> InclusionValues:
        """Return samples of an inclusion, and of the one in its place in each alternative."""
        own = 1.0 - sum(other.probability for other in self.alternatives)
        parts = [InclusionValues.of(self.posterior.field, self.samples, k)]
        centers = [shape.centroid_mm for shape in self.field.shapes(self.estimate)]
        for other in self.alternatives:
            count = round(len(self.samples) * other.probability / own)
            if len(other.field.parts) == len(centers) and count:
                others = [shape.centroid_mm for shape in other.shapes]
                nearest = linear_sum_assignment(cdist(centers, others))[1]
                z = other.posterior.samples(count)
                parts.append(InclusionValues.of(other.posterior.field, z, int(nearest[k])))
        return InclusionValues(*map(np.concatenate, zip(*parts, strict=True)))

    def _inclusion(self, k: int, shape: InclusionShape) -> ShapeInclusion:
        draws = self._draws(k)
        best = InclusionValues.of(self.field, self.estimate[None], k)
        return ShapeInclusion(
            shape,
            float(best.youngs_mpa[0]),
            float(best.background_mpa[0]),
            tuple(draws.center_mm.std(axis=0).tolist()),
            _interval(draws.radius_mm),
            _interval(draws.youngs_mpa),
            _interval(draws.contrast),
            float(expit(self.log_odds[k])),
            self.predictive[k] if self.predictive else None,
        )

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        values = {name: getattr(self, name) for name in ("z", *_STORED)}
        others = [
            other.field.plain()
            | to_plain({"z": other.z, "probability": other.probability})
            | {"posterior": other.posterior.plain()}
            for other in self.alternatives
        ]
        values |= {"posterior": self.posterior.plain(), "alternatives": others}
        return self.field.plain() | to_plain(values)

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapeReconstruction":
        """Return the result from plain JSON values."""
        field, errors = ShapeField.of(plain), plain.get("errors")
        if errors is None:  # of earlier versions; palpations alone have limits of inclusions
            forces = "forces" if field.prior.outside_mm is None else "smooth_forces"
            names = {forces: "force_deviation", "pose": "pose_deviation", "rims": "rim_deviation"}
            errors = {name: level for name, old in names.items() if (level := plain.get(old))}
        values = {"predictive": ()} | {k: plain[k] for k in _STORED if k in plain and k != "errors"}
        values |= {name: tuple(values[name]) for name in ("log_odds", "history", "predictive")}
        posterior = ShapePosterior.of(plain["posterior"])
        values["alternatives"] = tuple(
            Alternative(
                other["probability"],
                ShapeField.of(other),
                np.array(other["z"]),
                ShapePosterior.of(other["posterior"]),
            )
            for other in plain.get("alternatives", ())
        )
        return ShapeReconstruction(field, np.array(plain["z"]), posterior, errors=errors, **values)


def _sites(mesh: TetMesh) -> Sites:
    """Return the elements of a mesh as volumes with sharp boundaries."""
    points = np.einsum("pc,mcd->mpd", lattice(_POINTS), mesh.points[mesh.tets])
    return Sites(points, np.zeros(mesh.n_tets), (mesh.n_tets, 1))


def _interval(values: Float[np.ndarray, " draws"]) -> Interval:
    return Interval(*np.quantile(values, [0.05, 0.95]).tolist())
