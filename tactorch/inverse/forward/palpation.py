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
from tactorch.inverse.data.observations import CorrelatedNoise, DataModel, group_by_contact
from tactorch.inverse.forward.problem import (
    Changes,
    Columns,
    Evaluation,
    InverseProblem,
    Moduli,
    NodalFields,
)
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


class PalpationEvaluation(Evaluation):
    """All presses of a palpation at one map of moduli; see `Evaluation`."""

    def __init__(
        self, problem: "PalpationProblem", body: IndentedBody, forces: BallForces, data: DataModel
    ) -> None:
        self._problem, self._body, self._forces = problem, body, forces
        super().__init__(body.youngs, problem.assumed, np.zeros((0, 3)), [], data)

    @property
    def predicted(self) -> list[Float[np.ndarray, " _"]]:
        """Predicted components of the force of each press, N."""
        values = self._problem.directions * self._forces.force_n[self._problem.press_of]
        return np.split(values, self._begins[1:])

    @property
    def sensitivities(self) -> list[Any]:
        """Not known: displacements of nodes have no derivatives here."""
        raise ConfigError(
            "A palpation with one factorisation has no sensitivities of displacements; use the "
            "sensitivity matrix of the forces (`jacobian`)."
        )

    def factor(self) -> None:
        """Do nothing: equilibria of linear elasticity are stable."""

    @cached_property
    def _chain(self) -> sp.csr_matrix:
        """Derivatives of the data (N) by minus the compliance of all places."""
        problem, forces = self._problem, self._forces
        pairs, count = forces.terms.shape[1], len(problem.indentation.places)
        of = problem.press_of
        columns = np.arange(pairs) * count + forces.places[of][:, None]
        values = problem.directions[:, None] * forces.terms[of]
        rows = np.repeat(np.arange(len(of)), pairs)
        shape = (len(of), count * pairs)
        return sp.csr_matrix((values.ravel(), (rows, columns.ravel())), shape)

    @property
    def _scaled_chain(self) -> sp.csr_matrix:
        """The same of the data in standard deviations."""
        return sp.diags(self.data.scale) @ self._chain

    def jacobian(self) -> Float[np.ndarray, "data moduli"]:
        return self._of_residuals(self._body.combined_rates(self._scaled_chain))

    def log_rates(self) -> Float[np.ndarray, "data m"]:
        return self._body.combined_rates(self._chain, logarithmic=True)

    def jacobian_times(self, change: Moduli) -> Float[np.ndarray, " data"]:
        moved = self._body.rates @ change.ravel().astype(np.float32)
        return self._of_residuals(self._scaled_chain @ moved.astype(np.float64))

    def _respond(self, changes: Changes) -> tuple[Columns, list[NodalFields]]:
        """Return the changes of the data (N); displacements are not kept."""
        return self._chain @ self._body.compliance_changes(changes.reshape(len(changes), -1)), []

    def transpose_times(self, weights: Float[np.ndarray, " data"]) -> Moduli:
        rows = (self._scaled_chain.T @ self._of_data(weights)).astype(np.float32)
        return (self._body.rates.T @ rows).astype(np.float64).reshape(self.youngs.shape)


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
        super().__init__(recording, element=element, **options)
        if self.nuisance.size:
            raise ConfigError(
                f"{', '.join(self.nuisance.names)}: nuisance parameters are not estimated with a "
                "palpation; leave them out."
            )
        self._poses = [press.probe for press in recording.presses if press.probe is not None]
        self._measured = [press.force for press in recording.presses if press.force is not None]
        self.places, first = group_places(self._poses)
        self._set_places(first)
        counts = self.data.counts
        self.press_of = np.repeat(np.arange(len(counts)), counts)
        pairs = zip(self._measured, self._poses, strict=True)
        parts = [force.axes[:, :3] @ pose.rotation[:, 2] for force, pose in pairs]
        self.directions = np.concatenate(parts)
        self.data = self._with_errors(self.data)

    def _set_places(self, first: Int[np.ndarray, " places"]) -> None:
        """Find the contact point of each place, and the depth of each press."""
        mesh, presses, poses = self.recording.mesh, self.recording.presses, self._poses
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
        observations, stiffness = [], self._measured_stiffness()
        for observation in data.observations:
            error = _CONTACT_ERROR * float(np.linalg.norm(observation.values))
            scale = 1.0 / np.hypot(1.0 / observation.scale, error)
            observations.append(replace(observation, scale=scale))
        data = replace(data, observations=tuple(observations))
        deviations = stiffness * [pose.deviation_mm for pose in self._poses]
        sizes = deviations[self.press_of] * data.scale * self.directions
        if not sizes.any():
            return data
        rows = np.arange(len(sizes)), self.places[self.press_of]
        return replace(data, correlated=CorrelatedNoise(sp.csr_matrix((sizes, rows))))

    def _measured_stiffness(self) -> Float[np.ndarray, " presses"]:
        """Slope of the measured force by the depth at each press, N/mm."""
        forces = np.array([np.linalg.norm(force.values) for force in self._measured])
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
        observed = self.data.values * self.directions
        weights = self.data.scale**2
        products = float((weights * predicted * observed).sum())
        ratio = products / max(float((weights * predicted**2).sum()), 1e-300)
        if ratio <= 0.0:
            raise ConfigError(
                "The measured forces pull the ball into the object; give the force on the ball "
                "(N), in the axes of the mesh."
            )
        return ratio

    def evaluate(self, youngs: Moduli, *_near: Any, **_options: Any) -> PalpationEvaluation:
        """Return all presses at these moduli; the other arguments have no effect."""
        check_youngs(youngs, self.body.assembly.weights.shape)
        self.evaluations += 1
        body = self.indentation.at(youngs)
        return PalpationEvaluation(self, body, body.press(self.places, self.depths_mm), self.data)


def contacts_of(recording: Recording) -> list[tuple[int, ...]]:
    """Return the numbers of the presses of each contact, or of each place of a palpation."""
    if not is_palpation(recording):
        return group_by_contact(recording.presses)
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
    axes = np.array([pose.rotation[:, 2] for pose in poses])
    positions = np.array([pose.position_mm for pose in poses])
    across = positions - (positions * axes).sum(axis=1, keepdims=True) * axes
    for i, (pose, axis) in enumerate(zip(poses, np.round(axes, 6), strict=True)):
        same = keys.setdefault(axis.tobytes() + repr(pose.probe).encode(), [])
        apart = np.linalg.norm(across[same] - across[i], axis=1)
        near = np.flatnonzero(apart < _SAME_PLACE * pose.probe.sizes[0])
        if len(near):
            places[i] = places[same[near[0]]]
        else:
            places[i] = len(first)
            same.append(i)
            first.append(i)
    return places, np.array(first)
