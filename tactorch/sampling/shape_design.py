"""Expected error of a map of shapes after a further press, and of lumps that no press has shown.

Data and map are linearised about the shapes. A further press adds its information on their
parameters; the error that remains is the variance of the map (A-optimality: K. Chaloner and I.
Verdinelli, "Bayesian experimental design: a review", Statist. Sci. 10 (1995), 273-304). A lump
elsewhere, of a few sizes and a given contrast, remains unknown where its signal is small: its error
counts with the probability that a matched filter misses it.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from tactorch.errors import ConfigError
from tactorch.inverse.fields import CENTER, ShapeField, Sites
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.matched import Balls
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import lattice
from tactorch.sampling.rules import Jacobian, Rule, SamplingState

Predicted: TypeAlias = Sequence[Float[np.ndarray, "_ m"] | None]
Errors: TypeAlias = Float[np.ndarray, " candidates"]

_SAMPLES = 3  # along the edge of an element
_WIDTH = 0.5  # of a boundary, over the cube root of the element's volume, for derivatives
_LOG_CONTRAST = float(np.log(3.0))  # of a lump that was not seen
_SEEN = 5.0  # signal, in standard deviations, at which half of all lumps are seen
_EXPECTED_LUMPS = 1.0  # number of lumps before the first press


@dataclass(frozen=True, eq=False)
class ShapeDesign:
    """What the presses so far say of shapes and of lumps elsewhere.

    Attributes:
        shapes: Shapes that are fitted to the presses so far.
        mesh: Mesh of the recording.
        before: Derivatives of the data of these presses by the logarithm of each element's modulus,
            in standard deviations of the noise.
    """

    shapes: ShapeReconstruction
    mesh: TetMesh
    before: Float[np.ndarray, "data m"]

    def expected_errors(self, candidates: Predicted) -> Errors:
        """Return the mean squared error of log E over the body that is expected after each press.

        Args:
            candidates: Derivatives of the data of each press, as in `before`; None where it cannot
                be carried out, whose error is infinite.
        """
        return self._each(candidates, self._expected_error)

    def expected_center_deviations(self, candidates: Predicted) -> Errors:
        """Return the deviation of the first inclusion's centre that is expected after each press.

        It is that along the axis where it is largest, mm. See `expected_errors`.
        """
        return self._each(candidates, self._center_deviation)

    def expected_missed_errors(self, candidates: Predicted) -> Errors:
        """Return the expected error by lumps that no press has shown, after each press.

        See `expected_errors`.
        """
        return self._each(candidates, self._missed_error)

    def _each(self, candidates: Predicted, score: Callable[["_Gram"], float]) -> Errors:
        now = self._gram(self.before)
        return np.array([np.inf if j is None else score(now + self._gram(j)) for j in candidates])

    def _gram(self, jacobian: Jacobian) -> "_Gram":
        """Return the products for data whose noise is as large as the residuals of the shapes."""
        return _Gram.of(jacobian / np.sqrt(max(1.0, self.shapes.chi2)), self._columns)

    def _expected_error(self, gram: "_Gram") -> float:
        known = float(np.trace(np.linalg.solve(gram.precision, self._map_products)))
        return known + self._missed_error(gram)

    def _center_deviation(self, gram: "_Gram") -> float:
        center = self._field.index(self.shapes.order[0], *CENTER)
        variances = np.linalg.inv(gram.precision).diagonal()[center]
        return float((self._field.deviation[center] * np.sqrt(variances)).max())

    def _missed_error(self, gram: "_Gram") -> float:
        """Return the expected error by lumps that are not seen."""
        known = np.einsum("sb,sb->b", gram.mixed, np.linalg.solve(gram.precision, gram.mixed))
        signal = _LOG_CONTRAST * np.sqrt(np.maximum(gram.balls - known, 0.0))
        missed = ndtr(_SEEN - signal)
        shares = 4.0 / 3.0 * np.pi * self._balls.radii**3 / self.mesh.volumes.sum()
        return float(_EXPECTED_LUMPS * np.mean(missed * (shares * _LOG_CONTRAST**2)))

    @property
    def _field(self) -> ShapeField:
        return self.shapes.posterior.field

    @cached_property
    def _columns(self) -> tuple[Float[np.ndarray, "m size"], Float[np.ndarray, "m balls"]]:
        """Derivatives of elements' log-moduli by the shapes' parameters, and lumps elsewhere."""
        points = np.einsum("qc,mcd->mqd", lattice(_SAMPLES), self.mesh.points[self.mesh.tets])
        elements = Sites(points, _WIDTH * np.cbrt(self.mesh.volumes), (self.mesh.n_tets, 1))
        return self._field.jacobian(self.shapes.posterior.z, elements), self._balls.fractions

    @cached_property
    def _map_products(self) -> Float[np.ndarray, "size size"]:
        """Mean over the body of the products of the derivatives of log E by the parameters."""
        columns, volumes = self._columns[0], self.mesh.volumes
        return np.asarray((columns.T * volumes / volumes.sum()) @ columns)

    @cached_property
    def _balls(self) -> Balls:
        return Balls.of(self.mesh)


@dataclass(frozen=True, eq=False)
class _Gram:
    """Products of the derivatives of the data by the shapes' parameters and by lumps elsewhere."""

    shapes: Float[np.ndarray, "size size"]
    mixed: Float[np.ndarray, "size balls"]
    balls: Float[np.ndarray, " balls"]

    @staticmethod
    def of(jacobian: Jacobian, columns: tuple[np.ndarray, np.ndarray]) -> "_Gram":
        shapes, balls = (jacobian @ each for each in columns)
        return _Gram(shapes.T @ shapes, shapes.T @ balls, np.einsum("db,db->b", balls, balls))

    @property
    def precision(self) -> Float[np.ndarray, "size size"]:
        """Precision of the parameters, whose prior deviation is one."""
        return self.shapes + np.eye(len(self.shapes))

    def __add__(self, other: "_Gram") -> "_Gram":
        return _Gram(self.shapes + other.shapes, self.mixed + other.mixed, self.balls + other.balls)


