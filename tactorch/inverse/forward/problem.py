"""The forward problem of all presses: equilibria, predictions and their derivatives (eq. 7)."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import (
    EquilibriumResult,
    Newton,
    NewtonOptions,
    Sensitivity,
    SoftBody,
    Supports,
    make_material,
)
from tactorch.fem.body import check_youngs
from tactorch.fem.chord import approach
from tactorch.fem.contact import Contact
from tactorch.fem.elements import ConsistentLoads
from tactorch.inverse.data.misfit import Misfit, Squares
from tactorch.inverse.data.nuisance import Nuisance, NuisancePrior, PressModel
from tactorch.inverse.data.observations import DataModel, NoiseModel, Observation
from tactorch.inverse.forward.probes import PressReadings, apparent_mpa, make_contact
from tactorch.linalg import SharedLease, SolverOptions, map_cases
from tactorch.linalg.parallel import worker_count
from tactorch.recording import Recording

Moduli = Float[np.ndarray, "m *q"]  # by element, or by quadrature point of each element
Changes = Float[np.ndarray, "k moduli"]  # several changes of moduli
Columns = Float[np.ndarray, "data k"]  # changes of the data
NodalField = Float[np.ndarray, "nodes 3"]
NodalFields = Float[np.ndarray, "k nodes 3"]

_AT_ONCE = 12  # presses whose equilibria are searched together
# Error of derivatives in the change of the data by steps, over the sum of squares of the changes by
# each parameter, up to which those after the steps are derived from those before.
_MAX_MISS = 0.04
# Largest mean squared residual for this: errors of derivatives change the gradient in proportion to
# the residuals.
_MAX_CHI2 = 3.0
_MAX_RELATIVE_CHANGE = 0.5  # of a modulus, for which du/de predicts u


@dataclass(frozen=True, eq=False)
class _PressSolution:
    """The equilibrium of one press: the press at the nuisance values, and the search's result."""

    model: PressModel
    newton: Newton
    equilibrium: EquilibriumResult
    readings: PressReadings

    @cached_property
    def other(self) -> Float[np.ndarray, " k"]:
        """Predicted data that are not displacements of nodes."""
        return self.readings.predicted(self.newton, self.equilibrium)

    def predicted(self, observation: Observation) -> Float[np.ndarray, " data"]:
        """Return the predicted data."""
        return np.concatenate([self.reported.ravel()[observation.index], self.other])

    @property
    def reported(self) -> Float[np.ndarray, "n 3"]:
        return self.model.reported(self.equilibrium.displacement)


class _LinearResponse(NamedTuple):
    """Changes of the data (mm or N) and displacements (mm) of each press by changes of moduli."""

    changes: Changes
    columns: Columns
    fields: list[NodalFields]
    missed: float = 0.0  # see `_MAX_MISS`


