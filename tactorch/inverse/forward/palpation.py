"""Palpation of a linear elastic body by a ball: many presses with one factorisation.

The forces of all presses follow from the compliance of the body between the contact pressures of
each place (`tactorch.fem.indentation`). The derivatives of the compliance are strain energies of
the same solutions, so that an evaluation takes a few solves for each place, and its derivatives
none.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.fem import Supports
from tactorch.fem.body import check_youngs
from tactorch.fem.contact import Ball
from tactorch.fem.indentation import BallForces, BallPlace, Indentation, IndentedBody
from tactorch.inverse.data.observations import (
    CorrelatedNoise,
    DataModel,
    Observation,
    group_by_contact,
)
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.mesh.closest import closest_points
from tactorch.recording import Press, ProbePose, Recording

_SAME_PLACE = 0.05  # distance across the approach, over the ball's radius, at which places differ
# Error of the model of the contact (small strains, no friction), over the force.
_CONTACT_ERROR = 0.03
_LINEAR = "linear"
#: Element type of the body of a palpation.
PALPATION_ELEMENT = "tet10"


def is_palpation(recording: Recording) -> bool:
    """Whether all presses are by balls into a linear body, and measure forces along the push."""
    first = recording.presses[0]
    return (
        recording.material.name == _LINEAR
        and not recording.density
        and all(
            _is_by_ball(press)
            and not press.forces.any()
            and not press.prescribed.any()
            and (press.fixed is first.fixed or np.array_equal(press.fixed, first.fixed))
            and (press.springs is first.springs or np.array_equal(press.springs, first.springs))
            for press in recording.presses
        )
    )


def _is_by_ball(press: Press) -> bool:
    pose, force = press.probe, press.force
    if pose is None or force is None or press.surface is not None or press.data.any():
        return False
    return isinstance(pose.probe, Ball) and not force.axes[:, 3:].any()


class PlaceErrors(CorrelatedNoise):
    """Errors of unknown size that are common to the data of one place each.

    Args:
        sizes: Error of each datum by an error of unit standard deviation, in standard deviations
            of the white noise.
        places: Place of each datum.
    """

    def __init__(self, sizes: Float[np.ndarray, " data"], places: Int[np.ndarray, " data"]) -> None:
        self._sizes, self._places = sizes, places
        count = int(places.max()) + 1
        self._rows = sp.csr_matrix((sizes, (places, np.arange(len(sizes)))), (count, len(sizes)))
        variances = 1.0 + np.bincount(places, sizes**2, count)
        self._factors = 1.0 / (variances + np.sqrt(variances))
        self._determinant = float(np.log(variances).sum())

    @property
    def patterns(self) -> Float[np.ndarray, "data k"]:  # type: ignore[override]
        """Patterns of the errors, one for each place."""
        return np.asarray(self._rows.T.toarray())

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of the residuals."""
        return self._determinant

    def widened(self, factors: Float[np.ndarray, " data"]) -> "PlaceErrors":
        """Return the same errors relative to white noise that is `factors` times as large."""
        return PlaceErrors(self._sizes / factors, self._places)

    def whiten(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return whitened residuals or their derivatives; the operator is symmetric."""
        inner = self._rows @ values
        scaled = self._factors.reshape(-1, *(1,) * (values.ndim - 1)) * inner
        whitened: np.ndarray = values - self._rows.T @ scaled
        return whitened


class PalpationEvaluation(Evaluation):
    """All presses of a palpation at one map of moduli; see `Evaluation`."""

    def __init__(
        self, problem: "PalpationProblem", body: IndentedBody, forces: BallForces, data: DataModel
    ) -> None:
        self._problem, self._body, self._forces = problem, body, forces
        self.derivative_rtol = 0.0
        self._presses = []
        self.youngs, self.nuisance = body.youngs, problem.assumed
        self.data, self._misfit, self._begins = data, data.misfit, data.begins
        observed = np.concatenate([o.values for o in data.observations])
        difference = problem.directions * forces.force_n[problem.press_of] - observed
        self.misfit_mm2 = 0.0  # no displacement is observed
        self._white = data.whiten(difference * data.scale)
        self.residuals = self._misfit.residuals(self._white, self._begins)

    @property
    def forces(self) -> BallForces:
        """Force on the ball along the outward normal of each press."""
        return self._forces

    @property
    def displacements(self) -> list[Float[np.ndarray, "nodes 3"]]:
        """Displacements are not kept; the list is empty."""
        return []

    @property
    def reported(self) -> list[Float[np.ndarray, "n 3"]]:
        """Nothing, as the sensor reports forces."""
        return []

    @property
    def predicted(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted components of the force of each press, N."""
        values = self._problem.directions * self._forces.force_n[self._problem.press_of]
        return np.split(values, self._begins[1:])

    def with_data(self, data: DataModel) -> "PalpationEvaluation":
        """Return the same forces with other statistics of the same data."""
        return PalpationEvaluation(self._problem, self._body, self._forces, data)

    @property
    def sensitivities(self) -> list[Any]:
        """Not known: displacements of nodes have no derivatives here."""
        raise ConfigError(
            "A palpation with one factorisation has no sensitivities of displacements; use the "
            "sensitivity matrix of the forces (`jacobian`)."
        )

    def factor(self) -> None:
        """Do nothing: equilibria of linear elasticity are stable."""

    @property
    def _rates(self) -> Float[np.ndarray, "rows moduli"]:
        """Minus the rates of the compliance, one row for each pair of profiles and place."""
        return self._body.rates

    @cached_property
    def _chain(self) -> sp.csr_matrix:
        """Derivatives of the data, in their units, by minus the compliance of all places."""
        problem, forces = self._problem, self._forces
        pairs, count = forces.terms.shape[1], len(problem.indentation.places)
        of = problem.press_of
        columns = np.arange(pairs) * count + forces.places[of][:, None]
        values = (problem.directions * self.data.scale)[:, None] * forces.terms[of]
        rows = np.repeat(np.arange(len(of)), pairs)
        shape = (len(of), count * pairs)
        return sp.csr_matrix((values.ravel(), (rows, columns.ravel())), shape)

    def _whitened(self, columns: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        return self._misfit.derivative(self._white, self._begins, self.data.whiten(columns))

    def jacobian(self) -> Float[np.ndarray, "data moduli"]:
        """Return d residuals / d youngs, 1/MPa."""
        return self._whitened(np.asarray(self._chain @ self._rates, dtype=np.float64))

    def jacobian_times(self, change: Float[np.ndarray, "m *q"]) -> Float[np.ndarray, " data"]:
        """Return the change of the residuals by a change of the moduli (MPa)."""
        moved = self._rates @ change.ravel().astype(np.float32)
        return self._whitened(self._chain @ moved.astype(np.float64))

    def jacobian_times_each(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> Float[np.ndarray, "data k"]:
        """Return the change of the residuals by each of several changes of the moduli (MPa)."""
        moved = self._body.compliance_changes(changes.reshape(len(changes), -1))
        return self._whitened(self._chain @ moved)

    def linear_response(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> tuple[Float[np.ndarray, "data k"], list[Float[np.ndarray, "k nodes 3"]]]:
        """Return `jacobian_times_each`; displacements are not kept."""
        return self.jacobian_times_each(changes), []

    def moved(
        self, changes: Sequence[Float[np.ndarray, "nodes 3"]]
    ) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return nothing: the equilibria are linear."""
        return []

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Float[np.ndarray, "m *q"]:
        """Return the transpose of d residuals / d youngs times `weights`."""
        white = self.data.whiten(self._misfit.derivative(self._white, self._begins, weights))
        rows = (self._chain.T @ white).astype(np.float32)
        return (self._rates.T @ rows).astype(np.float64).reshape(self.youngs.shape)

    def second_order_times(self, change: Float[np.ndarray, "m *q"]) -> Float[np.ndarray, "m *q"]:
        """Not known."""
        raise ConfigError("The exact Hessian is not known for presses by a probe.")

    def predict(self, youngs: Float[np.ndarray, "m *q"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return nothing: the equilibria are linear."""
        return []


class PalpationProblem(InverseProblem):
    """A palpation by a ball as an inverse problem; see `InverseProblem`.

    Quadratic elements are used. The errors of the depths of a place (`ProbePose.deviation_mm`) are
    common to its presses, and 3 % of each force is the error of the model of the contact.

    Attributes:
        indentation: The places on the body.
        places: Place of each press.
        depths_mm: Depth of the ball of each press.
        press_of: Press of each datum.
        directions: Component of the normal in each datum.
    """

    def __init__(
        self, recording: Recording, *, element: str = PALPATION_ELEMENT, **options: Any
    ) -> None:
        options = {**options, "element": element}
        super().__init__(recording, **options)
        if self.nuisance.size:
            raise ConfigError(
                f"{', '.join(self.nuisance.names)}: nuisance parameters are not estimated with a "
                "palpation; leave them out."
            )
        poses = [press.probe for press in recording.presses]
        self.places, first = group_places([pose for pose in poses if pose is not None])
        self._set_places(first)
        counts = self.data.counts
        self.press_of = np.repeat(np.arange(len(counts)), counts)
        self.directions = np.concatenate([
            press.force.axes[:, :3] @ press.probe.rotation[:, 2]
            for press in recording.presses
            if press.force is not None and press.probe is not None
        ])  # fmt: skip
        self.data = self._with_errors(self.data)

    def _set_places(self, first: Int[np.ndarray, " places"]) -> None:
        """Find the contact point of each place, and the depth of each press."""
        mesh, presses = self.recording.mesh, self.recording.presses
        poses: list[ProbePose] = [p.probe for p in presses if p.probe is not None]
        normals = np.array([pose.rotation[:, 2] for pose in poses])
        radii = np.array([pose.probe.sizes[0] for pose in poses])
        lowest = np.array([pose.position_mm for pose in poses]) - radii[:, None] * normals
        closest = closest_points(mesh.points, mesh.surface.triangles, lowest[first])
        self.depths_mm = ((closest.points[self.places] - lowest) * normals).sum(axis=1)
        deepest = np.full(len(first), -np.inf)
        np.maximum.at(deepest, self.places, self.depths_mm)
        away = np.flatnonzero(deepest <= 0.0)
        if len(away):
            press = presses[first[away[0]]]
            raise ConfigError(
                f"{press.label}: its ball does not touch the object, by {-deepest[away[0]]:.3g} mm;"
                " check the axes of mesh and poses."
            )
        supports = Supports(presses[0].fixed, presses[0].prescribed, presses[0].springs)
        self.indentation = Indentation(
            self.body, supports,
            [
                BallPlace(contact, normals[i], float(radii[i]), float(depth))
                for contact, i, depth in zip(closest.points, first, deepest, strict=True)
            ],
        )  # fmt: skip

    def _with_errors(self, data: DataModel) -> DataModel:
        """Return the data with errors of the contact, and of the depths of each place."""
        observations, sizes = [], []
        stiffness = self._measured_stiffness()
        for i, (press, observation) in enumerate(
            zip(self.recording.presses, data.observations, strict=True)
        ):
            error = _CONTACT_ERROR * float(np.linalg.norm(observation.values))
            scale = 1.0 / np.hypot(1.0 / observation.scale, error)
            observations.append(replace(observation, scale=scale))
            deviation = press.probe.deviation_mm if press.probe is not None else 0.0
            sizes.append(np.full(len(scale), deviation * stiffness[i]) * scale)
        places = self.places[self.press_of]
        values = np.concatenate(sizes) * self.directions
        noise = PlaceErrors(values, places) if values.any() else None
        return replace(data, observations=tuple(observations), correlated=noise)

    def _measured_stiffness(self) -> Float[np.ndarray, " presses"]:
        """Slope of the measured force by the depth at each press, N/mm."""
        forces = np.array([
            float(np.linalg.norm(press.force.values))
            for press in self.recording.presses
            if press.force is not None
        ])  # fmt: skip
        slopes = np.zeros(len(forces))
        for place in np.unique(self.places):
            here = np.flatnonzero(self.places == place)
            order = here[np.argsort(self.depths_mm[here])]
            depths = self.depths_mm[order]
            if len(order) > 1 and np.diff(depths).min() > 0.0:
                slopes[order] = np.gradient(forces[order], depths)
            else:
                slopes[order] = 1.5 * forces[order] / np.maximum(depths, 1e-3)
        return np.maximum(slopes, 0.0)

    @property
    def noise_is_limit(self) -> bool:
        """True: the errors of contacts and depths may be smaller than assumed."""
        return True

    @cached_property
    def contact_mpa(self) -> float:
        """Best uniform modulus, MPa."""
        unit = self.indentation.at(np.ones(self.n_elements))
        predicted = unit.press(self.places, self.depths_mm).force_n[self.press_of]
        observed = np.concatenate([o.values for o in self.data.observations]) * self.directions
        weights = self.data.scale**2
        products = float((weights * predicted * observed).sum())
        ratio = products / max(float((weights * predicted**2).sum()), 1e-300)
        if ratio <= 0.0:
            raise ConfigError(
                "The measured forces pull the ball into the object; give the force on the ball "
                "(N), in the axes of the mesh."
            )
        return ratio

    def evaluate(
        self,
        youngs: Float[np.ndarray, "m *q"],
        *_near: Any,
        **_options: Any,
    ) -> PalpationEvaluation:
        """Return all presses at these moduli; the other arguments have no effect."""
        check_youngs(youngs, self.body.assembly.weights.shape)
        self.evaluations += 1
        body = self.indentation.at(youngs)
        return PalpationEvaluation(self, body, body.press(self.places, self.depths_mm), self.data)


def contacts_of(recording: Recording, observations: Sequence[Observation]) -> list[tuple[int, ...]]:
    """Return the numbers of the presses of each contact, or of each place of a palpation."""
    if not is_palpation(recording):
        return group_by_contact(recording.presses, observations)
    places, first = group_places([press.probe for press in recording.presses if press.probe])
    return [tuple(np.flatnonzero(places == place).tolist()) for place in range(len(first))]


def group_places(
    poses: Sequence[ProbePose],
) -> tuple[Int[np.ndarray, " presses"], Int[np.ndarray, " places"]]:
    """Return the place of each pose, and the first pose of each place.

    Poses of a place have one probe and axis, and lie on it.
    """
    keys: dict[bytes, list[int]] = {}
    places = np.zeros(len(poses), dtype=int)
    first: list[int] = []
    for i, pose in enumerate(poses):
        key = np.round(pose.rotation[:, 2], 6).tobytes() + repr(pose.probe).encode()
        axis = pose.rotation[:, 2]
        for place in keys.setdefault(key, []):
            apart = pose.position_mm - poses[first[place]].position_mm
            across = np.linalg.norm(apart - (apart @ axis) * axis)
            if across < _SAME_PLACE * pose.probe.sizes[0]:
                places[i] = place
                break
        else:
            places[i] = len(first)
            keys[key].append(len(first))
            first.append(i)
    return places, np.array(first)