class ShapeRule(Rule):
    """Rule that takes the press after which an error of the shapes is expected to be smallest."""

    uses_shapes = True

    def choose(self, state: SamplingState) -> int:
        """See `Rule.choose`.

        Raises:
            ConfigError: no shapes were fitted to the presses.
        """
        shapes, known, per_log = state.shapes, state.known, state.per_log
        if shapes is None or known is None or per_log is None:
            raise ConfigError(
                "this rule needs shapes that are fitted to the presses, and there are none yet; "
                "wait for them (method=inclusions), or choose suggest.rule=auto."
            )
        design = ShapeDesign(shapes, state.mesh, known * per_log)
        predicted = [None if j is None else j * per_log for j in state.jacobians(state.remaining)]
        return state.remaining[int(np.argmin(self.expected(design, predicted)))]

    @abstractmethod
    def expected(self, design: ShapeDesign, candidates: Predicted) -> Errors:
        """Return the error after each press."""


@dataclass(frozen=True)
class ExpectedShapeError(ShapeRule):
    """Smallest expected error of the map of shapes, and of lumps that no press has shown yet.

    The error is the mean squared one of log E over the body, see `ShapeDesign`.
    """

    def expected(self, design: ShapeDesign, candidates: Predicted) -> Errors:
        return design.expected_errors(candidates)


@dataclass(frozen=True)
class LumpPosition(ShapeRule):
    """Most certain position of the lump; before one is found, least chance of missing one.

    The position is that of the most probable inclusion, along the axis where it is least certain.
    """

    def expected(self, design: ShapeDesign, candidates: Predicted) -> Errors:
        if design.shapes.inclusions:
            return design.expected_center_deviations(candidates)
        return design.expected_missed_errors(candidates)
