"""Discretisation error of the presses at a model, from meshes that are finer where it needs that.

Strains change within a fraction of the radius of a contact at its rim, have a kink at the boundary
of an inclusion, and are singular where a support ends at an edge. A mesh that is fine at
all would make each fit slow. Instead the differences of the predictions of finer meshes at
one model are added to those of the common mesh, as they change little with the model. The faces of
finer meshes follow the inclusions (deferred correction: V. Pereyra, "On improving an approximate
solution of a functional equation by deferred corrections", Numer. Math. 8 (1966), 376-391).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.fem import NewtonOptions
from tactorch.fem.transfer import Transfer
from tactorch.inverse.data import NoiseModel, group_by_contact
from tactorch.inverse.problem import Evaluation, InverseProblem, make_body
from tactorch.inverse.shapes.field import Ellipsoid, Sites
from tactorch.inverse.shapes.fit import ShapeFit
from tactorch.inverse.shapes.sizing import (
    Rim,
    inclusion_sizing,
    observed_sizing,
    sharp_edge_sizing,
    smallest,
)
from tactorch.linalg import SOLVERS, SolverOptions, map_cases
from tactorch.linalg.solver import AutoSolver
from tactorch.mesh import Refinement, refine
from tactorch.mesh.conform import ClosedSurface, conform
from tactorch.recording import Recording, prolong_recording

_PER_CONTACT = 0.1  # longest edge at the rim of a contact, over the contact's radius
_GROWTH = 0.5  # of the longest edge with the distance from the rim
# Smallest load of a contact over its largest, between which changes are interpolated.
_MIN_FACTOR, _MAX_FACTOR = 0.1, 0.8
# Equilibria far more accurate than the noise of a sensor, by one or two steps from the common mesh.
_NEWTON = NewtonOptions(rtol=1e-4)


class _LoadSeries(NamedTuple):
    """Presses of one contact, which differ by a factor.

    Attributes:
        factors: Displacement of each press over the largest.
        ends: Presses of the smallest and largest displacement, or one press.
    """

    factors: dict[int, float]
    ends: tuple[int, ...]

    @staticmethod
    def of(contact: Sequence[int], predicted: Sequence[Float[np.ndarray, " _"]]) -> "_LoadSeries":
        """Return the presses of a contact, whose factors are projections of predictions."""
        last = predicted[max(contact, key=lambda i: float(predicted[i] @ predicted[i]))]
        factors = {i: float(predicted[i] @ last) / float(last @ last) for i in contact}
        ends = (min(contact, key=factors.__getitem__), max(contact, key=factors.__getitem__))
        distinct = _MIN_FACTOR < factors[ends[0]] < _MAX_FACTOR
        return _LoadSeries(factors, ends if distinct else ends[1:])

    def interpolate(
        self, changes: Mapping[int, Float[np.ndarray, " _"]]
    ) -> dict[int, Float[np.ndarray, " _"]]:
        """Return the changes of all presses from those at the ends, which vanish without a load."""
        *first, last = self.ends
        slope = changes[last]
        for i in first:
            factor = self.factors[i]
            slope = (changes[i] / factor - factor * changes[last]) / (1.0 - factor)
        curvature = changes[last] - slope
        return {i: factor * slope + factor**2 * curvature for i, factor in self.factors.items()}


@dataclass(frozen=True, eq=False)
class Correction:
    """Differences between the common mesh and finer ones.

    Attributes:
        recording: Presses on the common mesh.
        element: Element type.
        solver: Linear solver of the finer meshes.
        noise: Standard deviations for presses that do not state theirs.
        contacts: Presses of each contact, which differ by a factor, and its rim if it has one.
    """

    recording: Recording
    element: str
    solver: str | SolverOptions
    noise: NoiseModel
    contacts: tuple[tuple[tuple[int, ...], Rim | None], ...]

    @staticmethod
    def of(problem: InverseProblem, element: str, solver: str | SolverOptions) -> "Correction":
        """Return the correction for the contacts of a problem with this element and solver.

        The solver "auto" is multigrid, for few solves on each of several meshes.
        """
        if isinstance(SOLVERS.build(solver), AutoSolver):
            solver = "p_multigrid"
        recording = problem.recording
        pairs = []
        for numbers in group_by_contact(recording.presses, problem.data.observations):
            loaded = (recording.presses[numbers[0]].forces != 0).any(axis=1)
            pairs.append((numbers, Rim.of(recording.mesh, loaded)))
        return Correction(recording, element, solver, problem.noise, tuple(pairs))

    @property
    def has_rims(self) -> bool:
        """Whether some contact ends within a face."""
        return any(rim is not None for _, rim in self.contacts)

    def offsets(
        self, fit: ShapeFit, evaluation: Evaluation, check: Callable[[], None] = lambda: None
    ) -> list[Float[np.ndarray, " p"]]:
        """Return the predictions of the finer meshes less those of the common one, each press (mm).

        Those of the smallest and largest load of each contact are computed, and interpolated for
        the others. Contacts without a rim share a mesh.

        Args:
            fit: Model.
            evaluation: Its predictions on the common mesh.
            check: Called before each mesh and each equilibrium; what it raises ends the correction.

        Raises:
            ConvergenceError: a press has no equilibrium on its finer mesh.
            ConfigError: a finer mesh has too many elements.
        """
        index = [observation.index for observation in evaluation.data.observations]
        before = [u.ravel()[i] for u, i in zip(evaluation.reported, index, strict=True)]
        offsets = [np.zeros_like(values) for values in before]
        for contacts, refinement in self._refinements(list(fit.field.shapes(fit.z))):
            check()
            every = [_LoadSeries.of(contact, before) for contact in contacts]
            predicted = self._predict(fit, evaluation, refinement, every, check)
            changes = {i: u.ravel()[index[i]] - before[i] for i, u in predicted.items()}
            for series in every:
                for i, change in series.interpolate(changes).items():
                    offsets[i] = change
        return offsets

    def _refinements(
        self, shapes: Sequence[Ellipsoid]
    ) -> list[tuple[list[tuple[int, ...]], Refinement]]:
        """Return finer meshes, and the contacts of each: one, or all those without a rim."""
        mesh, presses = self.recording.mesh, self.recording.presses
        observed = np.logical_or.reduce([press.observed.any(axis=1) for press in presses])
        near = observed_sizing(mesh.points[observed], shapes)
        sizing = smallest(inclusion_sizing(shapes), near)
        whole = [numbers for numbers, rim in self.contacts if rim is None]
        pairs = [(whole, refine(mesh, smallest(sizing, sharp_edge_sizing(mesh))))] if whole else []
        for numbers, rim in self.contacts:
            if rim is not None:
                fine = smallest(sizing, rim.sizing(_PER_CONTACT, _GROWTH))
                pairs.append(([numbers], refine(mesh, fine)))
        return [(contacts, refinement) for contacts, refinement in pairs if len(refinement.ends)]

    def _predict(
        self,
        fit: ShapeFit,
        evaluation: Evaluation,
        refinement: Refinement,
        every: Sequence[_LoadSeries],
        check: Callable[[], None],
    ) -> dict[int, Float[np.ndarray, "nodes 3"]]:
        """Return the reported displacements of the presses at the ends of each series."""
        shapes = list(fit.field.shapes(fit.z))
        surfaces = [ClosedSurface(s.distance, 4.0 / 3.0 * np.pi * s.radius_mm**3) for s in shapes]
        fitted = conform(refinement, surfaces)
        fine = replace(prolong_recording(self.recording, fitted.refinement), mesh=fitted.mesh)
        body = make_body(fine, self.element, self.solver, _NEWTON)
        sites = Sites.of(body.assembly)
        fractions = [
            np.where(side == 0, sites.fraction_inside(shape), side < 0)
            for shape, side in zip(shapes, fitted.sides, strict=True)
        ]
        youngs = np.exp(fit.field.log_youngs_of(fit.z, sites, fractions)).reshape(sites.shape)
        common = evaluation.search(0).assembly.discretisation
        transfer = Transfer.between(common, body.discretisation.positions)

        def solve(k: int) -> dict[int, np.ndarray]:
            found: dict[int, np.ndarray] = {}
            near, change = None, np.zeros((body.n_nodes, 3))
            for i in every[k].ends:
                check()
                one = replace(fine, presses=(fine.presses[i],))
                problem = InverseProblem(one, body=body, noise=self.noise)
                start = transfer(evaluation.displacements[i])
                near = problem.evaluate(
                    youngs, near, take_over=True, starts=[start + every[k].factors[i] * change]
                )
                change = (near.displacements[0] - start) / every[k].factors[i]
                found[i] = near.reported[0]
            return found

        return {i: u for found in map_cases(solve, len(every)) for i, u in found.items()}
