"""The search for inclusions: proposals by linear elements, decisions by quadratic ones.

A model is a background, uniform or smooth, with a number of balls and ellipsoids. From a model
others follow: with a further ball where a matched filter sees one in the residuals, with a smooth
background, or with a ball as an ellipsoid. Each is fitted with linear elements, whose data are
shifted so that they agree with quadratic elements at the present model. The best is then fitted
with quadratic elements, and accepted if it raises the evidence.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.fem import NewtonOptions
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, ShapesOnSites, fit_shapes
from tactorch.inverse.starts import uniform_fit
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_CENTRES = 400  # candidates of the matched filter, on an even grid in the bounding box
_RADII = (0.1, 0.2)  # of the candidates, over the size of the body
_STARTS = 3  # fits of each further inclusion
_TRIAL_STEPS = 8  # of Gauss-Newton with linear elements
_MAX_SHAPES = 4
_MAX_MODELS = 10  # that are fitted with quadratic elements
_MIN_GAIN = 3.0  # of the log-evidence, for a model that is accepted
# Smallest linearised reduction of the misfit that is worth a fit: the best of a few hundred balls
# reduces that of pure noise by six or so.
_MIN_CANDIDATE_GAIN = 8.0
_MAX_START_CONTRAST = 1.0  # log-contrast of a start with quadratic elements
_START_CONTRAST = (0.3, 1.5)  # range of the log-contrast of a start
_DERIVATIVE_RTOL = 1e-3  # of the solves for derivatives
_TOLERANCE, _UNIFORM_TOLERANCE = 1e-4, 1e-2  # of the objective
_SAME = 2.0  # distance of centres, in radii, below which two starts are of the same ball
_RTOL = 1e-7  # of equilibria: far below the noise of a sensor


class Candidate(NamedTuple):
    """A ball that would reduce the misfit."""

    center_mm: Float[np.ndarray, "3"]
    radius_mm: float
    log_contrast: float
    gain: float  # reduction of half the sum of squared residuals, linearised


@dataclass(frozen=True, eq=False)
class MatchedFilter:
    """Change of the residuals by small balls at the uniform map, for linear elements."""

    centers: Float[np.ndarray, "balls 3"]
    radii: Float[np.ndarray, " balls"]
    responses: Float[np.ndarray, "data balls"]

    @staticmethod
    def of(problem: InverseProblem, youngs_mpa: float) -> "MatchedFilter":
        """Compute the responses to balls of unit log-contrast on a grid in the body."""
        mesh = problem.recording.mesh
        size = float(np.cbrt(mesh.volumes.sum()))
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        spacing = float(np.cbrt(np.prod(high - low) / _CENTRES))
        counts = np.maximum(np.rint((high - low) / spacing), 1).astype(int)
        axes = [
            a + (np.arange(n) + 0.5) / n * (b - a)
            for a, b, n in zip(low, high, counts, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        jacobian = problem.evaluate(np.full(mesh.n_tets, youngs_mpa)).jacobian() * youngs_mpa
        width = np.cbrt(mesh.volumes)[:, None]
        distance = np.linalg.norm(mesh.centroids[:, None] - grid, axis=2)
        centers, radii, responses = [], [], []
        for radius in size * np.array(_RADII):
            fractions = np.clip(0.5 + (radius - distance) / width, 0.0, 1.0)
            inside = fractions.T @ mesh.volumes > 0.5 * 4.0 / 3.0 * np.pi * radius**3
            centers.append(grid[inside])
            radii.append(np.full(int(inside.sum()), radius))
            responses.append(jacobian @ fractions[:, inside])
        return MatchedFilter(np.concatenate(centers), np.concatenate(radii), np.hstack(responses))

    def best(
        self,
        residuals: Float[np.ndarray, " data"],
        explained: Float[np.ndarray, "data k"],
        count: int,
    ) -> list[Candidate]:
        """Return distinct balls that reduce the misfit of these residuals most.

        Changes of the residuals along the columns of `explained` are those of known parameters.
        """
        basis, _ = np.linalg.qr(explained)
        responses = self.responses - basis @ (basis.T @ self.responses)
        residuals = residuals - basis @ (basis.T @ residuals)
        squares = np.einsum("db,db->b", responses, responses) + 1e-12
        contrasts = -residuals @ responses / squares
        gains = 0.5 * contrasts**2 * squares
        candidates: list[Candidate] = []
        for ball in np.argsort(-gains):
            center, radius = self.centers[ball], float(self.radii[ball])
            if all(np.linalg.norm(c.center_mm - center) > radius for c in candidates):
                candidates.append(
                    Candidate(center, radius, float(contrasts[ball]), float(gains[ball]))
                )
            if len(candidates) == count:
                break
        return candidates


@dataclass(frozen=True, eq=False)
class ShapeSearch:
    """The models that were compared, and the chosen one.

    Attributes:
        fits: Accepted fits, each of higher evidence than the one before; the first is the uniform
            body.
        log_evidence_empty: Largest log-evidence of a body without inclusion, relative to that of
            the best fit.
    """

    fits: tuple[ShapeFit, ...]
    log_evidence_empty: float

    @property
    def best(self) -> ShapeFit:
        """The fit of the largest evidence."""
        return self.fits[-1]

    @property
    def inflation(self) -> float:
        """Variance of the residuals of the best fit over the stated one, at least one.

        Evidence is computed with the larger variance.
        """
        return max(1.0, self.best.chi2)

    @property
    def probability(self) -> float:
        """Probability that there is an inclusion, where each model is as likely beforehand."""
        if not self.best.shapes:
            return 0.0
        return float(1.0 / (1.0 + np.exp(min(self.log_evidence_empty, 700.0))))


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A model fitted with linear elements."""

    what: str
    field: ShapeField
    z: Float[np.ndarray, " size"]
    gain: float  # of the log-evidence, over the present model


