"""Parts of a recording's summary, as text."""

from collections.abc import Sequence

import numpy as np

from tactorch.recording.material import MaterialSpec
from tactorch.recording.plausibility import largest_displacement
from tactorch.recording.press import Press


def describe_presses(presses: Sequence[Press]) -> list[str]:
    """Return lines about loads, observations and supports."""
    forces = [float(np.linalg.norm(press.total_force)) for press in presses]
    displacements = [largest_displacement(press) for press in presses]
    observed = [int(press.observed.sum()) for press in presses]
    springs = "springs" if any(press.springs.any() for press in presses) else ""
    fixed = "fixed nodes" if any(press.fixed.any() for press in presses) else ""
    return [
        f"presses: {len(presses)}, force {_range(forces)} N, "
        f"largest displacement {_range(displacements)} mm",
        f"observed: {_range(observed)} degrees of freedom a press, noise {_noise(presses)}",
        f"held by: {' and '.join(filter(None, (springs, fixed)))}",
    ]


def describe_material(material: MaterialSpec) -> str:
    """Return a line about the constitutive law."""
    parameters = "".join(f", {key} {value:g}" for key, value in material.parameters.items())
    return f"material: {material.name}, Poisson's ratio {material.poisson:g}{parameters}"


def describe_moduli(name: str, values: np.ndarray | None) -> str:
    """Return a line about moduli, MPa."""
    return f"{name}: " + ("unknown" if values is None else f"{_range(values)} MPa")


def _noise(presses: Sequence[Press]) -> str:
    known = [press.noise_mm for press in presses if press.noise_mm is not None]
    if not known:
        return "unknown"
    part = "" if len(known) == len(presses) else f" (unknown for {len(presses) - len(known)})"
    return f"{_range(known)} mm{part}"


def _range(values: Sequence[float] | Sequence[int] | np.ndarray) -> str:
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
