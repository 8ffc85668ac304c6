"""One press: loads and supports of a soft object, and the measured motion of its surface."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any
from weakref import ref

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError
from tactorch.recording.arrays import make_array, require_finite
from tactorch.recording.readings import (
    ForceReading,
    GelReading,
    PressErrors,
    ProbePose,
    SurfaceReading,
)
from tactorch.recording.schema import PRESS_ARRAYS

# Default of arrays whose size is the number of nodes; replaced by zeros on construction, so that
# the field always holds an array.
_ZEROS: Any = None
# Kind and shareable fields of the press that was checked last: those of a recording often have the
# same, and are not checked again.
_LAST: list[tuple[tuple[bool, ...], tuple[ref[np.ndarray], ...]]] = [((), ())]


@dataclass(frozen=True, eq=False)
class Press:
    """One press, as arrays over the n nodes of the mesh and their three degrees of freedom.

    Nodal forces, prescribed displacements or a rigid probe load the object; displacements of nodes,
    displacements along directions or forces on the probe are the data.

    Arrays are copied to float64 (or bool), unless they are read-only. Displacement is set to NaN
    where it was not observed, and `prescribed` to zero where nothing is fixed.

    Attributes:
        forces: External nodal forces, (n, 3), N.
        observed: Degrees of freedom whose displacement was measured, (n, 3).
        displacement: Measured displacement, (n, 3), mm; NaN where not observed.
        springs: Stiffness of zero-length springs that support the object, (n, 3), N/mm; default
            zero. The force of a spring is minus stiffness times displacement.
        fixed: Degrees of freedom with prescribed displacement, (n, 3); default none.
        prescribed: Displacement of the fixed degrees of freedom, (n, 3), mm; default zero.
        noise_mm: Standard deviation of the noise of `displacement`, mm; None where unknown, 0 for
            exact data.
        weights: Relative weights of the observed degrees of freedom, (n, 3), or None for equal.
        step: Load step within presses of one kind: 0 for the lightest.
        direction: Unit vector of the push, (3,), or None.
        name: Name of the press in messages and reports.
        probe: Rigid probe at a prescribed pose, or None.
        force: Measured force on the probe, on the gel, or on the support that is moved, or None.
        surface: Measured displacements along directions at points of the surface, or None.
        errors: Correlated errors of `forces` and `displacement`, besides the noise, or None.
        gel: Gel of a sensor from whose markers `forces` and `displacement` are computed, or on
            which `force` is measured, or None.

    Raises:
        RecordingError: A field is inconsistent with the others; the message names press and field.
    """

    forces: Float[np.ndarray, "n 3"]
    observed: Bool[np.ndarray, "n 3"]
    displacement: Float[np.ndarray, "n 3"]
    springs: Float[np.ndarray, "n 3"] = _ZEROS
    fixed: Bool[np.ndarray, "n 3"] = _ZEROS
    prescribed: Float[np.ndarray, "n 3"] = _ZEROS
    noise_mm: float | None = None
    weights: Float[np.ndarray, "n 3"] | None = None
    step: int = 0
    direction: Float[np.ndarray, "3"] | None = None
    name: str = ""
    probe: ProbePose | None = None
    force: ForceReading | None = None
    surface: SurfaceReading | None = None
    errors: PressErrors | None = None
    gel: GelReading | None = None

    def __post_init__(self) -> None:
        self._convert("forces", (None, 3))
        shape = self.forces.shape
        for field, dtype in (("springs", float), ("prescribed", float), ("fixed", bool)):
            if getattr(self, field) is None:
                self._set(field, np.zeros(shape, dtype=dtype))
        for field in ("observed", "fixed"):
            self._convert(field, shape, "b")
        for field in ("displacement", "springs", "prescribed", "weights"):
            self._convert(field, shape)
        self._convert("direction", (3,))
        if self.noise_mm is not None:
            self._set("noise_mm", float(self.noise_mm))
            if not (np.isfinite(self.noise_mm) and self.noise_mm >= 0):
                raise self._error(
                    f"noise_mm is {self.noise_mm}; give a standard deviation of at least 0 mm, or"
                    " None where it is unknown"
                )
        if self.step < 0:
            raise self._error(f"step is {self.step}; count load steps from 0")
        self._check_direction()
        if not self._is_as_last():
            self._check_nodal()
            _LAST[0] = self._kind, tuple(map(ref, self._shareable))

    def _check_nodal(self) -> None:
        self._check_observed()
        numbers = {field: getattr(self, field) for field in ("forces", "springs", "weights")}
        numbers["displacement (where observed)"] = np.where(self.observed, self.displacement, 0.0)
        numbers["prescribed"] = np.where(self.fixed, self.prescribed, 0.0)
        for name, values in numbers.items():
            if values is not None:
                require_finite(values, f"{self.label}: {name}")
        self._check_loads()
        self._check_weights()
        self._set("displacement", _only(self.observed, self.displacement, "displacement"))
        moved = self.fixed & (self.prescribed != 0.0)
        self._set("prescribed", _only(moved, self.prescribed, "prescribed"))

    @staticmethod
    def by_probe(
        probe: ProbePose,
        n_points: int,
        *,
        force: ForceReading | None = None,
        surface: SurfaceReading | None = None,
        **fields: Any,
    ) -> "Press":
        """Return a press by a probe, without nodal forces and observed nodes.

        Its constant arrays take no memory, and read-only arrays are shared: a thousand presses may
        have the same supports.

        Args:
            probe: The probe and its pose.
            n_points: Number of nodes of the mesh.
            force: Measured force on the probe.
            surface: Measured displacements along directions at points of the surface.
            fields: Further fields, such as `fixed`, `springs`, `step` and `name`.
        """
        constant = {name: constant_field(name, n_points) for name in PRESS_ARRAYS}
        return Press(**{**constant, **fields}, probe=probe, force=force, surface=surface)

    @property
    def held(self) -> Bool[np.ndarray, "n 3"]:
        """Supported degrees of freedom, by a spring or fixed, (n, 3)."""
        return self.fixed | (self.springs > 0)

    @property
    def data(self) -> Bool[np.ndarray, "n 3"]:
        """Observed degrees of freedom that are not fixed, (n, 3): those that carry information."""
        return self.observed & ~self.fixed

    @property
    def has_readings(self) -> bool:
        """Whether there are data that are not displacements of nodes."""
        return self.force is not None or self.surface is not None

    def readings_bytes(self) -> bytes:
        """Return bytes that distinguish probes and readings; none without."""
        return self.geometry_bytes() + b"".join(
            array.tobytes()
            for reading in (self.force, self.surface, self.errors, self.gel)
            if reading is not None
            for array in vars(reading).values()
        )

    def geometry_bytes(self) -> bytes:
        """Return bytes that distinguish probes, and what is measured; none without."""
        parts: list[Any] = []
        if (pose := self.probe) is not None:
            parts += [repr(pose.probe), pose.position_mm, pose.rotation]
            parts += [f"{pose.deviation_mm!r}"] if pose.deviation_mm else []
        if self.force is not None:
            parts += ["force", self.force.axes, self.force.about_mm]
        if self.surface is not None:
            parts += ["surface", self.surface.points_mm, self.surface.directions]
        return b"".join(p.encode() if isinstance(p, str) else p.tobytes() for p in parts)

    @property
    def total_force(self) -> Float[np.ndarray, "3"]:
        """Sum of the nodal forces, (3,), N; of a probe or gel the measured force on the object.

        Components that were not measured are zero.
        """
        total = self.forces.sum(axis=0)
        if (self.probe is None and self.gel is None) or self.force is None:
            return total
        axes = self.force.axes[:, :3]
        return total - np.linalg.lstsq(axes, self.force.values, rcond=None)[0]

    @property
    def label(self) -> str:
        """The press as messages name it."""
        return f"press '{self.name}'" if self.name else "press"

    @property
    def largest_displacement(self) -> float:
        """Largest displacement of a node over its observed components, mm."""
        observed = np.where(self.observed, self.displacement, 0.0)
        largest = float(np.linalg.norm(observed, axis=1).max())
        if self.surface is not None:
            largest = max(largest, float(np.abs(self.surface.displacement_mm).max()))
        return largest

    def validate(self, n_points: int) -> None:
        """Raise `RecordingError` if the arrays are not over `n_points` mesh nodes."""
        if len(self.forces) != n_points:
            raise self._error(
                f"forces is over {len(self.forces)} nodes but the mesh has {n_points}; use the mesh"
                " that the press was made with"
            )
        if self.errors is not None and self.errors.nodes.max(initial=-1) >= n_points:
            raise self._error(
                f"errors: nodes has {self.errors.nodes.max()} but the mesh has {n_points} nodes;"
                " use the mesh that the press was made with"
            )

    def _set(self, field: str, value: object) -> None:
        object.__setattr__(self, field, value)

    def _error(self, complaint: str) -> RecordingError:
        return RecordingError(f"{self.label}: {complaint}")

    def _convert(self, field: str, shape: tuple[int | None, ...], kinds: str = "fiu") -> None:
        value = getattr(self, field)
        if value is not None or field in ("forces", "observed", "displacement"):
            self._set(field, make_array(value, shape, f"{self.label}: {field}", kinds))

    @property
    def _kind(self) -> tuple[bool, ...]:
        without = (getattr(self, name) is None for name in ("probe", "force", "gel"))
        return self.has_readings, *without

    @property
    def _shareable(self) -> list[np.ndarray]:
        """Nodal fields if all are read-only, so that other presses may have the same."""
        fields = [getattr(self, name) for name in PRESS_ARRAYS]
        own = self.weights is not None or any(field.flags.writeable for field in fields)
        return [] if own else fields

    def _is_as_last(self) -> bool:
        """Return whether kind and nodal fields are those of the press that was checked last."""
        (kind, last), fields = _LAST[0], self._shareable
        same = kind == self._kind and len(last) == len(fields) > 0
        return same and all(a() is b for a, b in zip(last, fields, strict=True))

    def _check_observed(self) -> None:
        moves = self.probe is not None or self.gel is not None
        if self.force is not None and not moves and not np.nan_to_num(self.prescribed).any():
            raise self._error(
                "force is measured, but there is no probe and no support is moved; give 'probe' or"
                " 'prescribed'"
            )
        if self.gel is not None and (self.force is None) == (not len(self.gel.markers_mm)):
            has = "no markers and no force is" if self.force is None else "markers and a force is"
            raise self._error(f"the gel has {has} measured; give one of both")
        if self.has_readings:
            return
        if not self.observed.any():
            raise self._error("observed is empty; mark what was measured")
        if not self.data.any():
            raise self._error(
                "observed names only degrees of freedom that are fixed, which carry no"
                " information; observe some that may move"
            )

    def _check_loads(self) -> None:
        if (self.springs < 0).any():
            raise self._error(
                f"springs has a negative stiffness ({self.springs.min():g} N/mm); stiffnesses are"
                " at least 0"
            )
        if (np.nan_to_num(self.prescribed)[~self.fixed] != 0).any():
            raise self._error(
                "prescribed moves degrees of freedom that are not fixed; mark them in 'fixed' as"
                " well, or leave them at 0"
            )

    def _check_weights(self) -> None:
        weights = self.weights
        unused = weights is not None and not (weights[self.data] > 0).any()
        if weights is not None and ((weights < 0).any() or (unused and not self.has_readings)):
            raise self._error(
                "weights must be at least 0, and above 0 for some observed degree of freedom that"
                " may move"
            )

    def _check_direction(self) -> None:
        if self.direction is not None:
            require_finite(self.direction, f"{self.label}: direction")
            length = float(np.linalg.norm(self.direction))
            if abs(length - 1.0) > 1e-6:
                raise self._error(f"direction has length {length:g}; give a unit vector, or None")


def distinct(presses: Iterable[Press]) -> list[Press]:
    """Return the first of presses that share their nodal fields and have no other displacements."""
    seen: dict[Any, Press] = {}
    for index, press in enumerate(presses):
        by_nodes = press.probe is None or press.surface is not None
        fields = () if by_nodes else tuple(map(id, press._shareable))
        seen.setdefault(fields or index, press)
    return list(seen.values())


@lru_cache(64)
def constant_field(name: str, n_points: int) -> np.ndarray:
    """Return a nodal field without values, of a press by a probe; it takes no memory."""
    return np.broadcast_to(np.array(PRESS_ARRAYS[name]), (n_points, 3))


def _only(
    mask: Bool[np.ndarray, "n 3"], values: Float[np.ndarray, "n 3"], name: str
) -> Float[np.ndarray, "n 3"]:
    """Return values where the mask is set, and the constant of the field elsewhere."""
    if not mask.any():
        return constant_field(name, len(mask))
    result = np.where(mask, values, PRESS_ARRAYS[name])
    same = not values.flags.writeable and np.array_equal(values, result, equal_nan=True)
    return values if same else result