@dataclass(frozen=True, eq=False)
class _Model:
    """A model fitted with quadratic elements."""

    fit: ShapeFit
    evaluation: Evaluation


class _Search:
    """The presses with quadratic elements and with linear ones."""

    def __init__(self, recording: Recording, settings: Settings) -> None:
        newton = NewtonOptions(rtol=max(settings.newton.rtol, _RTOL))
        options = {"solver": settings.solver, "noise": settings.noise, "newton": newton}
        self.quadratic = InverseProblem(
            recording, element="tet10", derivative_rtol=_DERIVATIVE_RTOL, **options
        )
        self.sites = Sites.of(self.quadratic.body.assembly)
        linear = InverseProblem(recording, element="tet4", **options)
        self.linear, self.linear_sites = linear, Sites.of(linear.body.assembly)
        youngs = uniform_fit(linear, settings.bounds).youngs_mpa
        self.matched = MatchedFilter.of(linear, youngs)
        self.prior = ShapePrior.of(recording.mesh, youngs)

    def uniform(self) -> _Model:
        """Fit the uniform body with quadratic elements."""
        youngs = np.full(self.linear.n_elements, np.exp(self.prior.log_background))
        extend = self.quadratic.body.discretisation.extend
        starts = [extend(u) for u in self.linear.evaluate(youngs).displacements]
        return self.fit(ShapeField(self.prior), np.zeros(1), starts, tolerance=_UNIFORM_TOLERANCE)

    def fit(
        self,
        field: ShapeField,
        z: Float[np.ndarray, " size"],
        starts: Sequence[Float[np.ndarray, "nodes 3"]],
        tolerance: float = _TOLERANCE,
    ) -> _Model:
        """Fit with quadratic elements, from these displacements."""
        fit = fit_shapes(
            self.quadratic, field, z, sites=self.sites, starts=starts, tolerance=tolerance
        )
        return _Model(*fit)

    def propose(self, model: _Model, max_shapes: int) -> list[_Proposal]:
        """Return models that may be better than the present one, the best first."""
        fit = model.fit
        linear = self._shifted(model)
        jacobian, inflation = fit.jacobian, max(1.0, fit.chi2)
        starts: list[tuple[str, ShapeField, np.ndarray]] = []
        if len(fit.field.distorted) < max_shapes:
            starts += self._further(fit, jacobian)
        if not fit.field.smooth:
            starts.append(("smooth background", *_smoothed(fit)))
        for k, distorted in enumerate(fit.field.distorted):
            if not distorted:
                starts.append((f"inclusion {k} as an ellipsoid", *_distorted(fit, k)))
        proposals = []
        for what, field, start in starts:
            # A start inside a ball that was fitted already would lead to it again.
            if any(_is_inside(start, p) for p in proposals if p.field.distorted == field.distorted):
                continue
            with suppress(ConvergenceError):
                trial, _ = fit_shapes(
                    linear, field, start, sites=self.linear_sites, max_iterations=_TRIAL_STEPS
                )
                z = _moderate(field, trial.z) if len(field.distorted) > len(fit.field.distorted) else trial.z
                gain = trial.log_evidence(inflation) - fit.log_evidence(inflation)
                _log.info("  proposal: %s, chi2 %.4g, gain %.4g", what, trial.chi2, gain)
                proposals.append(_Proposal(what, field, z, gain))
        return sorted(proposals, key=attrgetter("gain"), reverse=True)

    def _shifted(self, model: _Model) -> InverseProblem:
        """Return the linear problem with the residuals of the quadratic one at a model."""
        data = self.quadratic.data
        field = ShapesOnSites(model.fit.field, self.linear_sites).at(model.fit.z)
        coarse = self.linear.evaluate(field.youngs)
        pairs = zip(coarse.reported, model.evaluation.reported, data.observations, strict=True)
        return self.linear.with_data(data.shifted([(u - v).ravel()[o.index] for u, v, o in pairs]))

    def _further(
        self, fit: ShapeFit, jacobian: np.ndarray
    ) -> Iterator[tuple[str, ShapeField, np.ndarray]]:
        field = replace(fit.field, distorted=(*fit.field.distorted, False))
        for candidate in self.matched.best(fit.residuals, jacobian, _STARTS):
            if candidate.gain < _MIN_CANDIDATE_GAIN:
                return
            size = np.clip(abs(candidate.log_contrast), *_START_CONTRAST)
            contrast = np.copysign(size, candidate.log_contrast)
            ball = [*candidate.center_mm, np.log(candidate.radius_mm), contrast]
            start = field.standard(np.concatenate([fit.field.physical(fit.z), ball]))
            yield f"ball at {np.round(candidate.center_mm, 1).tolist()} mm", field, start


