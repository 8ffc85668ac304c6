"""Candidates of the next press: patches of a curved surface that a round sensor can press."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.geometry import farthest_point_order, unit_rows
from tactorch.mesh.values import Real, positive
from tactorch.recording import Press, Recording
from tactorch.simulation.curved import Patch

NodeMask = Bool[np.ndarray, " n"]
MIN_FACING = 0.85  # mean cosine between surface and sensor; an edge of a cube has 0.71
_MIN_COVERED = 0.93  # of the area of a pressable patch, by the surface that faces it
_MAX_RADIUS_SHARE = 0.25  # inferred radius of the sensor over the object's smallest extent


def candidate_patches(
    mesh: TetMesh, held: NodeMask, radius_mm: Real, count: int, *, min_facing: float = 0.0
) -> list[Patch]:
    """Return patches that the sensor can press, in farthest-point order from the first.

    Centres are surface vertices, pushed along their mean normal. Patches that load a fixed node
    are excluded. The first is the one farthest from the fixed nodes.

    Args:
        mesh: The body, mm.
        held: Mask of the fixed nodes.
        radius_mm: Radius of the sensor, mm.
        count: Largest number of patches; a small surface has fewer.
        min_facing: Smallest `Patch.facing`; 0.85 excludes edges and corners of a cube.
    """
    radius = positive("radius_mm", radius_mm)
    if count < 1:
        raise ConfigError(f"count is {count}; ask for at least 1 candidate.")
    if not held.any():
        raise ConfigError(
            "held marks no fixed node, so that the body could move freely; mark at least three."
        )
    normals = _vertex_normals(mesh)
    free = [int(i) for i in mesh.surface.nodes() if not held[i]]
    all_patches = (Patch(mesh.points[i], -normals[i], float(radius)) for i in free)
    fitting = [
        patch
        for patch in all_patches
        if not patch.forces(mesh)[held].any()
        and (min_facing <= 0 or patch.facing(mesh) >= min_facing)
    ]
    if not fitting:
        raise ConfigError(
            f"radius_mm={radius:g}: no patch of this radius avoids the fixed nodes; use a smaller "
            "one."
        )
    centers = np.array([patch.center for patch in fitting])
    gaps = np.linalg.norm(centers[:, None] - mesh.points[held], axis=2).min(axis=1)
    return [fitting[i] for i in farthest_point_order(centers, count, int(gaps.argmax()))]


def pressable_patches(
    patches: Sequence[Patch], mesh: TetMesh, count: int, *, margin_mm: float = 0.0
) -> list[Patch]:
    """Return patches that lie on the surface as a whole, in farthest-point order.

    The first is the one nearest to the middle of them.

    Args:
        patches: Patches, such as those of `candidate_patches`.
        mesh: The object, mm.
        count: Largest number of patches.
        margin_mm: Distance by which the pose may be wrong, mm.
    """
    whole = [patch for patch in patches if patch.covered(mesh, margin_mm) >= _MIN_COVERED]
    if not whole:
        raise ConfigError(
            f"no candidate of radius {patches[0].radius_mm:g} mm is on the surface as a whole with "
            f"a margin of {margin_mm:g} mm; use a smaller radius."
            if patches
            else "there is no candidate."
        )
    centers = np.array([patch.center for patch in whole])
    first = int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())
    return [whole[i] for i in farthest_point_order(centers, min(count, len(whole)), first)]


def _vertex_normals(mesh: TetMesh) -> Float[np.ndarray, "n 3"]:
    """Outward normals of the surface's vertices, the mean of its triangles' by area."""
    surface = mesh.surface
    total = np.zeros((mesh.n_points, 3))
    weighted = surface.normals * surface.areas[:, None]
    np.add.at(total, surface.triangles.ravel(), np.repeat(weighted, 3, axis=0))
    return unit_rows(total)


class Candidates(NamedTuple):
    """Patches that can be pressed next."""

    patches: Sequence[Patch]
    pressed: tuple[int, ...]  # indices of those pressed so far, in order
    plan: Callable[[Patch], Press]  # the press as it would be recorded, with displacement 0


class InferredCandidates:
    """Candidates inferred from the presses of a recording.

    They have the sensor's size, on the surface that no press fixed. Their load is the median
    pressure so far, and the body is fixed as in the last press.
    """

    def __init__(self, radius_mm: float | None, count: int) -> None:
        self._radius_mm, self._count = radius_mm, count
        self._patches: dict[tuple[bytes, float], list[Patch]] = {}

    def __call__(self, recording: Recording) -> Candidates:
        """Return the candidates."""
        mesh, presses = recording.mesh, recording.presses
        radius = float(self._radius_mm or sensor_radius_mm(mesh, presses))
        held = np.any([press.held.any(axis=1) for press in presses], axis=0)
        key = held.tobytes(), radius
        if key not in self._patches:
            patches = candidate_patches(mesh, held, radius, self._count, min_facing=MIN_FACING)
            self._patches = {key: patches}
        patches = self._patches[key]
        pressed = _pressed(recording, patches, radius)
        loaded = [(press, area) for press in presses if (area := _loaded_mm2(mesh, press)) > 0]
        pressures = [float(np.linalg.norm(press.total_force)) / area for press, area in loaded]
        pressure = float(np.median(pressures or [0.0]))
        return Candidates(
            patches,
            pressed if len(pressed) < len(patches) else (),  # all pressed: start over
            lambda patch: _plan(presses[-1], patch, mesh, pressure),
        )


def all_directions(nodes: NodeMask) -> Bool[np.ndarray, "n 3"]:
    """Return the mask of all three degrees of freedom of some nodes."""
    return np.repeat(nodes[:, None], 3, axis=1)


def planned_press(
    patch: Patch, mesh: TetMesh, held: NodeMask, pressure_mpa: float, noise_mm: float
) -> Press:
    """Return a press as it would be reported, with displacement 0; loaded nodes are observed."""
    forces = pressure_mpa * patch.forces(mesh)
    return Press(
        forces=forces,
        observed=all_directions(np.any(forces != 0.0, axis=1)),
        displacement=np.zeros_like(forces),
        fixed=all_directions(held),
        noise_mm=noise_mm,
        direction=patch.inward,
    )


def sensor_radius_mm(mesh: TetMesh, presses: Sequence[Press]) -> float:
    """Return the radius of a disc of the loaded area, at most a quarter of the object's extent."""
    areas = [area for press in presses if (area := _loaded_mm2(mesh, press)) > 0]
    if not areas:
        raise ConfigError(
            "no press loads the surface with a force, so the size of the sensor is not known; give "
            "suggest.radius_mm."
        )
    max_radius = _MAX_RADIUS_SHARE * float(np.ptp(mesh.bounds, axis=0).min())
    return min(float(np.sqrt(np.median(areas) / np.pi)), max_radius)


