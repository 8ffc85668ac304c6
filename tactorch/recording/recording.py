"""A recording: a soft object, the presses on it, and further known facts."""

import json
import logging
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.display import Displayed
from tactorch.errors import FileError, RecordingError
from tactorch.hdf5 import write_hdf5
from tactorch.mesh import TetMesh
from tactorch.recording.arrays import make_array, require_finite
from tactorch.recording.material import MaterialSpec
from tactorch.recording.plausibility import check_units, free_motion
from tactorch.recording.press import Press, distinct
from tactorch.recording.storage import open_recording, write_recording

if TYPE_CHECKING:
    import pandas

_log = logging.getLogger(__name__)
_MAX_REGIONS = 12  # that a summary lists


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Displayed):
    """Input of a reconstruction. Units: mm, N, MPa, tonne/mm^3.

    Attributes:
        mesh: The object at rest, n nodes (mm) and m tetrahedra.
        presses: At least one press.
        material: The constitutive law without Young's modulus.
        truth: True Young's modulus per element, (m,), MPa, where it is known.
        reference: Another reconstruction, (m,), MPa, for comparison only.
        provenance: Origin of the data, as plain JSON values.
        density: Mass density, tonne/mm^3; None where weight is not modelled.
        gravity: Acceleration of gravity, (3,), mm/s^2; default zero.
        unloaded: Displacements reported by the sensor before contact, two frames or more,
            (frames, n, 3), mm; NaN where nothing was observed. The noise of presses
            that do not state theirs is estimated from it.
        check_units: Refuse magnitudes that suggest a wrong unit (`tactorch.recording.plausibility`
            lists the limits). Not stored.

    Raises:
        RecordingError: The parts do not fit each other, nothing supports or loads the object, or a
            value suggests a wrong unit.
    """

    mesh: TetMesh
    presses: tuple[Press, ...]
    material: MaterialSpec
    truth: Float[np.ndarray, " m"] | None = None
    reference: Float[np.ndarray, " m"] | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    density: float | None = None
    gravity: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    unloaded: Float[np.ndarray, "frames n 3"] | None = None
    check_units: InitVar[bool] = True

    def __post_init__(self, check_units_: bool) -> None:
        """Convert and check; the order puts the likeliest cause of an error first."""
        self._set("presses", tuple(self.presses))
        if not self.presses:
            raise RecordingError("presses is empty; a recording needs at least one press")
        self._check_moduli("truth")
        self._check_moduli("reference")
        self._set("provenance", _plain(self.provenance))
        self._check_weight()
        self._check_unloaded()
        for press in self.presses:
            press.validate(self.mesh.n_points)
        if check_units_:
            check_units(self.mesh.diagonal, distinct(self.presses), self.truth)
        self._check_loads_and_supports()

    def save(self, path: str | Path) -> None:
        """Write the recording to an HDF5 file (see `tactorch.recording.schema`), whole or not."""
        try:
            write_hdf5(path, lambda file: write_recording(file, vars(self)))
        except ValueError as error:
            raise FileError(
                f"cannot write recording '{path}': {error}; leave out text that HDF5 cannot hold, "
                "such as a name with a NUL in it"
            ) from error

    @classmethod
    def load(cls, path: str | Path, *, check_units: bool = True) -> "Recording":
        """Read a recording that `save` wrote.

        Raises:
            FileError: The file is missing, truncated or not HDF5.
            RecordingError: The file is HDF5 but not a valid recording; names the dataset.
        """
        with open_recording(path) as reader:
            fields = reader.fields()
            if reader.tail is not None and not reader.tail.complete:
                _log.warning(
                    "'%s' ends in an incomplete press, which is ignored: its writer was"
                    " interrupted, or the file was cut short.",
                    path,
                )
        try:
            return cls(**fields, check_units=check_units)
        except RecordingError as error:
            raise reader.error(f"is not consistent: {error}") from error

    def select(self, indices: Sequence[int]) -> "Recording":
        """Return the recording with only the presses at `indices` (from 0), in that order."""
        for index in indices:
            if not 0 <= index < len(self.presses):
                raise RecordingError(
                    f"press {index} does not exist: the recording has {len(self.presses)}, "
                    f"numbered 0 to {len(self.presses) - 1}"
                )
        selected = tuple(self.presses[index] for index in indices)
        return replace(self, presses=selected, check_units=False)

    def to_frame(self, *, interior: bool = False) -> "pandas.DataFrame":
        """Return the presses as a table, which `tactorch import format=table` reads.

        There is a row for each press and node of the surface, and for each displacement along a
        direction. The columns are

        | column | value |
        |---|---|
        | press | name of the press; with its index where names repeat or are empty |
        | step | load step |
        | node | number of the node; missing for displacements along a direction |
        | x_mm, y_mm, z_mm | rest position |
        | ux_mm, uy_mm, uz_mm | measured displacement; NaN where not observed |
        | fx_n, fy_n, fz_n | external force |
        | fixed_x, fixed_y, fixed_z | 1 where the node is fixed, else 0 |
        | spring_x_n_per_mm, ... | stiffness of the springs |
        | noise_mm | standard deviation of the displacements; NaN where unknown |
        | u_n_mm, nx, ny, nz | displacement along a direction; only where there are any |

        Prescribed displacements and weights are not in the table. Its `attrs` have the material.
        `to_frame().set_index(["press", "node"]).to_xarray()` gives a dataset of xarray.

        Args:
            interior: Whether nodes that are not on the surface have rows, too.

        Raises:
            ConfigError: pandas is not installed.
            RecordingError: A press is by a probe, or its force is measured.
        """
        from tactorch.recording.frame import to_frame

        return to_frame(self.mesh, self.presses, self.material, interior=interior)

    @property
    def has_probes(self) -> bool:
        """Whether some press is by a rigid probe."""
        return any(press.probe is not None for press in self.presses)

    def summary(self) -> str:
        """Return a description of the recording in a few lines of text."""
        size = " x ".join(f"{edge:.3g}" for edge in self.mesh.bounds[1] - self.mesh.bounds[0])
        presses, material = self.presses, self.material
        different = distinct(presses)
        known = [press.noise_mm for press in presses if press.noise_mm is not None]
        noise = f"{_range(known)} mm" if known else "unknown"
        if 0 < len(known) < len(presses):
            noise += f" (unknown for {len(presses) - len(known)})"
        supports = {
            "springs": any(press.springs.any() for press in different),
            "fixed nodes": any(press.fixed.any() for press in different),
        }
        parameters = "".join(f", {key} {value:g}" for key, value in material.parameters.items())
        force = _range([float(np.linalg.norm(press.total_force)) for press in presses])
        displacement = _range([press.largest_displacement for press in different])
        observed = _range([int(press.observed.sum()) for press in different])
        truth = "unknown" if self.truth is None else f"{_range(self.truth)} MPa"
        gravity = float(np.linalg.norm(self.gravity)) / 1000
        lines = [
            f"object: {size} mm, {self.mesh.n_points} nodes, {self.mesh.n_tets} tetrahedra",
            _regions(self.mesh.regions),
            f"presses: {len(presses)}, force {force} N, largest displacement {displacement} mm",
            f"observed: {observed} degrees of freedom a press, noise {noise}",
            _readings(presses),
            f"held by: {' and '.join(name for name, used in supports.items() if used)}",
            f"material: {material.name}, Poisson's ratio {material.poisson:g}{parameters}",
            f"truth: {truth}",
            "" if self.reference is None else f"reference: {_range(self.reference)} MPa",
            f"weight: {self.density:.3g} tonne/mm^3 under {gravity:.3g} m/s^2"
            if self.density and gravity
            else "",
        ]
        return "\n".join(filter(None, lines))

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _check_moduli(self, name: str) -> None:
        if getattr(self, name) is None:
            return
        what = f"{name} (one modulus per element)"
        array = make_array(getattr(self, name), (self.mesh.n_tets,), what)
        require_finite(array, name)
        if (array <= 0).any():
            where = int(np.argmin(array))
            raise RecordingError(
                f"{name} is {array[where]:g} MPa at element {where}; moduli are above 0. "
                "Give holes a small modulus, such as 0.001 MPa"
            )
        self._set(name, array)

    def _check_unloaded(self) -> None:
        if self.unloaded is None:
            return
        frames = len(self.unloaded)
        array = make_array(self.unloaded, (frames, self.mesh.n_points, 3), "unloaded")
        self._set("unloaded", array)
        if frames < 2:
            raise RecordingError("unloaded has one frame; noise takes two or more")
        if not np.isfinite(np.diff(array, axis=0)).any():
            raise RecordingError(
                "unloaded has no value that is finite in two consecutive frames; give the"
                " displacements that the sensor reported before contact, mm"
            )

    def _check_weight(self) -> None:
        self._set("gravity", make_array(self.gravity, (3,), "gravity"))
        require_finite(self.gravity, "gravity")
        if self.density is None:
            if self.gravity.any():
                raise RecordingError("gravity is given without density; give density in tonne/mm^3")
            return
        self._set("density", float(self.density))
        if not 0 <= self.density < 1e-6:
            raise RecordingError(
                f"density is {self.density:g} tonne/mm^3; kg/m^3 or g/cm^3 given? "
                "Water has 1e-9 tonne/mm^3"
            )

    def _check_loads_and_supports(self) -> None:
        weight = bool(self.density) and bool(self.gravity.any())
        motions: dict[bytes, str | None] = {}
        for press in distinct(self.presses):
            by_gel = press.gel is not None and press.force is not None
            moved = press.probe is not None or by_gel or press.prescribed.any()
            if not (weight or press.forces.any() or moved):
                raise RecordingError(
                    f"{press.label}: forces are all 0, nothing is prescribed and there is no "
                    "probe, so nothing presses the object; give its forces, or leave the press out"
                )
            key = press.held.tobytes()
            if key not in motions:
                motions[key] = free_motion(self.mesh.points, press.held)
            if motions[key] is not None:
                raise RecordingError(
                    f"{press.label}: nothing holds the object; it can {motions[key]}. "
                    "Fix more degrees of freedom, or give them springs"
                )


