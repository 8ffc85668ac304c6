"""Discretisation error of the presses at a model, from meshes that are finer where it needs that.

The predictions of the common mesh are corrected by their differences from those of finer meshes at
one model, which change little with the model (deferred correction: V. Pereyra, "On improving an
approximate solution of a functional equation by deferred corrections", Numer. Math. 8 (1966),
376-391). Errors at the rim of a contact, where strains change within a fraction of its radius,
depend on the moduli there only, and are kept while those remain. Those at inclusions, at whose
boundary strains have a kink, are those of one mesh for all contacts, whose faces follow them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.fem import NewtonOptions
from tactorch.fem.transfer import Transfer
from tactorch.inverse.data.observations import group_by_contact
from tactorch.inverse.errors.base import KeptRims, RimError, press_key
from tactorch.inverse.fields import InclusionShape, Sites
from tactorch.inverse.fit.shapes import ShapeFit
from tactorch.inverse.forward.footprint import loaded_nodes
from tactorch.inverse.forward.problem import Evaluation, InverseProblem, Moduli, make_body
from tactorch.inverse.search.sizing import (
    Rim,
    inclusion_sizing,
    loaded_end,
    observed_sizing,
    sharp_edge_sizing,
    smallest,
)
from tactorch.linalg import SOLVERS, limit_workers, map_cases
from tactorch.linalg.parallel import worker_count
from tactorch.linalg.solver import AutoSolver
from tactorch.mesh import refine
from tactorch.mesh.conform import ClosedSurface, conform
from tactorch.mesh.refine import Sizing
from tactorch.mesh.sharp_edges import distance_from_sharp_edges
from tactorch.recording import Recording, prolong_recording

_AT_RIM = 0.1  # longest edge at the rim of a contact, over the contact's radius
_UNDER_CONTACT = 0.12  # longest edge at the loaded surface, over the contact's radius
_GROWTH = 1.0  # of the longest edge with the distance from the rim
# Smallest load of a contact over its largest, between which changes are interpolated.
_MIN_FACTOR, _MAX_FACTOR = 0.1, 0.8
_NEAR_EDGE = 0.6  # edge that an inclusion needs at a contact near it, over that of the mesh
# Largest change of log-moduli at a contact that the error at its rim outlasts: it then changes by a
# tenth, less than what is allowed for (`_REMAINING` in `tactorch.inverse.errors.discretisation`).
_SAME_MODULI = 0.1
# The unbalanced forces of the common mesh's displacements are as large as the loads: changes are
# accurate to one per cent.
_NEWTON = NewtonOptions(rtol=5e-3)
_AT_EDGE_MM = 1e-6  # distance of nodes from an edge that they are on

_Data = Float[np.ndarray, " _"]  # of a press, mm


class _FinerMesh(NamedTuple):
    """A mesh that is fine at the inclusions."""

    contacts: list[int]  # whose presses are solved on it
    sizing: Sizing
    has_rims: bool  # whether it is also fine at the rims of these contacts


class _LoadSeries(NamedTuple):
    """Presses of one contact, which differ by a factor."""

    factors: dict[int, float]  # displacement of each press over the largest
    ends: tuple[int, ...]  # presses of the smallest and largest displacement, or one press

    @staticmethod
    def of(contact: Sequence[int], predicted: Sequence[_Data]) -> "_LoadSeries":
        """Return the presses of a contact, whose factors are projections of predictions."""
        last = predicted[max(contact, key=lambda i: float(predicted[i] @ predicted[i]))]
        factors = {i: float(predicted[i] @ last) / float(last @ last) for i in contact}
        ends = (min(contact, key=factors.__getitem__), max(contact, key=factors.__getitem__))
        distinct = _MIN_FACTOR < factors[ends[0]] < _MAX_FACTOR
        return _LoadSeries(factors, ends if distinct else ends[1:])

    def interpolate(self, changes: Mapping[int, _Data]) -> dict[int, _Data]:
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
        problem: Presses on the common mesh.
        contacts: Presses of each contact, which differ by a factor, and its rim if it has one.
        kept: Errors at rims, maybe of an earlier search on fewer presses.
    """

    problem: InverseProblem
    contacts: tuple[tuple[tuple[int, ...], Rim | None], ...]
    kept: KeptRims

    @staticmethod
    def of(problem: InverseProblem, kept: KeptRims | None = None) -> "Correction":
        """Return the correction for the contacts of a problem."""
        recording = problem.recording
        groups = group_by_contact(recording.presses)
        rims = (Rim.of(recording.presses[numbers[0]], recording.mesh) for numbers in groups)
        return Correction(problem, tuple(zip(groups, rims, strict=True)), kept or KeptRims())

    @property
    def recording(self) -> Recording:
        """The presses on the common mesh."""
        return self.problem.recording

    @cached_property
    def uncertain(self) -> tuple[tuple[tuple[int, ...], Int[np.ndarray, " nodes"]], ...]:
        """Presses of each contact whose traction is uncertain where it ends, and the nodes there.

        Where a contact ends within a face, nodal forces do not determine the traction at its rim.
        The traction of a sensor, whose gel does not slip, is singular at edges of the body too.
        """
        found = []
        for numbers, rim in self.contacts:
            press = self.recording.presses[numbers[0]]
            if press.errors is not None:
                loaded = (press.forces != 0.0).any(axis=1)
                found.append((numbers, loaded_end(self.recording.mesh, loaded)))
            elif rim is not None and not rim.of_probe:
                found.append((numbers, rim.nodes))
        return tuple((numbers, nodes) for numbers, nodes in found if len(nodes))

    @property
    def has_singular_ends(self) -> bool:
        """Whether the contact of a sensor ends at an edge of the body."""
        mesh, distance = self.recording.mesh, distance_from_sharp_edges(self.recording.mesh)
        presses = self.recording.presses
        ends = [nodes for n, nodes in self.uncertain if presses[n[0]].errors is not None]
        return any((distance(mesh.points[nodes]) <= _AT_EDGE_MM).any() for nodes in ends)

    def offsets(
        self, fit: ShapeFit, evaluation: Evaluation, check: Callable[[], None] = lambda: None
    ) -> list[Float[np.ndarray, " p"]]:
        """Return the predictions of the finer meshes less those of the common one, each press (mm).

        Those of the smallest and largest load of each contact are computed, and interpolated for
        the others. The evaluation is that of the fit on the common mesh. `check` is called before
        each mesh and each equilibrium; what it raises ends the correction.

        Raises:
            ConvergenceError: a press has no equilibrium on its finer mesh.
            ConfigError: a finer mesh has too many elements.
        """
        model = _Model(fit, evaluation, evaluation.predicted, check)
        every = [_LoadSeries.of(numbers, model.predicted) for numbers, _ in self.contacts]
        meshes, rims = self._plan(model.shapes)
        jobs = [partial(self._rim_error, model, k, every[k]) for k in rims]
        for mesh in meshes:
            chosen = [every[k] for k in mesh.contacts]
            jobs.append(partial(self._inclusion_error, model, mesh, chosen))
        offsets = [np.zeros_like(values) for values in model.predicted]
        for changes in map_cases(lambda k: jobs[k](), len(jobs)):
            for series in every:
                if changes.keys() >= set(series.ends):
                    for i, change in series.interpolate(changes).items():
                        offsets[i] += change
        return offsets

    def _plan(self, shapes: Sequence[InclusionShape]) -> tuple[list[_FinerMesh], list[int]]:
        """Return the meshes that are fine at the inclusions, and the contacts with rim errors.

        A contact near an inclusion, which needs smaller elements there, has a mesh that is also
        fine at its rim. Contacts with a rim are not observed where supported faces end.
        """
        mesh, presses = self.recording.mesh, self.recording.presses
        observed = np.logical_or.reduce(
            [press.observed.any(axis=1) | loaded_nodes(press, mesh) for press in presses]
        )
        at_inclusions = inclusion_sizing(shapes)
        between = observed_sizing(mesh.points[observed], shapes)
        at_whole = smallest(at_inclusions, between, sharp_edge_sizing(mesh))
        whole, far, plan = list[int](), list[int](), list[_FinerMesh]()
        for k, (_, rim) in enumerate(self.contacts):
            if rim is None:
                whole.append(k)
            elif between is not None and self._is_near(k, between):
                at_rim = rim.sizing(_AT_RIM, _GROWTH, _UNDER_CONTACT)
                plan.append(_FinerMesh([k], smallest(at_inclusions, between, at_rim), True))
            else:
                far.append(k)
        plan = [_FinerMesh(whole, at_whole, False), *plan, _FinerMesh(far, at_inclusions, False)]
        return [finer for finer in plan if finer.contacts], far

    def _is_near(self, k: int, between: Sizing) -> bool:
        """Whether an inclusion needs edges at contact k much shorter than those of the mesh."""
        loaded = self._loaded(k)
        mesh = self.recording.mesh
        ends = mesh.points[mesh.edges[loaded[mesh.edges].all(axis=1)]]
        if not len(ends):
            return False
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        return bool((between(ends.mean(axis=1)) / lengths).min() < _NEAR_EDGE)

    def _loaded(self, k: int) -> Bool[np.ndarray, " n"]:
        """Nodes that contact k loads."""
        return loaded_nodes(self.recording.presses[self.contacts[k][0][0]], self.recording.mesh)

    def _inclusion_error(
        self, model: "_Model", finer: _FinerMesh, every: Sequence[_LoadSeries]
    ) -> dict[int, _Data]:
        """Return the changes of the data by a mesh whose faces follow the inclusions, mm."""
        refinement = refine(self.recording.mesh, finer.sizing)
        if not len(refinement.ends):
            return {}
        volumes = [4.0 / 3.0 * np.pi * shape.radius_mm**3 for shape in model.shapes]
        pairs = zip(model.shapes, volumes, strict=True)
        conforming = conform(refinement, [ClosedSurface(s.distance, v) for s, v in pairs])
        # Where rims have separate errors, these include that of the traction.
        fine = prolong_recording(
            self.recording, conforming.refinement, smooth_tractions=finer.has_rims
        )
        fine = replace(fine, mesh=conforming.mesh)
        youngs = partial(model.youngs_beside, conforming.sides)
        return self._changes(model, fine, youngs, every)

    def _rim_error(self, model: "_Model", k: int, series: _LoadSeries) -> dict[int, _Data]:
        """Return the error at the rim of contact k, mm; a former one where the moduli remain."""
        presses, mesh = self.recording.presses, self.recording.mesh
        rim = self.contacts[k][1]
        assert rim is not None
        key = press_key(self.recording, [presses[i] for i in series.ends])
        log_youngs = model.log_youngs(Sites.at(mesh.points[self._loaded(k)]))
        kept = self.kept.errors.get(key)
        if kept is None or np.abs(kept.log_youngs - log_youngs).max() > _SAME_MODULI:
            model.check()
            refinement = refine(mesh, rim.sizing(_AT_RIM, _GROWTH, _UNDER_CONTACT))
            changes = {i: np.zeros_like(model.predicted[i]) for i in series.ends}
            if len(refinement.ends):
                fine = prolong_recording(self.recording, refinement, smooth_tractions=True)
                changes = self._changes(model, fine, model.youngs, [series])
            kept = RimError(log_youngs, tuple(changes[i] for i in series.ends))
            self.kept.errors[key] = kept
        return dict(zip(series.ends, kept.changes, strict=True))

    def _changes(
        self,
        model: "_Model",
        fine: Recording,
        youngs_of: Callable[[Sites], Moduli],
        every: Sequence[_LoadSeries],
    ) -> dict[int, _Data]:
        """Return the changes of the data of the presses at the ends of each series, mm.

        `fine` are the presses on a finer mesh, and `youngs_of` the moduli (MPa) at its quadrature
        points.
        """
        common = self.problem.body
        element = "tet10" if common.discretisation.element.quadratic else "tet4"
        automatic = isinstance(SOLVERS.build(common.solver), AutoSolver)
        # There are few solves on each of several meshes.
        body = make_body(fine, element, "p_multigrid" if automatic else common.solver, _NEWTON)
        youngs = youngs_of(Sites.of(body.assembly))
        contact_mpa = self.problem.contact_mpa if fine.has_probes else None
        displacements = model.evaluation.displacements
        transfer = Transfer.between(common.discretisation, body.discretisation.positions)

        def solve(series: _LoadSeries) -> dict[int, np.ndarray]:
            """Solve one load after the other; a tangent serves all presses of the same supports."""
            found: dict[int, np.ndarray] = {}
            change = np.zeros((body.n_nodes, 3))
            for i in series.ends:
                model.check()
                one = replace(fine, presses=(fine.presses[i],))
                problem = InverseProblem(
                    one, body=body, noise=self.problem.noise, contact_mpa=contact_mpa,
                    derivative_rtol=_NEWTON.rtol,
                )  # fmt: skip
                start = transfer(displacements[i])
                first = start + series.factors[i] * change
                solved = problem.evaluate(youngs, starts=[first])
                change = (solved.displacements[0] - start) / series.factors[i]
                found[i] = solved.predicted[0] - model.predicted[i]
            return found

        # With little more than one contact a core, one thread more keeps all cores busy to the end.
        cores = worker_count()
        with limit_workers(cores + (cores < len(every) < 2 * cores)):
            parts = map_cases(lambda k: solve(every[k]), len(every))
        return {i: values for found in parts for i, values in found.items()}


