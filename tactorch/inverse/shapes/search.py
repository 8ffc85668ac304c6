"""The search for inclusions: starts by matched filters, and the number of them by evidence.

Where the residuals of the best model so far correlate best with the change that a small ball would
cause, a further ball is started. The sensitivities of linear elements at the uniform map are
accurate enough for this. A ball is accepted if it raises the evidence.
"""

import logging
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError
from tactorch.inverse.invert import corrected_problem
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.field import ShapeField, ShapePrior, Sites
from tactorch.inverse.shapes.fit import ShapeFit, fit_shapes
from tactorch.inverse.starts import uniform_fit
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_CENTRES = 400  # candidates of the matched filter, on an even grid in the bounding box
_RADII = (0.1, 0.2)  # of the candidates, over the size of the body
_STARTS = 3  # fits of each further inclusion
_TRIAL_STEPS = 5  # of Gauss-Newton with linear elements
_MAX_SHAPES = 4
_MIN_GAIN = 3.0  # of the log-evidence, for an accepted inclusion or distortion
_START_CONTRAST = (0.3, 1.5)  # range of the log-contrast of a start


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
    uniform: Float[np.ndarray, " data"]

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
        points = Sites.of(problem.body.assembly).points
        centers, radii, responses = [], [], []
        for radius in _RADII:
            within = [
                (np.linalg.norm(points - c, axis=2) < radius * size).mean(axis=1) for c in grid
            ]
            fractions = np.stack(within, axis=1)
            inside = fractions.T @ mesh.volumes > 0.5 * 4.0 / 3.0 * np.pi * (radius * size) ** 3
            centers.append(grid[inside])
            radii.append(np.full(int(inside.sum()), radius * size))
            responses.append(jacobian @ fractions[:, inside])
        return MatchedFilter(
            np.concatenate(centers),
            np.concatenate(radii),
            np.hstack(responses),
            jacobian.sum(axis=1),
        )

    def best(self, residuals: Float[np.ndarray, " data"], count: int) -> list[Candidate]:
        """Return distinct balls that reduce the misfit of these residuals most."""
        unit = self.uniform / np.linalg.norm(self.uniform)
        responses = self.responses - np.outer(unit, unit @ self.responses)
        squares = np.einsum("db,db->b", responses, responses) + 1e-12
        contrasts = -(residuals - unit * (unit @ residuals)) @ responses / squares
        gains = 0.5 * contrasts**2 * squares
        candidates: list[Candidate] = []
        for ball in np.argsort(-gains):
            distances = [np.linalg.norm(c.center_mm - self.centers[ball]) for c in candidates]
            if all(d > self.radii[ball] for d in distances):
                candidates.append(
                    Candidate(
                        self.centers[ball],
                        float(self.radii[ball]),
                        float(contrasts[ball]),
                        float(gains[ball]),
                    )
                )
            if len(candidates) == count:
                break
        return candidates


@dataclass(frozen=True, eq=False)
class ShapeSearch:
    """The models that were compared, and the chosen one.

    Attributes:
        fits: Best fit with no inclusion, with one, with two and so on.
    """

    fits: tuple[ShapeFit, ...]

    @property
    def inflation(self) -> float:
        """Variance of the residuals of the best fit over the stated one, at least one.

        Evidence is computed with the larger variance.
        """
        return max(1.0, min(fit.chi2 for fit in self.fits))

    @property
    def log_evidences(self) -> list[float]:
        """Log-evidence of each number of inclusions, relative to the best."""
        values = np.array([fit.log_evidence(self.inflation) for fit in self.fits])
        return (values - values.max()).tolist()

    @property
    def best(self) -> ShapeFit:
        """The fit of the largest evidence."""
        return self.fits[int(np.argmax(self.log_evidences))]

    @property
    def probability(self) -> float:
        """Probability that there is an inclusion, where each number of them is as likely."""
        weights = np.exp(self.log_evidences)
        return float(weights[1:].sum() / weights.sum())


