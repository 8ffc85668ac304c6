"""Numbers of the paper, and its objects pressed as in Sections IV and V-C, without noise.

Simulating the presses on the mesh and with the elements of the inversion is an inverse crime. The
paper does so, and the scores compare methods; they do not predict those of measurements.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from tactorch.fem import SoftBody, make_material
from tactorch.inverse import Reconstruction, Settings, Start, invert_map
from tactorch.mesh import Box, TetMesh, face_nodes
from tactorch.mesh.tetmesh import FaceName
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import MaterialSpec, Recording
from tactorch.sampling import Patch, SimulatedPresser, candidate_patches
from tactorch.simulation import PressPlan, simulate

POISSON = 0.45
MATERIAL = MaterialSpec("neo_hookean", POISSON)
SIDES: tuple[FaceName, ...] = ("z+", "x+", "y+")
START_MPA = 0.2  # initial modulus in all studies of the paper


@cache
def paper() -> dict[str, Any]:
    """Return the numbers of the paper by exhibit, from `paper.yaml`."""
    text = files("tactorch.reproduce").joinpath("paper.yaml").read_text(encoding="utf-8")
    numbers: dict[str, Any] = yaml.safe_load(text)
    return numbers


def row(table: str, key: str) -> dict[str, Any]:
    """Return the values of the row whose first value is `key` by column."""
    content = paper()[table]
    row_values = next(values for values in content["rows"] if values[0] == key)
    return dict(zip(content["columns"], row_values, strict=True))


def press_finely(phantom: Phantom, plan: PressPlan, edge: float, **noise: Any) -> Recording:
    """Simulate noisy presses on a mesh of half the relative edge length of the recording's."""
    return simulate(
        phantom,
        plan,
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=edge),
        fine_mesh=phantom.mesh(relative_edge_length=edge / 2),
        **noise,
    )


def press_object(settings: Mapping[str, Any]) -> Recording:
    """Simulate presses on an object of the paper and return the recording with its truth.

    Boxes on springs are pressed on complete sides with increasing pressure. Curved bodies are
    fixed at their flat side and pressed by a round sensor at evenly distributed positions.

    `settings` are those of `ModelsSize`, and the name of the phantom.
    """
    phantom = make_phantom(settings["phantom"])
    mesh = phantom.mesh(relative_edge_length=settings["relative_edge_length"])
    truth, p_max_mpa = phantom.on_mesh(mesh), settings["p_max_mpa"]
    if isinstance(phantom.body, Box):
        plan = PressPlan(p_max_mpa=p_max_mpa, steps=settings["steps"], faces=SIDES)
        return simulate(phantom, plan, material=MATERIAL, mesh=mesh, samples=1)
    patches = sensor_patches(mesh, settings["sensor_mm"], settings["patches"])
    presses, steps = [], settings["patch_steps"]
    for step in range(steps):
        presser = make_presser(mesh, truth, p_max_mpa * (step + 1) / steps)
        presses += [replace(presser.press(patch), step=step) for patch in patches]
    provenance = {"inverse_crime": True, "phantom": phantom.to_config()}
    return Recording(mesh, tuple(presses), MATERIAL, truth=truth, provenance=provenance)


def make_presser(
    mesh: TetMesh, truth: np.ndarray, pressure_mpa: float, noise_mm: float = 0.0
) -> SimulatedPresser:
    """Return a simulated sensor on a body that is fixed at its lower side."""
    fixed = lower_nodes(mesh)
    body = SoftBody(mesh, make_material(MATERIAL.name, POISSON))
    return SimulatedPresser(body, truth, fixed, mesh, fixed, pressure_mpa, noise_mm)


def invert_blindly(
    recording: Recording, settings: Settings | None = None, start: Start = START_MPA
) -> Reconstruction:
    """Invert a recording without its truth, from the start of the paper by default."""
    return invert_map(
        replace(recording, truth=None), settings, start_mpa=start, show_progress=False
    )


def lower_nodes(mesh: TetMesh) -> np.ndarray:
    """Return the mask of the nodes on the lower side, (n,)."""
    return np.isin(np.arange(mesh.n_points), face_nodes(mesh, "z-"))


def sensor_patches(mesh: TetMesh, sensor_mm: float, count: int) -> list[Patch]:
    """Return positions of a round sensor on a body that is fixed at its lower side."""
    return candidate_patches(mesh, lower_nodes(mesh), sensor_mm, count)