class Evaluation:
    """All presses at one map of moduli; derivatives are computed on demand.

    Attributes:
        youngs: Young's modulus of each element, or of each of its quadrature points, MPa.
        nuisance: Nuisance values.
        residuals: Half their square is minimised: predicted minus observed of all presses, in
            standard deviations, transformed by the misfit.
        data: Observations.
    """

    def __init__(
        self,
        youngs: Moduli,
        nuisance: Nuisance,
        weight: NodalField,
        presses: list[_PressSolution],
        data: DataModel,
        derivative_rtol: float = 0.0,
    ) -> None:
        self.derivative_rtol = derivative_rtol
        self.youngs, self.nuisance = youngs, nuisance
        self._weight, self._presses = weight, presses
        self._response: _LinearResponse | None = None  # the last one
        self._compare(data)

    def _compare(self, data: DataModel) -> None:
        """Compute the residuals of the data."""
        self.data, self._misfit, self._begins = data, data.misfit, data.begins
        self._difference = np.concatenate(self.predicted) - data.values
        self._white = data.whiten(self._difference * data.scale)
        self.residuals = self._misfit.residuals(self._white, self._begins)

    @property
    def misfit_mm2(self) -> float:
        """Half the sum of squared differences of displacements (eq. 7), mm^2."""
        parts = np.split(self._difference, self._begins[1:])
        pairs = zip(parts, self.data.observations, strict=True)
        return 0.5 * sum(float((part[data.units[0]] ** 2).sum()) for part, data in pairs)

    @property
    def chi2(self) -> float:
        """Mean squared deviation, or a robust estimate; one when the data are fitted to noise."""
        return self._misfit.chi2(self._white, self._begins)

    @property
    def deviations(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted minus observed, each press, in independent standard deviations."""
        return np.split(self._white, self._begins[1:])

    @property
    def displacements(self) -> list[NodalField]:
        """Predicted displacement of each press, mm."""
        return [press.equilibrium.displacement for press in self._presses]

    @property
    def on_object(self) -> list[NodalField]:
        """Predicted displacement of the object's nodes in each press, mm."""
        return self.displacements

    @property
    def reported(self) -> list[Float[np.ndarray, "n 3"]]:
        """Predicted displacement that the sensor reports, each press, mm."""
        return [press.reported for press in self._presses]

    @property
    def predicted(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted data of each press, in the order of its `Observation`."""
        pairs = zip(self._presses, self.data.observations, strict=True)
        return [press.predicted(observation) for press, observation in pairs]

    def with_data(self, data: DataModel) -> "Evaluation":
        """Return the same equilibria with other statistics of the same data."""
        other = copy(self)
        vars(other).pop("_adjoints", None)  # those of other residuals
        other._compare(data)
        return other

    def search(self, i: int) -> Newton:
        """Return the equilibrium search of press i."""
        return self._presses[i].newton

    @cached_property
    def sensitivities(self) -> list[Sensitivity]:
        """Linearisation of each press, factored once."""
        frame = self.nuisance.rotation if self.nuisance.rotation_rad.any() else None
        tangents = self._common_tangents()

        def work(i: int) -> Sensitivity:
            press, observation = self._presses[i], self.data.observations[i]
            common = tangents[id(press.newton.lease)]
            linearization = press.newton.linearize(press.equilibrium, self.derivative_rtol, common)
            rates = press.readings.rates(press.newton, press.equilibrium)
            return Sensitivity(linearization, observation.index, frame, rates)

        return map_cases(work, len(self._presses))

    def _common_tangents(self) -> dict[int, Callable[[], Float[np.ndarray, " nnz"] | None]]:
        """Return what gives the tangent at the mean displacement of each lease's presses."""
        sharing: dict[int, list[_PressSolution]] = {}
        for press in self._presses:
            sharing.setdefault(id(press.newton.lease), []).append(press)

        def common(presses: list[_PressSolution]) -> Float[np.ndarray, " nnz"] | None:
            if len(presses) == 1 or any(press.newton.contact is not None for press in presses):
                return None
            mean = np.mean([press.equilibrium.displacement for press in presses], axis=0)
            return presses[0].newton.tangent_at(mean)

        return {lease: cache(partial(common, presses)) for lease, presses in sharing.items()}

    def factor(self) -> None:
        """Factor the tangent of each press.

        Raises:
            ConvergenceError: an equilibrium is unstable.
        """
        for sensitivity in self.sensitivities:
            sensitivity.linearization.factor()

    def jacobian(self) -> Float[np.ndarray, "data m"]:
        """Return d residuals / d youngs, 1/MPa, by one solve per observed degree of freedom."""
        cases, data = self.sensitivities, self.data.observations
        parts = map_cases(lambda i: cases[i].matrix() * data[i].scale[:, None], len(cases))
        return self._of_residuals(np.concatenate(parts))

    def log_rates(self) -> Float[np.ndarray, "data m"]:
        """Return the derivatives of the data (mm, N or N mm) by the log-modulus of each element."""
        rates = self.with_data(DataModel(self.data.observations)).jacobian()
        rates *= self.youngs.ravel() / self.data.scale[:, None]
        return rates.reshape(len(rates), len(self.youngs), -1).sum(axis=2)

    def nuisance_jacobian(self, names: tuple[str, ...]) -> Columns:
        """Return d residuals / d nuisance parameters, by one solve per component and press.

        For scales the derivative is by the logarithm. Rotation is by the vector's components.
        """
        cases = self.sensitivities

        def work(i: int) -> np.ndarray:
            # The implicit function theorem: K du = df - dR, with K already factored.
            press, linearization, columns = self._presses[i], cases[i].linearization, []
            for name in names:
                forces, reports = press.model.rates(name, press.equilibrium.displacement)
                changes = self._loads(press, forces)
                if name == "poisson":
                    changes = [-rate for rate in linearization.parameter_forces(poisson=True)]
                elif name == "rest_scale":
                    rates = linearization.parameter_forces(stretch=True)
                    changes = [self._weight - rate for rate in rates]
                moved = linearization.force_response(np.reshape(changes, (-1, *self._weight.shape)))
                pairs = zip(moved, changes, strict=True)
                indirect = [cases[i].observe(field, -change) for field, change in pairs]
                direct = [cases[i].observed_components(report) for report in reports]
                if indirect and direct:
                    columns += [a + b for a, b in zip(indirect, direct, strict=True)]
                else:
                    columns += indirect or direct
            return np.column_stack(columns) * self.data.observations[i].scale[:, None]

        return self._of_residuals(np.concatenate(map_cases(work, len(cases))))

    def _loads(self, press: _PressSolution, changes: Sequence[np.ndarray]) -> list[NodalField]:
        """Return the loads of all nodes by changes of a press's nodal forces, N."""
        discretisation = press.newton.assembly.discretisation
        if not discretisation.element.quadratic:
            return list(changes)
        # The loaded triangles are those of the press: a change may be zero at some nodes.
        loads = ConsistentLoads.of(discretisation, press.model.forces)
        return [loads.apply(change) for change in changes]

    def jacobian_times(self, change: Moduli) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of the moduli (MPa)."""
        columns, _ = self._respond(change.reshape(1, -1))
        return self._of_residuals(columns[:, 0] * self.data.scale)

    def linear_response(self, changes: Changes) -> tuple[Columns, list[NodalFields]]:
        """Return the changes of residuals and displacements by changes of the moduli (MPa).

        The last response is kept, also by `with_data`, for the same changes.

        Returns:
            The change of the residuals by each, (data, k), and that of the displacement of each
            press, mm.
        """
        if self._response is None or not np.array_equal(self._response.changes, changes):
            self._response = _LinearResponse(changes.copy(), *self._respond(changes))
        columns = self._response.columns * self.data.scale[:, None]
        return self._of_residuals(columns), self._response.fields

    def _of_press(self, changes: Changes, number: int) -> Changes:
        """Return changes of the moduli of all elements that a press has."""
        return changes

    def _respond(self, changes: Changes) -> tuple[Columns, list[NodalFields]]:
        """Return the changes of the data (mm or N), and of the displacements of each press (mm)."""
        cases = self.sensitivities

        def work(i: int) -> tuple[np.ndarray, np.ndarray]:
            columns, fields = cases[i].times_each(self._of_press(changes, i))
            return columns, np.array(fields)

        columns, fields = zip(*map_cases(work, len(cases)), strict=True)
        return np.concatenate(columns), list(fields)

    def update_response(
        self, changes: Changes, before: "Evaluation", step: Float[np.ndarray, " k"]
    ) -> None:
        """Derive the response to changes from that of an evaluation nearby, where it is accurate.

        The derivatives along the step are those of a parabola through the data of both evaluations;
        across it they remain (C. G. Broyden, "A class of methods for solving nonlinear simultaneous
        equations", Math. Comput. 19 (1965), 577-593).

        Args:
            changes: Changes of the moduli (MPa) by parameters here.
            before: The evaluation, whose last response is to changes by the same parameters there.
            step: Change of the parameters since then.
        """
        response, square = before._response, float(step @ step)
        if response is None or not self.derivative_rtol or not square or self.chi2 > _MAX_CHI2:
            return
        moved = np.concatenate(self.predicted) - np.concatenate(before.predicted)
        missed, scale = moved - response.columns @ step, self.data.scale
        size = np.linalg.norm(self.data.whiten(response.columns * scale[:, None]) * step)
        ratio = response.missed + float(np.linalg.norm(self.data.whiten(missed * scale)) / size)
        if ratio > _MAX_MISS:
            return
        along = 2.0 * step / square
        fields = []
        for u, u_before, field in zip(
            self.displacements, before.displacements, response.fields, strict=True
        ):
            u_missed = u - u_before - np.tensordot(step, field, 1)
            fields.append(field + along[:, None, None] * u_missed)
        columns = response.columns + np.outer(missed, along)
        self._response = _LinearResponse(changes.copy(), columns, fields, ratio)

    def moved(self, changes: Sequence[NodalField]) -> list[NodalField]:
        """Return the displacements of all presses plus changes (mm) that invert no element."""

        def work(i: int) -> np.ndarray:
            before = self._presses[i].equilibrium.displacement
            guess = before + changes[i]
            return guess if self.search(i).assembly.respond(guess) is not None else before

        return map_cases(work, len(self._presses))

    def probe_motions(self) -> list[Float[np.ndarray, "data axes"]]:
        """Return the changes of the data of each press by a motion of its probe, 1/mm.

        The motion is along the axes of the mesh, the unit that of the standard deviations; there
        are no columns without a probe.
        """
        data = self.data.observations

        def work(i: int) -> np.ndarray:
            press, scale = self._presses[i], data[i].scale[:, None]
            contact = press.newton.contact
            if contact is None:
                return np.zeros((len(scale), 0))
            motions = np.tile(np.eye(3), (self._weight.shape[0], 1))
            tangent = contact.tangent(contact.at(press.equilibrium.displacement))
            forces = (tangent @ motions).T.reshape(3, -1, 3)
            columns = self.response_to_loads(i, np.ascontiguousarray(forces))
            direct = press.readings.by_motion(press.newton, press.equilibrium)
            columns[len(data[i].index) :] += direct
            return columns * scale

        return map_cases(work, len(self.sensitivities))

    def at_rest_shapes(
        self, points: Mapping[int, Float[np.ndarray, "n 3"]]
    ) -> dict[int, Float[np.ndarray, " data"]]:
        """Return the predicted data of presses (mm or N) for other rest shapes (mm), by number.

        Presses without an equilibrium, or whose elements are inverted, are left out.
        """
        searches: dict[int, Newton] = {}
        for i, shape in points.items():
            with suppress(ConfigError):
                searches[i] = self.search(i).with_rest_shape(shape)
        starts = {i: self._presses[i].equilibrium.displacement for i in searches}
        starts |= _near_equilibrium(searches, starts)

        def work(i: int) -> np.ndarray | None:
            equilibrium = searches[i].run(starts[i])
            moved = replace(self._presses[i], newton=searches[i], equilibrium=equilibrium)
            return moved.predicted(self.data.observations[i]) if equilibrium.converged else None

        numbers = list(searches)
        found = map_cases(lambda k: work(numbers[k]), len(numbers))
        return {i: data for i, data in zip(numbers, found, strict=True) if data is not None}

    def load_response(self, number: int, changes: Sequence[Float[np.ndarray, "n 3"]]) -> Columns:
        """Return the changes of the data of a press by changes of its nodal forces, N.

        The unit is that of the standard deviations.
        """
        loads = np.array(self._loads(self._presses[number], changes))
        scale = self.data.observations[number].scale[:, None]
        return self.response_to_loads(number, loads) * scale

    def response_to_loads(
        self, number: int, loads: NodalFields, rtol: float | None = None
    ) -> Columns:
        """Return the changes of the data of a press (mm or N) by loads of all nodes, N.

        `rtol` is the relative residual of the solves, by default that of derivatives.
        """
        return self.sensitivities[number].load_response(loads, rtol)

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Moduli:
        """Return the transpose of d residuals / d youngs times `weights`."""
        parts, cases = self._split(weights), self.sensitivities
        return np.sum(map_cases(lambda i: cases[i].transpose_times(parts[i]), len(parts)), axis=0)

    def gradient(self) -> Moduli:
        """Return the gradient of half the sum of squared residuals, by one adjoint solve per press.

        This is eq. (9) to (13), without the paper's second minus.
        """
        return self.transpose_times(self.residuals)

    @cached_property
    def _adjoints(self) -> list[NodalField]:
        """Adjoint displacement of each press for the residuals, 1/N."""
        parts, cases = self._split(self.residuals), self.sensitivities
        return map_cases(lambda i: cases[i].adjoint(parts[i]), len(parts))

    def second_order_times(self, change: Moduli) -> Moduli:
        """Return the part of the misfit's Hessian that Gauss-Newton omits times a change (MPa).

        It takes one solve per press more than the two of Gauss-Newton; see
        `tactorch.fem.Linearization.second_order`.

        Raises:
            ConfigError: a press is by a probe, or has a measured force.
        """
        probed = any(press.newton.contact is not None for press in self._presses)
        if probed or any(observation.force is not None for observation in self.data.observations):
            raise ConfigError(
                "The exact Hessian is not known for presses by a probe, or with measured forces; "
                "choose an optimizer or a Hessian by Gauss-Newton."
            )
        pairs = zip(self.sensitivities, self._adjoints, strict=True)
        return np.sum([s.linearization.second_order(a, change) for s, a in pairs], axis=0)

    def _of_residuals(self, data: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Derivatives of the residuals from those of the data in standard deviations."""
        return self._misfit.derivative(self._white, self._begins, self.data.whiten(data))

    def _of_data(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, " data"]:
        """Weights of the residuals as weights of the data in standard deviations."""
        return self.data.transposed(self._misfit.derivative(self._white, self._begins, weights))

    def _split(self, weights: Float[np.ndarray, " data"]) -> list[Float[np.ndarray, " p"]]:
        """Weights of the residuals as weights of the data of each press, 1 over their unit."""
        return np.split(self._of_data(weights) * self.data.scale, self._begins[1:])

    def predict(self, youngs: Moduli) -> list[NodalField]:
        """Predict the displacements at other moduli.

        To first order where the change is small and the presses are linearised already.
        """
        change = youngs - self.youngs
        large = np.abs(change / self.youngs).max() > _MAX_RELATIVE_CHANGE
        if large or "sensitivities" not in vars(self):
            return self.displacements
        cases = self.sensitivities
        return self.moved(
            map_cases(lambda i: cases[i].linearization.displacement_change(change), len(cases))
        )


class InverseProblem:
    """A recording as an inverse problem.

    Args:
        recording: Presses, mesh and material. Its truth and reference are never read.
        element: Element type.
        solver: Linear solver.
        noise: Standard deviations for presses that do not state theirs.
        newton: Settings of the equilibrium search.
        misfit: Cost of the residuals; squares by default.
        nuisance: Nuisance parameters that are estimated together with the map, for starts.
        body: Body of this mesh, material, element and solver, where it exists already.
        derivative_rtol: Relative residual of the solves for derivatives, for which presses of the
            same supports share factorisations; zero factors the tangent of each press, which is
            better for more than some tens of solves.
        contact_mpa: Modulus for the stiffness of contacts with probes, MPa; by default the uniform
            one by some of the measured forces.

    Attributes:
        data: Observations and the statistics of their errors.
        assumed: Nuisance values that the recording states.
        evaluations: Number of evaluations so far.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        element: str = "tet4",
        solver: str | SolverOptions = "auto",
        noise: NoiseModel | None = None,
        newton: NewtonOptions | None = None,
        misfit: Misfit | None = None,
        nuisance: NuisancePrior | None = None,
        body: SoftBody | None = None,
        derivative_rtol: float = 0.0,
        contact_mpa: float | None = None,
    ) -> None:
        self.derivative_rtol, self._contact_mpa = derivative_rtol, contact_mpa
        self.recording = recording
        self.body = body or make_body(recording, element, solver, newton)
        self.noise = noise or NoiseModel()
        presses = recording.presses
        pairs = zip(presses, self.noise.deviations(recording), strict=True)
        observations = tuple(Observation.of(press, deviation) for press, deviation in pairs)
        self.data = DataModel(observations, misfit or Squares())
        self.nuisance = nuisance or NuisancePrior()
        self._check_nuisance()
        self.assumed = Nuisance(recording.material.poisson)
        self._weight = np.zeros((self.body.n_nodes, 3))
        if recording.density:
            gravity = self.body.gravity(recording.density, torch.tensor(recording.gravity))
            self._weight = gravity.numpy()
        self._readings = [PressReadings.of(press, self.body.discretisation) for press in presses]
        self.evaluations = 0
        self._leases: list[SharedLease] | None = None
        if derivative_rtol:  # presses of the same supports share factorisations
            supports = [press.fixed.tobytes() + press.springs.tobytes() for press in presses]
            self._leases = [self.body.shared_lease(key) for key in supports]

    @cached_property
    def _order(self) -> Int[np.ndarray, " presses"]:
        """Order of the presses, in which those that share factorisations are apart."""
        keys: list[Any] = list(self._leases or range(len(self.recording.presses)))
        return np.argsort([keys[:i].count(key) for i, key in enumerate(keys)], kind="stable")

    def _check_nuisance(self) -> None:
        """Refuse nuisance parameters that probes and other readings do not have."""
        others = sorted(set(self.nuisance.names) - {"poisson"})
        for press in self.recording.presses:
            if others and (press.probe is not None or press.has_readings):
                raise ConfigError(
                    f"{press.label} has a probe, or other data than displacements of nodes; "
                    f"{', '.join(others)} cannot be estimated with it. Leave them out."
                )

    @cached_property
    def _contacts(self) -> list[Contact | None]:
        """Contact of each press with its probe."""
        modulus = self.contact_mpa if self.recording.has_probes else 0.0
        return [make_contact(press, self.body, modulus) for press in self.recording.presses]

    @cached_property
    def contact_mpa(self) -> float:
        """Modulus for the stiffness of contacts with probes, MPa."""
        return self._contact_mpa or apparent_mpa(self.recording, self.body)

    @property
    def noise_is_limit(self) -> bool:
        """Whether the noise of some press may be smaller than its deviation."""
        return self.noise.floored(self.recording)

    @property
    def n_data(self) -> int:
        """Number of data over all presses."""
        return sum(self.data.counts)

    @property
    def n_elements(self) -> int:
        """Number of moduli."""
        return self.recording.mesh.n_tets

    def with_data(self, data: DataModel) -> "InverseProblem":
        """Return the problem with other data, on the same body."""
        problem = copy(self)
        problem.data = data
        return problem

    def evaluate(
        self,
        youngs: Moduli,
        near: Evaluation | None = None,
        nuisance: Nuisance | None = None,
        take_over: bool = False,
        chained: bool = False,
        starts: Sequence[NodalField] | None = None,
    ) -> Evaluation:
        """Solve all presses at these moduli, in parallel.

        Args:
            youngs: Young's modulus of each element, or of each of its quadrature points, MPa.
            near: Evaluation at similar moduli to start from.
            nuisance: Nuisance values; by default those that the recording states.
            take_over: Whether to take over the factorisations of `near`, which must then factor
                again for its derivatives. It saves time and half the memory. Without effect where
                presses share factorisations.
            chained: Whether to solve the presses on each core one after the other, each with the
                factorisation of the one before. It needs the memory of one press a core, but gives
                no derivatives. Without effect on the factorisations where presses share them.
            starts: Displacement to start from, each press, mm; by default those of `near`.

        Raises:
            ConvergenceError: a press has no equilibrium; names the press.
        """
        check_youngs(youngs, self.body.assembly.weights.shape)
        values, mesh = nuisance or self.assumed, self.recording.mesh
        assembly = self.body.with_parameters(values.poisson, mesh.points * values.rest_scale)
        weight = self._weight * values.rest_scale.prod()
        if starts is None and near is not None:
            starts = near.predict(youngs)

        contacts = self._contacts
        made: dict[int, tuple[PressModel, Newton]] = {}

        def make(i: int, after: Newton | None = None) -> tuple[PressModel, Newton]:
            press = self.recording.presses[i]
            model = PressModel.of(press, mesh, values)
            supports = Supports(press.fixed, press.prescribed, press.springs)
            forces = self.body.discretisation.consistent_loads(model.forces) + weight
            lease = None if self._leases is None else self._leases[i]
            return model, self.body.search(
                youngs, forces, supports, assembly=assembly, after=after, lease=lease,
                contact=contacts[i],
            )  # fmt: skip

        def work(i: int, after: Newton | None = None) -> _PressSolution:
            if near is not None and take_over:
                after = near.search(i)
            model, newton = made.get(i) or make(i, after)
            start = None if starts is None else near_equilibrium.get(i, starts[i])
            equilibrium = newton.run(start)
            if not equilibrium.converged:
                label = self.recording.presses[i].label
                raise ConvergenceError(f"{label} (index {i}): {equilibrium.reason}")
            return _PressSolution(model, newton, equilibrium, self._readings[i])

        near_equilibrium: dict[int, NodalField] = {}
        if starts is not None and self._leases is not None:
            made |= {i: make(i) for i in range(len(contacts)) if contacts[i] is None}
            searches = {i: newton for i, (_, newton) in made.items()}
            near_equilibrium = _near_equilibrium(searches, dict(enumerate(starts)))
        self.evaluations += 1
        count = len(self.data.observations)
        parts = min(worker_count(), count) if chained else count
        chains = np.array_split(np.arange(count) if chained else self._order, parts)

        def in_turn(k: int) -> list[tuple[int, _PressSolution]]:
            found: list[tuple[int, _PressSolution]] = []
            for i in chains[k].tolist():
                found.append((i, work(i, found[-1][1].newton if found else None)))
            return found

        found = dict(pair for part in map_cases(in_turn, len(chains)) for pair in part)
        solutions = [found[i] for i in range(count)]
        return Evaluation(youngs, values, weight, solutions, self.data, self.derivative_rtol)


def _near_equilibrium(
    searches: Mapping[int, Newton], starts: Mapping[int, NodalField]
) -> dict[int, NodalField]:
    """Return displacements near equilibrium of presses that share factorisations, by number."""
    sharing: dict[SharedLease, list[int]] = {}
    for i, newton in searches.items():
        if newton.contact is None and isinstance(newton.lease, SharedLease):
            sharing.setdefault(newton.lease, []).append(i)
    chunks: list[tuple[SharedLease, list[int]]] = []
    for lease, numbers in sharing.items():
        parts = max(worker_count(), len(numbers) // _AT_ONCE)
        chunks += [(lease, numbers[k::parts]) for k in range(parts) if numbers[k::parts]]

    def work(k: int) -> list[tuple[int, NodalField]]:
        lease, chunk = chunks[k]
        pairs = [searches[i] for i in chunk], [starts[i] for i in chunk]
        return list(zip(chunk, approach(*pairs, lease), strict=True))

    return dict(pair for part in map_cases(work, len(chunks)) for pair in part)


def make_body(
    recording: Recording, element: str, solver: str | SolverOptions, newton: NewtonOptions | None
) -> SoftBody:
    """Return the body of a recording."""
    spec = recording.material
    material = make_material(spec.name, spec.poisson, **spec.parameters)
    return SoftBody(recording.mesh, material, element=element, solver=solver, newton=newton)