@dataclass(frozen=True, eq=False)
class _Problems:
    """The presses with quadratic elements, and with linear ones for starts."""

    quadratic: InverseProblem
    linear: InverseProblem
    sites: Sites
    linear_sites: Sites
    matched: MatchedFilter

    def fit(self, field: ShapeField, start: np.ndarray) -> ShapeFit:
        return fit_shapes(self.quadratic, field, start, sites=self.sites)


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
    settings = settings or Settings()
    linear = corrected_problem(recording, replace(settings, element="tet4"))
    quadratic = InverseProblem(
        recording,
        element="tet10",
        solver=settings.solver,
        noise=settings.noise,
        newton=settings.newton,
    )
    uniform = uniform_fit(linear, settings.bounds).youngs_mpa
    problems = _Problems(
        quadratic,
        linear,
        Sites.of(quadratic.body.assembly),
        Sites.of(linear.body.assembly),
        MatchedFilter.of(linear, uniform),
    )
    empty = ShapeField(ShapePrior.of(recording.mesh, uniform), ())
    fits = [problems.fit(empty, np.zeros(1))]
    _log.info("No inclusion: chi2 %.4g", fits[0].chi2)
    while len(fits) <= max_shapes:
        fit = _further(problems, fits[-1])
        if fit is None:
            break
        fits.append(fit)
        before, after = ShapeSearch(tuple(fits)).log_evidences[-2:]
        _log.info("%d inclusions: chi2 %.4g, gain %.4g", len(fits) - 1, fit.chi2, after - before)
        if after - before < _MIN_GAIN:
            break
    search = ShapeSearch(tuple(fits))
    count = len(search.best.shapes)
    for inclusion in range(count):
        fits[count] = _distort(problems, fits[count], inclusion)
    return ShapeSearch(tuple(fits))


def _further(problems: _Problems, fit: ShapeFit) -> ShapeFit | None:
    """Fit one more ball; None where no start has an equilibrium.

    The best of several starts is chosen by a few steps with linear elements.
    """
    field = replace(fit.field, distorted=(*fit.field.distorted, False))
    trials: list[tuple[float, np.ndarray]] = []
    for candidate in problems.matched.best(fit.residuals, _STARTS):
        size = np.clip(abs(candidate.log_contrast), *_START_CONTRAST)
        contrast = np.copysign(size, candidate.log_contrast)
        ball = [*candidate.center_mm, np.log(candidate.radius_mm), contrast]
        start = field.standard(np.concatenate([fit.field.physical(fit.z), ball]))
        with suppress(ConvergenceError):
            trial = fit_shapes(
                problems.linear,
                field,
                start,
                sites=problems.linear_sites,
                max_iterations=_TRIAL_STEPS,
            )
            trials.append((trial.log_evidence(), trial.z))
    for _, start in sorted(trials, key=lambda trial: -trial[0]):
        with suppress(ConvergenceError):
            return problems.fit(field, start)
    return None


def _distort(problems: _Problems, fit: ShapeFit, inclusion: int) -> ShapeFit:
    """Return the fit with one ball as an ellipsoid, if the evidence is for it."""
    distorted = tuple(d or i == inclusion for i, d in enumerate(fit.field.distorted))
    field = replace(fit.field, distorted=distorted)
    values, end = fit.field.physical(fit.z), fit.field.parts[inclusion].stop
    start = field.standard(np.concatenate([values[:end], np.zeros(5), values[end:]]))
    trial = problems.fit(field, start)
    inflation = max(1.0, min(fit.chi2, trial.chi2))
    gain = trial.log_evidence(inflation) - fit.log_evidence(inflation)
    _log.info("Inclusion %d as an ellipsoid: chi2 %.4g, gain %.4g", inclusion, trial.chi2, gain)
    return trial if gain > _MIN_GAIN else fit
