"""Pressers carry out presses: robots, or simulated bodies."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from tactorch.fem import SoftBody, Supports
from tactorch.mesh import TetMesh
from tactorch.recording import Press
from tactorch.sampling.candidates import Patch
from tactorch.simulation.transfer import Transfer


@runtime_checkable
class Presser(Protocol):
    """Presses a patch, and reports it over the nodes of the mesh of the inversion."""

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0."""
        ...

    def press(self, patch: Patch) -> Press:
        """Carry the press out."""
        ...


@dataclass(frozen=True, eq=False)
class SimulatedPresser:
    """Simulated presses on a body of known moduli.

    Attributes:
        body: The body, preferably on a finer mesh than the inversion's.
        youngs: True moduli, MPa.
        held: Mask of the fixed nodes of the body's mesh.
        mesh: Mesh of the inversion.
        mesh_held: Mask of its fixed nodes.
        pressure_mpa: Pressure of the sensor, MPa.
        noise_mm: Standard deviation of the noise of every press, mm.
        seed: Seed of the noise; a patch that is pressed again has the same noise.
    """

    body: SoftBody
    youngs: Float[np.ndarray, " e"]
    held: Bool[np.ndarray, " k"]
    mesh: TetMesh
    mesh_held: Bool[np.ndarray, " n"]
    pressure_mpa: float
    noise_mm: float
    seed: int = 0

    @cached_property
    def _transfer(self) -> Transfer:
        return Transfer.between(self.body.discretisation, self.mesh.points)

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0.

        Raises:
            ConfigError: the patch misses the surface.
        """
        forces = self.pressure_mpa * patch.forces(self.mesh)
        return Press(
            forces=forces,
            observed=_rows(np.any(forces != 0.0, axis=1)),
            displacement=np.zeros_like(forces),
            fixed=_rows(self.mesh_held),
            noise_mm=self.noise_mm,
            direction=patch.inward,
        )

    def press(self, patch: Patch) -> Press:
        """Press, and observe the nodes in contact.

        Raises:
            ConvergenceError: the body collapses.
            ConfigError: the patch misses the surface.
        """
        supports = Supports(fixed=_rows(self.held))
        load = self.pressure_mpa * patch.forces(self.body.mesh)
        result = self.body.equilibrate(self.youngs, load, supports).require()
        place = np.round(patch.center * 1e6).astype(np.int64) & 0xFFFFFFFF
        rng = np.random.default_rng([self.seed, *place.tolist()])
        plan = self.plan(patch)
        noise = self.noise_mm * rng.standard_normal(plan.forces.shape)
        return replace(plan, displacement=self._transfer(result.displacement) + noise)


def _rows(nodes: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, "n 3"]:
    """All three degrees of freedom of some nodes."""
    return np.repeat(nodes[:, None], 3, axis=1)