def _loaded_mm2(mesh: TetMesh, press: Press) -> float:
    return float(mesh.vertex_areas[press.forces.any(axis=1)].sum())


def _plan(last: Press, patch: Patch, mesh: TetMesh, pressure_mpa: float) -> Press:
    """Press on a patch, fixed as the last press and observed where it loads."""
    if not pressure_mpa > 0:
        raise ConfigError(
            "the presses have no net force, so the force of the next one is not known; choose "
            "suggest.rule=largest_uncertainty."
        )
    if last.probe is not None or last.has_readings:
        raise ConfigError(
            f"{last.label} is by a probe, or has other data than displacements of nodes, for which "
            "the next press cannot be suggested yet."
        )
    unit, zero = patch.forces(mesh), np.zeros((mesh.n_points, 3))
    observed = all_directions(np.any(unit != 0.0, axis=1))
    return replace(
        last, forces=pressure_mpa * unit, observed=observed, displacement=zero, prescribed=zero,
        weights=None, direction=None, name="",
    )  # fmt: skip


def _pressed(recording: Recording, patches: Sequence[Patch], radius_mm: float) -> tuple[int, ...]:
    """Candidates whose centre is within half a radius of a press."""
    centers = np.array([patch.center for patch in patches])
    pressed: list[int] = []
    for press in recording.presses:
        weights = np.linalg.norm(press.forces, axis=1)
        weights = weights if weights.any() else press.observed.any(axis=1).astype(float)
        contact = weights @ recording.mesh.points / weights.sum()
        distances = np.linalg.norm(centers - contact, axis=1)
        nearest = int(distances.argmin())
        if distances[nearest] <= 0.5 * radius_mm and nearest not in pressed:
            pressed.append(nearest)
    return tuple(pressed)
