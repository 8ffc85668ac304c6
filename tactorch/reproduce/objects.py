"""Objects of the paper, pressed as in Sections IV and V-C, without noise.

Simulating the presses on the mesh and with the elements of the inversion is an inverse crime. The
paper does so, and the scores compare methods; they do not predict those of measurements.
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
START_MPA = 0.2  # initial modulus in all studies of the paper


def press_object(settings: Mapping[str, Any]) -> Recording:
    """Simulate presses on an object of the paper.

    Boxes on springs are pressed on complete sides with increasing pressure. Curved bodies are
    fixed at their flat side and pressed by a round sensor at evenly distributed positions.

    Args:
        settings: `phantom` (name), `relative_edge_length` of the mesh, `p_max_mpa` (maximum
            pressure) and `steps`; for curved bodies also `patches` (number of positions),
            `patch_steps` (steps of the pressure at each) and `sensor_mm` (radius).

    Returns:
        The recording with its truth.
    """
    phantom = make_phantom(settings["phantom"])
    mesh = phantom.mesh(relative_edge_length=settings["relative_edge_length"])
    truth = phantom.on_mesh(mesh)
    if isinstance(phantom.body, Box):
        plan = PressPlan(p_max_mpa=settings["p_max_mpa"], steps=settings["steps"], faces=SIDES)
        return simulate(phantom, plan, material=MATERIAL, mesh=mesh, samples=1)
    return _press_by_sensor(phantom, mesh, truth, settings)


def make_presser(
    mesh: TetMesh, truth: np.ndarray, pressure_mpa: float, noise_mm: float = 0.0
) -> SimulatedPresser:
    """Return a simulated sensor on a body that is fixed at its lower side."""
    fixed = lower_nodes(mesh)
    body = SoftBody(mesh, make_material(MATERIAL.name, POISSON))
    return SimulatedPresser(body, truth, fixed, mesh, fixed, pressure_mpa, noise_mm)


def lower_nodes(mesh: TetMesh) -> np.ndarray:
    """Return the mask of the nodes on the lower side, (n,)."""
    fixed = np.zeros(mesh.n_points, dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    return fixed


def sensor_patches(mesh: TetMesh, sensor_mm: float, count: int) -> list[Patch]:
    """Return positions of a round sensor on a body that is fixed at its lower side."""
    return candidate_patches(mesh, lower_nodes(mesh), sensor_mm, count)


def _press_by_sensor(
    phantom: Phantom,
    mesh: TetMesh,
    truth: np.ndarray,
    settings: Mapping[str, Any],
) -> Recording:
    patches = sensor_patches(mesh, settings["sensor_mm"], settings["patches"])
    presses = []
    steps = settings["patch_steps"]
    for step in range(steps):
        pressure = settings["p_max_mpa"] * (step + 1) / steps
        presser = make_presser(mesh, truth, pressure)
        presses += [replace(presser.press(patch), step=step) for patch in patches]
    return Recording(
        mesh,
        tuple(presses),
        MATERIAL,
        truth=truth,
        provenance={"inverse_crime": True, "phantom": phantom.to_config()},
    )


def mesh_arrays(mesh: TetMesh, **arrays: np.ndarray) -> dict[str, np.ndarray]:
    """Return arrays of a result together with those of their mesh; see `stored_mesh`."""
    return {"points": mesh.points, "tets": mesh.tets, **arrays}


def stored_mesh(arrays: Mapping[str, np.ndarray]) -> TetMesh:
    """Return the mesh of a stored result.

    Raises:
        FileError: The result has no mesh.
    """
    if "points" not in arrays:
        raise FileError("a stored case has no mesh; delete its folder to compute it again.")
    return TetMesh.create(arrays["points"], arrays["tets"])
