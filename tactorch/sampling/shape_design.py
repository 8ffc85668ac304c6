"""Expected error of a map of shapes after a further press, and of lumps that no press has shown.

Data and map are linearised about the shapes. A further press adds its information on their
parameters; the error that remains is the variance of the map (A-optimality: K. Chaloner and I.
Verdinelli, "Bayesian experimental design: a review", Statist. Sci. 10 (1995), 273-304). A lump
elsewhere, of a few sizes and a given contrast, remains unknown where its signal is small: its error
counts with the probability that a matched filter misses it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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

    def expected_errors(
        self, candidates: Sequence[Float[np.ndarray, "_ m"] | None]
    ) -> Float[np.ndarray, " candidates"]:
        """Return the mean squared error of log E over the body that is expected after each press.

        Args:
            candidates: Derivatives of the data of each press, as in `before`; None where it cannot
                be carried out, whose error is infinite.
        """
        now = self._gram(self.before)
        return np.array(
            [
                np.inf if jacobian is None else self._expected_error(now + self._gram(jacobian))
                for jacobian in candidates
            ]
        )  # fmt: skip

    def expected_center_deviations(
        self, candidates: Sequence[Float[np.ndarray, "_ m"] | None]
    ) -> Float[np.ndarray, " candidates"]:
        """Return the deviation of the first inclusion's centre that is expected after each press.

        It is that along the axis where it is largest, mm.

        Args:
            candidates: See `expected_errors`.
        """
        now = self._gram(self.before).shapes
        center = self._field.index(self.shapes.order[0], *CENTER)
        sizes = self._field.deviation[center]
        found = np.full(len(candidates), np.inf)
        for k, jacobian in enumerate(candidates):
            if jacobian is not None:
                precision = now + self._gram(jacobian).shapes + np.eye(self._field.size)
                variances = np.linalg.inv(precision).diagonal()[center]
                found[k] = float((sizes * np.sqrt(variances)).max())
        return found

    def expected_missed_errors(
        self, candidates: Sequence[Float[np.ndarray, "_ m"] | None]
    ) -> Float[np.ndarray, " candidates"]:
        """Return the expected error by lumps that no press has shown, after each press.

        Args:
            candidates: See `expected_errors`.
        """
        now, unit = self._gram(self.before), np.eye(self._field.size)
        found = np.full(len(candidates), np.inf)
        for k, jacobian in enumerate(candidates):
            if jacobian is not None:
                gram = now + self._gram(jacobian)
                found[k] = self._missed_error(gram, gram.shapes + unit)
        return found

    def _gram(self, jacobian: Jacobian) -> "_Gram":
        """Return the products for data whose noise is as large as the residuals of the shapes."""
        return _Gram.of(jacobian / np.sqrt(max(1.0, self.shapes.chi2)), self._columns)

    def _expected_error(self, gram: "_Gram") -> float:
        precision = gram.shapes + np.eye(self._field.size)
        known = float(np.trace(np.linalg.solve(precision, self._map_products)))
        return known + self._missed_error(gram, precision)

    def _missed_error(self, gram: "_Gram", precision: Float[np.ndarray, "size size"]) -> float:
        """Return the expected error by lumps that are not seen."""
        known = np.einsum("sb,sb->b", gram.mixed, np.linalg.solve(precision, gram.mixed))
        signal = _LOG_CONTRAST * np.sqrt(np.maximum(gram.balls - known, 0.0))
        missed = ndtr(_SEEN - signal)
        squares = self._ball_shares * _LOG_CONTRAST**2
        return float(_EXPECTED_LUMPS * np.mean(missed * squares))

    @property
    def _field(self) -> ShapeField:
        return self.shapes.posterior.field

    @property
    def _z(self) -> Float[np.ndarray, " size"]:
        return self.shapes.posterior.z

    @cached_property
    def _columns(self) -> tuple[Float[np.ndarray, "m size"], Float[np.ndarray, "m balls"]]:
        """Derivatives of elements' log-moduli by the shapes' parameters, and lumps elsewhere."""
        points = np.einsum("qc,mcd->mqd", lattice(_SAMPLES), self.mesh.points[self.mesh.tets])
        elements = Sites(points, _WIDTH * np.cbrt(self.mesh.volumes), (self.mesh.n_tets, 1))
        return self._field.jacobian(self._z, elements), self._balls.fractions

    @cached_property
    def _map_products(self) -> Float[np.ndarray, "size size"]:
        """Mean over the body of the products of the derivatives of log E by the parameters."""
        columns, volumes = self._columns[0], self.mesh.volumes
        return np.asarray((columns.T * volumes / volumes.sum()) @ columns)

    @cached_property
    def _balls(self) -> Balls:
        return Balls.of(self.mesh)

    @cached_property
    def _ball_shares(self) -> Float[np.ndarray, " balls"]:
        """Volume of each ball over that of the body."""
        return 4.0 / 3.0 * np.pi * self._balls.radii**3 / self.mesh.volumes.sum()


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

    def __add__(self, other: "_Gram") -> "_Gram":
        return _Gram(self.shapes + other.shapes, self.mixed + other.mixed, self.balls + other.balls)


@dataclass(frozen=True)
class ExpectedShapeError(Rule):
    """Smallest expected error of the map of shapes, and of lumps that no press has shown yet.

    The error is the mean squared one of log E over the body, see `ShapeDesign`.
    """

    uses_shapes = True

    def choose(self, state: SamplingState) -> int:
        """See `Rule.choose`.

        Raises:
            ConfigError: no shapes were fitted to the presses.
        """
        design, remaining, predicted = _design(state)
        return remaining[int(np.argmin(design.expected_errors(predicted)))]


@dataclass(frozen=True)
class LumpPosition(Rule):
    """Most certain position of the lump; before one is found, least chance of missing one.

    The position is that of the most probable inclusion, along the axis where it is least certain.
    """

    uses_shapes = True

    def choose(self, state: SamplingState) -> int:
        """See `Rule.choose`.

        Raises:
            ConfigError: no shapes were fitted to the presses.
        """
        design, remaining, predicted = _design(state)
        if design.shapes.inclusions:
            expected = design.expected_center_deviations(predicted)
        else:
            expected = design.expected_missed_errors(predicted)
        return remaining[int(np.argmin(expected))]


def _design(state: SamplingState) -> tuple[ShapeDesign, list[int], list[Jacobian | None]]:
    """Return the design, the candidates that remain, and their derivatives by log-moduli."""
    shapes, known, per_log = state.shapes, state.known, state.per_log
    if shapes is None or known is None or per_log is None:
        raise ConfigError(
            "this rule needs shapes that are fitted to the presses, and there are none yet; wait "
            "for them (method=inclusions), or choose suggest.rule=auto."
        )
    remaining = state.remaining
    predicted = [None if j is None else j * per_log for j in state.jacobians(remaining)]
    return ShapeDesign(shapes, state.mesh, known * per_log), remaining, predicted
