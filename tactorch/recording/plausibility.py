"""Units by the look of the numbers: what no press of a soft object produces.

Everything inside is in mm, N and MPa. A file in other units is read without complaint by any
program that does not look at the magnitudes, and ruins the result by factors of a thousand. The
limits below lie well outside what soft objects do, so that only a wrong unit (or a broken file)
crosses them:

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
soft tissue and silicones are at 1e-3 to 10 MPa. Who does record such a thing (infinitesimal loads
in a convergence study, say) builds the recording with `check_units=False`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactorch.errors import RecordingError
from tactorch.recording.press import Press

SMALLEST_DIAGONAL_MM = 0.5
LARGEST_DIAGONAL_MM = 2e4
SMALLEST_RELATIVE_DISPLACEMENT = 1e-4
LARGEST_FORCE_N = 1e4
APPARENT_MODULUS_MPA = (1e-6, 100.0)
TRUE_MODULUS_MPA = (1e-6, 100.0)
_OPT_OUT = "If the numbers are right, pass check_units=False"


def check_units(
    diagonal_mm: float, presses: Sequence[Press], truth: Float[np.ndarray, " m"] | None
) -> None:
    """Refuse magnitudes that suggest a wrong unit; the limits are in the module's docstring.

    Args:
        diagonal_mm: Diagonal of the mesh's bounding box, mm.
        presses: The presses of the recording.
        truth: True Young's modulus per element, MPa, or None.

    Raises:
        RecordingError: Names the value, the suspected unit and what to do.
    """
    _check_diagonal(diagonal_mm)
    for press in presses:
        _check_force(press)
        _check_large_displacement(press, diagonal_mm)
    _check_small_displacement(presses, diagonal_mm)
    for press in presses:
        _check_apparent_modulus(press, diagonal_mm)
    if truth is not None:
        _check_truth(truth)


def _check_diagonal(diagonal: float) -> None:
    if diagonal < SMALLEST_DIAGONAL_MM:
        raise RecordingError(
            f"mesh: its diagonal is {diagonal:.3g} mm; metres given for millimetres? "
            f"Read it with unit='m', or multiply points by 1000. {_OPT_OUT}"
        )
    if diagonal > LARGEST_DIAGONAL_MM:
        raise RecordingError(
            f"mesh: its diagonal is {diagonal:.3g} mm; micrometres given for millimetres? "
            f"Divide points by 1000. {_OPT_OUT}"
        )


def _check_force(press: Press) -> None:
    largest = float(np.linalg.norm(press.forces, axis=1).max())
    if largest > LARGEST_FORCE_N:
        raise RecordingError(
            f"{press.label}: forces reach {largest:.3g} N at one node; mN given for N, or a "
            f"pressure in Pa or kPa taken for MPa? Convert forces to N. {_OPT_OUT}"
        )


def _check_large_displacement(press: Press, diagonal: float) -> None:
    largest = largest_displacement(press)
    if largest > diagonal:
        raise RecordingError(
            f"{press.label}: displacement reaches {largest:.3g} mm, more than the whole object "
            f"({diagonal:.3g} mm across); micrometres given for millimetres, a mesh in another "
            f"unit, or deformed positions given for displacements? Convert to mm. {_OPT_OUT}"
        )


def _check_small_displacement(presses: Sequence[Press], diagonal: float) -> None:
    largest = max(largest_displacement(press) for press in presses)
    if largest < SMALLEST_RELATIVE_DISPLACEMENT * diagonal:
        raise RecordingError(
            f"presses: no displacement exceeds {largest:.3g} mm on an object {diagonal:.3g} mm "
            "across; metres given for millimetres, or nothing moved? Multiply displacements by "
            f"1000 if they are in metres. {_OPT_OUT}"
        )


def _check_apparent_modulus(press: Press, diagonal: float) -> None:
    force = float(np.linalg.norm(press.forces, axis=1).sum())
    moved = largest_displacement(press)
    if force == 0 or moved == 0:
        return
    apparent = force / (moved * diagonal)
    low, high = APPARENT_MODULUS_MPA
    if low <= apparent <= high:
        return
    unit = "mN, or pressures in kPa, given for N" if apparent > high else "kN given for N"
    raise RecordingError(
        f"{press.label}: forces of {force:.3g} N move it {moved:.3g} mm, as if its modulus were "
        f"about {apparent:.1g} MPa, which no soft object has; {unit}, or displacements in another "
        f"unit than mm? Convert to N and mm. {_OPT_OUT}"
    )


def _check_truth(truth: Float[np.ndarray, " m"]) -> None:
    middle = float(np.median(truth))
    low, high = TRUE_MODULUS_MPA
    if low <= middle <= high:
        return
    unit = "GPa" if middle < low else "Pa" if middle > 1e3 * high else "kPa"
    raise RecordingError(
        f"truth: its median is {middle:.3g} MPa; {unit} given for MPa? Convert to MPa. {_OPT_OUT}"
    )


def largest_displacement(press: Press) -> float:
    """Largest displacement of a node over its observed components, mm."""
    seen = np.where(press.observed, press.displacement, 0.0)
    return float(np.linalg.norm(seen, axis=1).max())
