"""Presses as a table of pandas: a row for each press and node."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from tactorch.errors import ConfigError, RecordingError
from tactorch.mesh import TetMesh
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press

if TYPE_CHECKING:
    import pandas


def to_frame(
    mesh: TetMesh, presses: Sequence[Press], material: MaterialSpec, *, interior: bool
) -> "pandas.DataFrame":
    """Return the presses as a table; see `Recording.to_frame`."""
    try:
        import pandas
    except ImportError as error:
        raise ConfigError("Tables need pandas: pip install 'tactorch[tables]'.") from error
    nodes = np.arange(mesh.n_points) if interior else mesh.surface.nodes()
    for press in presses:
        _require_complete(press, nodes)
    parts = [
        pandas.DataFrame(columns)
        for name, press in zip(_names(presses), presses, strict=True)
        for columns in (_nodal(name, press, mesh, nodes), _along(name, press))
        if columns is not None
    ]
    frame = pandas.concat(parts, ignore_index=True)
    frame["node"] = frame["node"].astype("Int64")  # missing for displacements along a direction
    frame.attrs = {"units": "mm, N, MPa", "material": material.name, "poisson": material.poisson}
    return frame


def _require_complete(press: Press, nodes: Int[np.ndarray, " k"]) -> None:
    """Refuse a press with data that the table does not hold."""
    if press.probe is not None or press.force is not None:
        raise RecordingError(
            f"{press.label} is by a probe, or its force is measured, which a table of nodes"
            " cannot hold; leave it out by Recording.select"
        )
    if press.prescribed is not None and np.any(press.prescribed):
        raise RecordingError(
            f"{press.label} has prescribed displacements, which a table of nodes cannot hold; leave"
            " it out by Recording.select"
        )
    inside = np.ones(len(press.forces), dtype=bool)
    inside[nodes] = False
    for name in ("forces", "fixed", "springs"):
        if np.any(getattr(press, name)[inside]):
            raise RecordingError(
                f"{press.label} has {name} at interior nodes, which the table of the surface does"
                " not hold; give interior=True"
            )


def _names(presses: Sequence[Press]) -> list[str]:
    """Return unique names."""
    names = [press.name for press in presses]
    return [
        name if name and names.count(name) == 1 else f"{name} {index}".strip()
        for index, name in enumerate(names)
    ]


def _nodal(name: str, press: Press, mesh: TetMesh, nodes: Int[np.ndarray, " k"]) -> dict[str, Any]:
    noise = np.nan if press.noise_mm is None else press.noise_mm
    columns: dict[str, Any] = {"press": name, "step": press.step, "node": nodes}
    for before, after, values in (
        ("", "_mm", mesh.points),
        ("u", "_mm", press.displacement),
        ("f", "_n", press.forces),
        ("fixed_", "", press.fixed.astype(float)),
        ("spring_", "_n_per_mm", press.springs),
    ):
        for axis, column in zip("xyz", values[nodes].T, strict=True):
            columns[f"{before}{axis}{after}"] = column
    return columns | {"noise_mm": noise}


def _along(name: str, press: Press) -> dict[str, Any] | None:
    if press.surface is None:
        return None
    reading = press.surface
    columns: dict[str, Any] = {"press": name, "step": press.step, "node": np.nan}
    for axis, places, directions in zip(
        "xyz", reading.points_mm.T, reading.directions.T, strict=True
    ):
        columns |= {f"{axis}_mm": places, f"n{axis}": directions}
    return columns | {"u_n_mm": reading.displacement_mm, "noise_mm": reading.deviations_mm}
