"""The presses of a palpation with smooth errors of the forces, and fits of shapes to them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.inverse.data import DataModel
from tactorch.inverse.fields import Sites
from tactorch.inverse.palpation import PalpationProblem
from tactorch.inverse.settings import Settings
from tactorch.inverse.shapes.fit import ShapeFit, fit_shapes
from tactorch.inverse.shapes.model import Model, Start
from tactorch.inverse.shapes.smooth_errors import (
    border_distances,
    correlation_length,
    smooth_error_patterns,
)
from tactorch.recording import Recording

_DEEPEST = 1.0  # centre of an inclusion, over the correlation length of smooth errors
_BORDER = 2.0  # distance from the border where errors are larger, over the ball's radius


class PalpationPresses:
    """The presses of a palpation with one type of elements.

    Args:
        recording: The presses.
        settings: Noise, solver and equilibrium search are used.
        element: Element type.

    Attributes:
        problem: The presses without smooth errors.
        sites: Volumes of the quadrature points.
    """

    def __init__(self, recording: Recording, settings: Settings, element: str) -> None:
        self.problem = PalpationProblem(
            recording, element=element, solver=settings.solver, noise=settings.noise,
            newton=settings.newton,
        )  # fmt: skip
        self.sites = Sites.of(self.problem.body.assembly)
        self._known = {0.0: self.problem.data}

    @property
    def white(self) -> DataModel:
        """The data without errors that they have in common."""
        return replace(self.problem.data, correlated=None)

    def data(self, level: float) -> DataModel:
        """Return the data with smooth errors of the forces of a relative deviation."""
        if level not in self._known:
            self._known[level] = self.problem.data.with_errors(level * self._patterns)
        return self._known[level]

    def fit(
        self,
        start: Start,
        tolerance: float,
        max_steps: int,
        give_up: Callable[[ShapeFit, float], bool],
    ) -> Model:
        """Fit a model; see `fit_shapes`."""
        fit, evaluation = fit_shapes(
            self.problem.with_data(self.data(start.errors.forces)), start.field, start.z,
            sites=self.sites, tolerance=tolerance, max_iterations=max_steps, give_up=give_up,
        )  # fmt: skip
        return Model(fit, evaluation, start.errors)

    @cached_property
    def place_of(self) -> np.ndarray:
        """Place of each datum."""
        return self.problem.places[self.problem.press_of]

    @cached_property
    def _contacts(self) -> Float[np.ndarray, "places 3"]:
        return np.array([place.contact_mm for place in self.problem.indentation.places])

    @cached_property
    def _patterns(self) -> Float[np.ndarray, "data k"]:
        """Patterns of smooth errors of relative deviation one, at the best uniform modulus."""
        problem = self.problem
        uniform = problem.evaluate(np.full(problem.n_elements, problem.contact_mpa))
        forces = np.concatenate(uniform.predicted) * problem.data.scale
        border = _BORDER * float(np.median(problem.indentation.balls_mm))
        depths = problem.depths_mm[problem.press_of]
        return smooth_error_patterns(self._contacts, self.place_of, depths, forces, border)

    def are_resolved(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether an inclusion at each point can be told from smooth errors.

        It cannot be where the place above it is at the border of the palpated area, nor deeper than
        the correlation length of the errors: its effect at the surface is as wide as it is deep.
        """
        contacts = self._contacts
        normal = np.mean([place.normal for place in self.problem.indentation.places], axis=0)
        normal = normal / np.linalg.norm(normal)
        flat = np.eye(3) - np.outer(normal, normal)
        above = cKDTree(contacts @ flat).query(points @ flat)[1]
        depths = (contacts[above] - points) @ normal
        shallow = depths < _DEEPEST * correlation_length(contacts)
        resolved: np.ndarray = shallow & (border_distances(contacts)[above] > 0.0)
        return resolved
