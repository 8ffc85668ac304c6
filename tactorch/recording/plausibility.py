"""Plausibility of a recording: magnitudes that indicate a wrong unit, and missing supports.

Units are mm, N and MPa. Values in other units would be read without complaint and change the
result by factors of a thousand. The limits are far outside what soft objects show, so that only a
wrong unit (or a damaged file) exceeds them:

| quantity | refused | suspected |
|---|---|---|
| diagonal of the mesh | below 0.5 mm | metres given for millimetres |
| diagonal of the mesh | above 20 000 mm | micrometres given for millimetres |
| largest displacement | above the diagonal | micrometres given for millimetres |
| largest displacement of all presses | below 1e-4 of the diagonal | metres given for millimetres |
| nodal force | above 1e4 N | mN, or Pa and kPa taken for MPa |
| force / (displacement x diagonal) | above 100 MPa | mN or kPa given for N or MPa |
| force / (displacement x diagonal) | below 1e-6 MPa | kN given for N |
| median of the true modulus | above 100 MPa | kPa (or Pa) given for MPa |
| median of the true modulus | below 1e-6 MPa | GPa given for MPa |

Force over displacement and diagonal is, up to a factor of the shape, the modulus of the object:
soft tissue and silicones have 1e-3 to 10 MPa. For other magnitudes (infinitesimal loads of a
convergence study, for instance) pass `check_units=False`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError
from tactorch.recording.press import Press

DIAGONAL_MM = (0.5, 2e4)
MIN_RELATIVE_DISPLACEMENT = 1e-4
MAX_FORCE_N = 1e4
MODULUS_MPA = (1e-6, 100.0)
_OPT_OUT = "If the numbers are right, pass check_units=False"
_MOTIONS = tuple(f"{kind} {axis}" for kind in ("slide along", "turn about") for axis in "xyz")
# Motions resisted by less than this fraction of the best-resisted one count as free.
_MIN_RESISTANCE = 1e-9


def check_units(
    diagonal: float, presses: Sequence[Press], truth: Float[np.ndarray, " m"] | None
) -> None:
    """Refuse magnitudes that suggest a wrong unit; the limits are in the module's docstring."""
    if diagonal < DIAGONAL_MM[0]:
        raise RecordingError(
            f"mesh: its diagonal is {diagonal:.3g} mm; metres given for millimetres? "
            f"Read it with unit='m', or multiply points by 1000. {_OPT_OUT}"
        )
    if diagonal > DIAGONAL_MM[1]:
        raise RecordingError(
            f"mesh: its diagonal is {diagonal:.3g} mm; micrometres given for millimetres? "
            f"Divide points by 1000. {_OPT_OUT}"
        )
    for press in presses:
        _check_press(press, diagonal)
    moved = [p for p in presses if p.observed.any() or p.surface is not None]
    largest = max((press.largest_displacement for press in moved), default=np.inf)
    if largest < MIN_RELATIVE_DISPLACEMENT * diagonal:
        raise RecordingError(
            f"presses: no displacement exceeds {largest:.3g} mm on an object {diagonal:.3g} mm "
            "across; metres given for millimetres, or nothing moved? Multiply displacements by "
            f"1000 if they are in metres. {_OPT_OUT}"
        )
    for press in moved:
        _check_apparent_modulus(press, diagonal)
    median = 1.0 if truth is None else float(np.median(truth))
    low, high = MODULUS_MPA
    if not low <= median <= high:
        unit = "GPa" if median < low else "Pa" if median > 1e3 * high else "kPa"
        raise RecordingError(
            f"truth: its median is {median:.3g} MPa; {unit} given for MPa? Convert to MPa. "
            f"{_OPT_OUT}"
        )


def free_motion(points: Float[np.ndarray, "n 3"], held: Bool[np.ndarray, "n 3"]) -> str | None:
    """Name a rigid motion that the supported degrees of freedom do not prevent, or return None.

    The object's rigid motions, scaled to its size, are restricted to the supported degrees of
    freedom; a combination that vanishes there is free. The name is that of its largest part.
    """
    if not held.any():
        return "move freely"
    # About the centre of the supports, the free turn about an axis through them has no translation.
    offsets = points - points[held.any(axis=1)].mean(axis=0)
    offsets = offsets / np.abs(offsets).max()
    turns = [np.cross(axis, offsets) for axis in np.eye(3)]
    slides = np.broadcast_to(np.eye(3), (len(points), 3, 3))
    modes = np.concatenate((slides, np.stack(turns, axis=-1)), axis=2)[held]
    _, values, vectors = np.linalg.svd(modes, full_matrices=True)
    rank = int((values > _MIN_RESISTANCE * values[0]).sum())
    return None if rank == 6 else _MOTIONS[int(np.argmax((vectors[rank:] ** 2).sum(axis=0)))]


def _check_press(press: Press, diagonal: float) -> None:
    force = float(np.linalg.norm(press.forces, axis=1).max())
    if force > MAX_FORCE_N:
        raise RecordingError(
            f"{press.label}: forces reach {force:.3g} N at one node; mN given for N, or a "
            f"pressure in Pa or kPa taken for MPa? Convert forces to N. {_OPT_OUT}"
        )
    largest = press.largest_displacement
    if largest > diagonal:
        raise RecordingError(
            f"{press.label}: displacement reaches {largest:.3g} mm, more than the whole object "
            f"({diagonal:.3g} mm across); micrometres given for millimetres, a mesh in another "
            f"unit, or deformed positions given for displacements? Convert to mm. {_OPT_OUT}"
        )


def _check_apparent_modulus(press: Press, diagonal: float) -> None:
    force = float(np.linalg.norm(press.forces, axis=1).sum())
    largest = press.largest_displacement
    if force == 0 or largest == 0:
        return
    modulus, (low, high) = force / (largest * diagonal), MODULUS_MPA
    if not low <= modulus <= high:
        unit = "mN, or pressures in kPa, given for N" if modulus > high else "kN given for N"
        raise RecordingError(
            f"{press.label}: forces of {force:.3g} N move it {largest:.3g} mm, as if its modulus"
            f" were about {modulus:.1g} MPa, which no soft object has; {unit}, or displacements in"
            f" another unit than mm? Convert to N and mm. {_OPT_OUT}"
        )
