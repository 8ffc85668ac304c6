"""Start of an inversion with one modulus for each region of the mesh."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.inverse.fields.parameterization import Bounds
from tactorch.inverse.fields.regularization.base import region_values
from tactorch.inverse.fit.starts import fit_groups
from tactorch.inverse.forward.problem import InverseProblem


@dataclass(frozen=True)
class RegionStart(Options):
    """One modulus for each region of the mesh: given, or those that fit best."""

    section: ClassVar[str] = "initialization"
    region_mpa: dict[int, float] | None = option(
        None, "Modulus of each region by number; null: those that fit best", unit="MPa", gt=0
    )
    steps: int = option(10, "Limit of Gauss-Newton steps of the fit", gt=0)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the map, MPa.

        Raises:
            ConfigError: The mesh has no regions, or a region has no modulus.
            ConvergenceError: The presses have an equilibrium with no uniform modulus.
        """
        mesh = problem.recording.mesh
        if self.region_mpa:
            return region_values(self.region_mpa, mesh, "initialization.region_mpa")
        if mesh.regions is None:
            raise ConfigError(
                "initialization=regions: the mesh of the recording has no regions; make it with "
                "tactorch body, or choose another initialization."
            )
        labels = np.unique(mesh.regions, return_inverse=True)[1].astype(np.int64)
        return fit_groups(problem, bounds, labels, steps=self.steps)
