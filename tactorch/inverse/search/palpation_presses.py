"""The presses of a palpation with smooth errors of the forces, and fits of shapes to them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.errors import ERRORS, ErrorModel, Levels, MeasuredPresses
from tactorch.inverse.errors.smooth_forces import border_distances, correlation_length
from tactorch.inverse.fields import Sites
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapeFit, fit_shapes
from tactorch.inverse.forward.palpation import PalpationProblem
from tactorch.inverse.search.model import Model, Start
from tactorch.recording import Recording

_DEEPEST = 1.0  # centre of an inclusion, over the correlation length of smooth errors


class PalpationPresses:
    """The presses of a palpation with one type of elements.

    Args:
        recording: The presses.
        settings: Noise, solver and equilibrium search are used.
        element: Element type.

    Attributes:
        problem: The presses without smooth errors.
        errors: Errors of the data that occur.
        sites: Volumes of the quadrature points.
    """

    def __init__(self, recording: Recording, settings: Settings, element: str) -> None:
        self.problem = PalpationProblem(
            recording, element=element, solver=settings.solver, noise=settings.noise,
            newton=settings.newton,
        )  # fmt: skip
        self.sites = Sites.of(self.problem.body.assembly)
        self.errors = ErrorModel(MeasuredPresses(self.problem), ERRORS)

    @property
    def white(self) -> DataModel:
        """The data without errors that they have in common."""
        return replace(self.problem.data, correlated=None)

    def data(self, errors: Levels) -> DataModel:
        """Return the data with these errors, linearised at the best uniform modulus."""
        if self.errors.lacks(errors):
            uniform = np.full(self.problem.n_elements, self.problem.contact_mpa)
            self.errors.linearise(self.problem.evaluate(uniform), "linear")
        return self.errors.data(errors)

    def fit(
        self,
        start: Start,
        tolerance: float,
        max_steps: int,
        give_up: Callable[[ShapeFit, float], bool],
    ) -> Model:
        """Fit a model; see `fit_shapes`."""
        fit, evaluation = fit_shapes(
            self.problem.with_data(self.data(start.errors)), start.field, start.z,
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