def _regions(regions: Int[np.ndarray, " m"] | None) -> str:
    """Return the numbers of elements of each region as text."""
    if regions is None:
        return ""
    numbers, counts = np.unique(regions, return_counts=True)
    shown = [f"{n} ({k} elements)" for n, k in zip(numbers, counts, strict=True)]
    more = f", and {len(shown) - _MAX_REGIONS} more" if len(shown) > _MAX_REGIONS else ""
    return f"regions: {', '.join(shown[:_MAX_REGIONS])}{more}"


def _readings(presses: Sequence[Press]) -> str:
    """Return the numbers of probes and of data that are not displacements of nodes, as text."""
    counts = {
        "presses by a probe": sum(p.probe is not None for p in presses),
        "components of force or moment": sum(len(p.force.values) for p in presses if p.force),
        "displacements along a direction": sum(
            len(p.surface.displacement_mm) for p in presses if p.surface
        ),
    }
    parts = [f"{count} {what}" for what, count in counts.items() if count]
    return f"readings: {', '.join(parts)}" if parts else ""


def _range(values: Sequence[float] | np.ndarray) -> str:
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _plain(provenance: dict[str, Any]) -> dict[str, Any]:
    """Return `provenance` as JSON would give it back, so that saving changes nothing."""
    try:
        plain = json.loads(json.dumps(provenance, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"provenance holds something that JSON cannot: {error}; use text, finite numbers, "
            "lists and dictionaries"
        ) from error
    if not isinstance(plain, dict):
        raise RecordingError(f"provenance is {provenance!r}; give a dictionary")
    return plain