@dataclass(frozen=True, eq=False)
class _Model:
    """A model and its predictions on the common mesh."""

    fit: ShapeFit
    evaluation: Evaluation
    predicted: list[_Data]  # of each press
    check: Callable[[], None]  # see `Correction.offsets`

    @cached_property
    def shapes(self) -> list[InclusionShape]:
        """The inclusions."""
        return list(self.fit.field.shapes(self.fit.z))

    def log_youngs(
        self, sites: Sites, fractions: Sequence[Float[np.ndarray, " m"]] = ()
    ) -> Float[np.ndarray, " volumes"]:
        """Return the logarithms of the moduli (MPa), see `ShapeField.log_youngs`."""
        return self.fit.field.log_youngs(self.fit.z, sites, fractions)

    def youngs(self, sites: Sites) -> Moduli:
        """Return the moduli (MPa) at quadrature points of elements that boundaries may cross."""
        return np.exp(self.log_youngs(sites)).reshape(sites.shape)

    def youngs_beside(self, sides: Int[np.ndarray, "shapes m"], sites: Sites) -> Moduli:
        """Return the moduli (MPa) at quadrature points of elements on these sides of inclusions.

        See `tactorch.mesh.conform.Conforming` for the sides.
        """
        fractions = []
        for shape, side in zip(self.shapes, sides, strict=True):
            fraction, crossed = (side < 0).astype(np.float64), np.flatnonzero(side == 0)
            fraction[crossed] = sites.fraction_inside(shape, crossed)
            fractions.append(fraction)
        return np.exp(self.log_youngs(sites, fractions)).reshape(sites.shape)
