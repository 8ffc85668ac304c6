"""Magnitudes of a palpation that suggest another unit: positions, forces, depths and moduli."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.errors import FileError
from tactorch.importers.samples import Rows
from tactorch.mesh import TetMesh
from tactorch.mesh.closest import closest_points

_SPAN_MM, _FORCE_N = (1.0, 1e4), (1e-3, 1e3)
_SOFT_MPA = (1e-4, 20.0)  # apparent moduli of soft objects, from gels of 0.1 kPa to hard rubber
_DEPTH = (0.01, 4.0)  # of a ball, over its radius
_MIN_PROBES = 4  # that are not all within the diameter of the ball
_FEW = 50  # contacts that are compared with a given surface
# Distance between probes and depth, both over the radius, below which both are as if in cm.
_NEAR, _SHALLOW = 0.35, 0.07
#: Units that may have been taken for N and mm: quantity, factor.
_UNITS = {
    "mN": ("force", 1e-3), "kN": ("force", 1e3), "m": ("position", 1e3), "um": ("position", 1e-3),
    "cm": ("position", 10.0),
}  # fmt: skip
Remedy = Callable[[str, str], str]  # how a unit of "force" or "position" is stated


def check_rows(source: str, rows: Rows, radius_mm: float | None, remedy: Remedy) -> None:
    """Refuse positions and forces that no palpation in mm and N has.

    The radius of the ball is None where it is not stated; `source` is the name of the file in
    messages.

    Raises:
        FileError: A magnitude suggests another unit; names it, and the remedy.
    """
    centres, forces = rows.centres_mm, rows.forces_n
    span = float(np.linalg.norm(np.ptp(centres, axis=0))) if len(centres) else 0.0
    largest = float(np.linalg.norm(forces, axis=1).max(initial=0.0))
    for what, value, unit, (low, high), small, large in (
        ("positions span", span, "mm", _SPAN_MM, "m", "um"),
        ("forces reach", largest, "N", _FORCE_N, "kN", "mN"),
    ):
        if not low < value < high:
            raise _refusal(
                source, f"{what} {value:.3g} {unit}", small if value <= low else large, remedy
            )
    extent = float(np.linalg.norm(np.ptp(centres[:, :2], axis=0))) if len(centres) else 0.0
    probes = len(np.unique(rows.labels))
    if radius_mm and probes >= _MIN_PROBES and extent < 2.0 * radius_mm:
        what = f"{probes} probes are within {extent:.2g} mm, less than the diameter of the ball"
        if 10.0 * extent > radius_mm:
            raise _refusal(source, what, "cm", remedy)
        raise FileError(
            f"'{source}': {what}: all are at one place. The ball has to be pressed in at several "
            "places; check the columns of x and y."
        )


def check_contacts(
    source: str,
    points_mm: Float[np.ndarray, "probes 3"],
    depth_mm: float,
    radius_mm: float,
    modulus_mpa: float,
    remedy: Remedy,
) -> None:
    """Refuse distances, depths and apparent moduli that palpations of soft objects do not have.

    The depth of the ball is the median of the probes, and so is the modulus: that of a half-space
    with the forces of a probe.

    Raises:
        FileError: A magnitude suggests another unit; names it, and the remedy.
    """
    soft = _SOFT_MPA[0] < modulus_mpa < _SOFT_MPA[1]
    fits = [
        unit
        for unit, (what, factor) in _UNITS.items()
        for scale in [factor if what == "force" else factor**-1.5]
        for depth in [depth_mm * (factor if what == "position" else 1.0)]
        if _SOFT_MPA[0] < modulus_mpa * scale < _SOFT_MPA[1]
        and _DEPTH[0] < depth / radius_mm < _DEPTH[1]
    ]
    if depth_mm > _DEPTH[1] * radius_mm and not (fits and not soft):
        raise FileError(
            f"'{source}': a ball of {radius_mm:.3g} mm radius is pressed in by {depth_mm:.3g} mm; "
            "give format.radius_mm in mm, or format.check_units=false."
        )
    if not soft:
        what = (
            f"the forces at {depth_mm:.2g} mm of depth are those of a Young's modulus of "
            f"{modulus_mpa:.2g} MPa, which no soft object has"
        )
        raise _refusal(source, what, fits[0] if fits else None, remedy)
    spacing = _spacing(points_mm)
    if spacing < _NEAR * radius_mm and depth_mm < _SHALLOW * radius_mm:
        what = (
            f"a ball of {radius_mm:.3g} mm radius is pressed in by {depth_mm:.2g} mm only, at "
            f"places {spacing:.2g} mm apart"
        )
        raise _refusal(source, what, "cm", remedy)


def _spacing(points: Float[np.ndarray, "n 3"]) -> float:
    """Return the median distance of points from the nearest other one."""
    if len(points) < _MIN_PROBES:
        return np.inf
    return float(np.median(cKDTree(points).query(points, 2)[0][:, 1]))


def check_surface(
    source: str,
    mesh: TetMesh,
    points_mm: Float[np.ndarray, "probes 3"],
    lift_mm: Float[np.ndarray, "probes 3"],
    remedy: Remedy,
) -> None:
    """Refuse contacts that are not at the surface of the given object.

    `lift_mm` are the centres of the balls relative to the contacts.

    Raises:
        FileError: Most are farther from it than the ball's radius.
    """
    few = slice(None, None, 1 + len(points_mm) // _FEW)
    points, lift, limit = points_mm[few], lift_mm[few], float(np.linalg.norm(lift_mm[0]))

    def apart(factor: float) -> float:
        at = factor * (points + lift) - lift
        return float(np.median(closest_points(mesh.points, mesh.surface.triangles, at).distances))

    if (distance := apart(1.0)) <= limit:
        return
    what = f"the contacts are {distance:.3g} mm from the surface of format.mesh"
    larger = {u: f for u, (kind, f) in _UNITS.items() if kind == "position" and f > 1.0}
    units = [unit for unit, factor in larger.items() if apart(factor) <= limit]
    if units:
        raise _refusal(source, what, units[0], remedy)
    raise FileError(
        f"'{source}': {what}; check that it is the mesh of this object, in mm and in the axes of "
        "the robot."
    )


def _refusal(source: str, what: str, unit: str | None, remedy: Remedy) -> FileError:
    stated = (
        f"as if they were in {unit}; {remedy(_UNITS[unit][0], unit)}"
        if unit
        else ("in which unit are they? State it by format.units, and the ball by format.radius_mm")
    )
    return FileError(f"'{source}': {what}, {stated}. If they are right: format.check_units=false.")
