"""A recording in a few lines of text."""

from collections.abc import Sequence

import numpy as np

from tactorch.recording.plausibility import largest_displacement
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording


def summary(recording: Recording) -> str:
    """Describe object, presses, supports, noise, material and truth, a line each."""
    lines = [
        _object(recording),
        *_presses(recording.presses),
        _material(recording),
        _moduli("truth", recording.truth),
    ]
    if recording.reference is not None:
        lines.append(_moduli("reference", recording.reference))
    if recording.density and recording.gravity.any():
        pull = float(np.linalg.norm(recording.gravity)) / 1000
        lines.append(f"weight: {recording.density:.3g} tonne/mm^3 under {pull:.3g} m/s^2")
    return "\n".join(lines)


def _object(recording: Recording) -> str:
    mesh = recording.mesh
    size = " x ".join(f"{edge:.3g}" for edge in mesh.bounds[1] - mesh.bounds[0])
    return f"object: {size} mm, {mesh.n_points} nodes, {mesh.n_tets} tetrahedra"


def _presses(presses: Sequence[Press]) -> list[str]:
    forces = [float(np.linalg.norm(press.total_force)) for press in presses]
    moved = [largest_displacement(press) for press in presses]
    seen = [int(press.observed.sum()) for press in presses]
    held = "springs" if any(press.springs.any() for press in presses) else ""
    fixed = "fixed nodes" if any(press.fixed.any() for press in presses) else ""
    return [
        f"presses: {len(presses)}, force {_range(forces)} N, "
        f"largest displacement {_range(moved)} mm",
        f"observed: {_range(seen)} degrees of freedom a press, noise {_noise(presses)}",
        f"held by: {' and '.join(filter(None, (held, fixed)))}",
    ]


def _noise(presses: Sequence[Press]) -> str:
    known = [press.noise_mm for press in presses if press.noise_mm is not None]
    if not known:
        return "unknown"
    part = "" if len(known) == len(presses) else f" (unknown for {len(presses) - len(known)})"
    return f"{_range(known)} mm{part}"


def _material(recording: Recording) -> str:
    material = recording.material
    further = "".join(f", {key} {value:g}" for key, value in material.parameters.items())
    return f"material: {material.name}, Poisson's ratio {material.poisson:g}{further}"


def _moduli(name: str, values: np.ndarray | None) -> str:
    return f"{name}: " + ("unknown" if values is None else f"{_range(values)} MPa")


def _range(values: Sequence[float] | Sequence[int] | np.ndarray) -> str:
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
