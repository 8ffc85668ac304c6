"""One press: loads and supports of a soft object, and how its surface was seen to move."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError
from tactorch.recording.arrays import bool_array, real_array, require_finite

# Stands for "not given" where a default needs the number of nodes; replaced on construction, so
# that the field always holds an array.
_NONE_GIVEN: Any = None


@dataclass(frozen=True, eq=False)
class Press:
    """One press, as arrays over the n nodes of the mesh and their three degrees of freedom.

    Arrays are copied to float64 (or bool). Displacement is set to NaN wherever it was not
    observed, and `prescribed` to zero wherever nothing is fixed.

    Attributes:
        forces: External nodal forces, (n, 3), N.
        observed: Degrees of freedom whose displacement was measured, (n, 3).
        displacement: Measured displacement, (n, 3), mm; NaN where not observed.
        springs: Stiffness of zero-length springs that hold the object, (n, 3), N/mm; 0 where
            there is none. A spring pulls back with stiffness times displacement.
        fixed: Degrees of freedom held exactly, (n, 3); default none.
        prescribed: Displacement of the fixed degrees of freedom, (n, 3), mm; default zero.
        noise_mm: Standard deviation of the noise of `displacement`, mm; None where unknown, 0 for
            exact data.
        weights: Relative weights of the observed degrees of freedom, (n, 3), or None for equal.
        step: Load step within presses of one kind: 0 for the lightest.
        direction: Unit vector of the push, (3,), or None.
        name: What to call the press in messages and reports.

    Raises:
        RecordingError: A field that is inconsistent with the others, naming press and field.
    """

    forces: Float[np.ndarray, "n 3"]
    observed: Bool[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]
    springs: Float[np.ndarray, "n 3"] = _NONE_GIVEN
    fixed: Bool[np.ndarray, "n 3"] = _NONE_GIVEN
    prescribed: Float[np.ndarray, "n 3"] = _NONE_GIVEN
    noise_mm: float | None = None
    weights: Float[np.ndarray, "n 3"] | None = None
    step: int = 0
    direction: Float[np.ndarray, "3"] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Convert, complete and check every field."""
        self._set("forces", real_array(self.forces, (None, 3), self._of("forces")))
        for field, dtype in (("springs", float), ("prescribed", float), ("fixed", bool)):
            if getattr(self, field) is None:
                self._set(field, np.zeros(self.forces.shape, dtype=dtype))
        self._convert_arrays()
        self._convert_scalars()
        self._check_values()
        self._set("displacement", np.where(self.observed, self.displacement, np.nan))
        self._set("prescribed", np.where(self.fixed, self.prescribed, 0.0))

    @property
    def n_points(self) -> int:
        """Number of mesh nodes that the arrays are over."""
        return len(self.forces)

    @property
    def held(self) -> Bool[np.ndarray, "n 3"]:
        """Degrees of freedom that a spring or a fixation holds, (n, 3)."""
        return self.fixed | (self.springs > 0)

    @property
    def data(self) -> Bool[np.ndarray, "n 3"]:
        """Observed degrees of freedom that may move, (n, 3): those that carry information."""
        return self.observed & ~self.fixed

    @property
    def total_force(self) -> Float[np.ndarray, "3"]:
        """Sum of the nodal forces, (3,), N."""
        return self.forces.sum(axis=0)

    def validate(self, n_points: int) -> None:
        """Check the press against a mesh of `n_points` nodes.

        Raises:
            RecordingError: The arrays are over another number of nodes.
        """
        if self.n_points != n_points:
            raise RecordingError(
                f"{self._of('forces')} is over {self.n_points} nodes but the mesh has {n_points}; "
                "use the mesh that the press was made with"
            )

    def _set(self, field: str, value: object) -> None:
        object.__setattr__(self, field, value)

    def _of(self, field: str) -> str:
        return f"{self.label}: {field}"

    @property
    def label(self) -> str:
        """The press as messages call it."""
        return f"press '{self.name}'" if self.name else "press"

    def _convert_arrays(self) -> None:
        shape = self.forces.shape
        for field in ("observed", "fixed"):
            self._set(field, bool_array(getattr(self, field), shape, self._of(field)))
        for field in ("displacement", "springs", "prescribed"):
            self._set(field, real_array(getattr(self, field), shape, self._of(field)))
        if self.weights is not None:
            self._set("weights", real_array(self.weights, shape, self._of("weights")))
        if self.direction is not None:
            self._set("direction", real_array(self.direction, (3,), self._of("direction")))

    def _convert_scalars(self) -> None:
        if self.noise_mm is not None:
            self._set("noise_mm", float(self.noise_mm))
            if not (np.isfinite(self.noise_mm) and self.noise_mm >= 0):
                raise RecordingError(
                    f"{self._of('noise_mm')} is {self.noise_mm}; give a standard deviation of at "
                    "least 0 mm, or None where it is unknown"
                )
        if self.step < 0:
            raise RecordingError(f"{self._of('step')} is {self.step}; count load steps from 0")

    def _check_values(self) -> None:
        self._check_observed()
        for field in ("forces", "springs"):
            require_finite(getattr(self, field), self._of(field))
        if (self.springs < 0).any():
            raise RecordingError(
                f"{self._of('springs')} has a negative stiffness ({self.springs.min():g} N/mm); "
                "stiffnesses are at least 0"
            )
        require_finite(np.where(self.fixed, self.prescribed, 0.0), self._of("prescribed"))
        if (np.nan_to_num(self.prescribed)[~self.fixed] != 0).any():
            raise RecordingError(
                f"{self._of('prescribed')} moves degrees of freedom that are not fixed; "
                "mark them in 'fixed' as well, or leave them at 0"
            )
        self._check_weights()
        self._check_direction()

    def _check_observed(self) -> None:
        if not self.observed.any():
            raise RecordingError(f"{self._of('observed')} is empty; mark what was measured")
        if not self.data.any():
            raise RecordingError(
                f"{self._of('observed')} names only degrees of freedom that are fixed, which carry "
                "no information; observe some that may move"
            )
        seen = np.where(self.observed, self.displacement, 0.0)
        require_finite(seen, self._of("displacement (where observed)"))

    def _check_weights(self) -> None:
        if self.weights is None:
            return
        require_finite(self.weights, self._of("weights"))
        if (self.weights < 0).any() or not (self.weights[self.data] > 0).any():
            raise RecordingError(
                f"{self._of('weights')} must be at least 0, and above 0 for some observed degree "
                "of freedom that may move"
            )

    def _check_direction(self) -> None:
        if self.direction is None:
            return
        require_finite(self.direction, self._of("direction"))
        length = float(np.linalg.norm(self.direction))
        if abs(length - 1.0) > 1e-6:
            raise RecordingError(
                f"{self._of('direction')} has length {length:g}; give a unit vector, or None"
            )
