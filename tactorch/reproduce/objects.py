"""The paper's objects, pressed as its Section IV and V-C have it; exact data on the mesh itself.

That presses are computed on the mesh and by the elements of the inversion is an inverse crime,
which the paper commits on purpose and so do these: the scores compare methods, not what a
measurement would give.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tactorch.errors import FileError
from tactorch.fem import SoftBody, make_material
from tactorch.mesh import Box, TetMesh, face_nodes
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.sampling import Patch, SimulatedPresser, candidate_patches
from tactorch.simulation import PressPlan, simulate

POISSON = 0.45
MATERIAL = MaterialSpec("neo_hookean", POISSON)
SIDES = ("z+", "x+", "y+")
START_MPA = 0.2  # the paper's, in all its studies


def pressed(settings: Mapping[str, Any]) -> Recording:
    """Press one of the paper's objects.

    Boxes are pressed on whole sides, on springs, with rising pressure; curved bodies stand fast
    on their flat side and are pressed by a round sensor at places spread evenly over the rest.

    Args:
        settings: `phantom` (its name), `relative_edge_length` of the mesh, `p_max_mpa` (the
            highest pressure), `steps`; on curved bodies `patches`, `patch_steps` and `sensor_mm`
            (number, steps of the pressure on each, and radius).
    """
    phantom = make_phantom(settings["phantom"])
    mesh = phantom.mesh(relative_edge_length=settings["relative_edge_length"])
    truth = phantom.on_mesh(mesh)
    if isinstance(phantom.body, Box):
        plan = PressPlan(p_max_mpa=settings["p_max_mpa"], steps=settings["steps"], faces=SIDES)
        return simulate(phantom, plan, material=MATERIAL, mesh=mesh, samples=1)
    return _pressed_by_sensor(phantom, mesh, truth, settings)


def sensor_on(
    mesh: TetMesh, truth: np.ndarray, pressure_mpa: float, noise_mm: float = 0.0
) -> SimulatedPresser:
    """Return what presses a body that stands on its lower side."""
    held = standing(mesh)
    body = SoftBody(mesh, make_material(MATERIAL.name, POISSON))
    return SimulatedPresser(body, truth, held, mesh, held, pressure_mpa, noise_mm)


def standing(mesh: TetMesh) -> np.ndarray:
    """Return which nodes lie on the lower side, (n,)."""
    held = np.zeros(mesh.n_points, dtype=bool)
    held[face_nodes(mesh, "z-")] = True
    return held


def places(mesh: TetMesh, sensor_mm: float, count: int) -> list[Patch]:
    """Return where a round sensor can press a body that stands on its lower side."""
    return candidate_patches(mesh, standing(mesh), sensor_mm, count)


def _pressed_by_sensor(
    phantom: Phantom,
    mesh: TetMesh,
    truth: np.ndarray,
    settings: Mapping[str, Any],
) -> Recording:
    patches = places(mesh, settings["sensor_mm"], settings["patches"])
    presses = []
    steps = settings["patch_steps"]
    for step in range(steps):
        pressure = settings["p_max_mpa"] * (step + 1) / steps
        presser = sensor_on(mesh, truth, pressure)
        presses += [replace(presser.press(patch), step=step) for patch in patches]
    return Recording(
        mesh,
        tuple(presses),
        MATERIAL,
        truth=truth,
        provenance={"inverse_crime": True, "phantom": phantom.to_config()},
    )


def stored_mesh(arrays: Mapping[str, np.ndarray]) -> TetMesh:
    """Return the mesh that an outcome has stored.

    Raises:
        FileError: It has none.
    """
    if "points" not in arrays:
        raise FileError("a stored case has no mesh; delete its folder to make it anew.")
    return TetMesh.create(arrays["points"], arrays["tets"])