def find_shapes(
    recording: Recording, settings: Settings | None = None, *, max_shapes: int = _MAX_SHAPES
) -> ShapeSearch:
    """Find the inclusions that the presses determine, with the number that the evidence supports.

    The truth and the reference that a recording may carry are never read.

    Args:
        recording: Presses on an object.
        settings: Noise, solver, bounds and equilibrium search are used; elements are quadratic.
        max_shapes: Largest number of inclusions.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: with no uniform modulus do all presses have an equilibrium.
    """
    search = _Search(recording, settings or Settings())
    model = search.uniform()
    fits, tried = [model.fit], 1
    empty = [model.fit]
    _log.info("uniform: chi2 %.4g", model.fit.chi2)
    while True:
        accepted = False
        proposals = [p for p in search.propose(model, max_shapes) if p.gain > _MIN_GAIN]
        for proposal in proposals:
            if tried == _MAX_MODELS:
                break
            tried += 1
            try:
                trial = search.fit(proposal.field, proposal.z, model.evaluation.displacements)
            except ConvergenceError:
                continue
            if not trial.fit.field.distorted:
                empty.append(trial.fit)
            inflation = max(1.0, min(model.fit.chi2, trial.fit.chi2))
            gain = trial.fit.log_evidence(inflation) - model.fit.log_evidence(inflation)
            _log.info("%s: chi2 %.4g, gain %.4g", proposal.what, trial.fit.chi2, gain)
            if gain > _MIN_GAIN:
                model, accepted = trial, True
                fits.append(trial.fit)
                break
        if not accepted:
            break
    inflation = max(1.0, model.fit.chi2)
    best_empty = max(fit.log_evidence(inflation) for fit in empty)
    return ShapeSearch(tuple(fits), best_empty - model.fit.log_evidence(inflation))


def _smoothed(fit: ShapeFit) -> tuple[ShapeField, np.ndarray]:
    """Return the model with a smooth background, and a start."""
    field = replace(fit.field, smooth=True)
    modes = field.n_background - fit.field.n_background
    values = fit.field.physical(fit.z)
    return field, field.standard(np.concatenate([values[:1], np.zeros(modes), values[1:]]))


def _distorted(fit: ShapeFit, inclusion: int) -> tuple[ShapeField, np.ndarray]:
    """Return the model with a ball as an ellipsoid, and a start."""
    distorted = tuple(d or i == inclusion for i, d in enumerate(fit.field.distorted))
    field = replace(fit.field, distorted=distorted)
    values, end = fit.field.physical(fit.z), fit.field.parts[inclusion].stop
    return field, field.standard(np.concatenate([values[:end], np.zeros(5), values[end:]]))


def _is_inside(start: Float[np.ndarray, " size"], proposal: _Proposal) -> bool:
    """Whether the last ball of a start has its centre within that of a proposal, or near it."""
    field = proposal.field
    if len(start) != field.size:
        return False
    first, end = field.parts[-1].start, field.parts[-1].start + 3
    centers = (field.physical(z)[first:end] for z in (start, proposal.z))
    radius = np.exp(field.physical(proposal.z)[end])
    return bool(np.linalg.norm(np.subtract(*centers)) < _SAME * radius)


def _moderate(field: ShapeField, z: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
    """Return the model with the last ball of moderate contrast and of the same far field.

    A ball in a uniform strain acts from afar by its volume times (c - 1) / (c + 3/2), with c its
    contrast (Eshelby, 1957, for nearly incompressible bodies). Where the contrast is large the
    data hardly depend on it, and the steps of a fit become small.
    """
    values = field.physical(z)
    radius, contrast = field.parts[-1].start + 3, field.parts[-1].start + 4
    log = np.clip(values[contrast], -_MAX_START_CONTRAST, _MAX_START_CONTRAST)
    old, new = ((np.exp(x) - 1.0) / (np.exp(x) + 1.5) for x in (values[contrast], log))
    if old != new:
        values[radius] += np.log(old / new) / 3.0
        values[contrast] = log
    return field.standard(values)
