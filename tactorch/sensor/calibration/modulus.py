"""Young's modulus of the gel from presses of known load (inverse finite elements).

At given displacements and Poisson's ratio, forces are proportional to Young's modulus E. Each press
yields a force g per unit of modulus. The modulus minimizes the squares of F - E g, weighted by
their variance, which includes the errors of both the load F and g.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.gel import GelContact, GelModel

_MESH_ERROR = 0.02  # relative error of the forces due to the mesh, see benchmarks/gel_contact.py
_MIN_SIGNAL = 6.0  # displacement that shows contact, over the noise
_MAX_RATIO = 30.0  # of calibrated and nominal modulus; beyond, a unit is wrong
_UNITS = {"mN": 1e3, "g": 1e3 / 9.80665}  # per N


@dataclass(frozen=True, eq=False)
class KnownLoad:
    """Press with an independently measured total force.

    Attributes:
        displacement: Displacements of the nodes of the gel's face, mm; NaN where unknown.
        force_n: Total force on the gel in the sensor frame, N, with NaN for components that were
            not measured; or its z component alone. A press has a negative z component.
        deviation_n: Standard deviation of each component, N.
        contact: Nodes that may carry a force; None for all.
        name: Name of the press, for messages.
    """

    displacement: Float[np.ndarray, "k 3"]
    force_n: Float[np.ndarray, "3"] | Real
    deviation_n: Real
    contact: Bool[np.ndarray, " k"] | None = None
    name: str = "press"

    def __post_init__(self) -> None:
        positive(f"{self.name}: deviation_n", self.deviation_n)
        force = self.vector
        problem = ""
        if np.isinf(force).any() or np.isnan(force[2]):
            problem = f"{force.tolist()}; give at least the z component, finite."
        elif force[2] == 0.0:
            problem = "0 N along z, which does not determine the modulus; give a loaded press."
        elif force[2] > 0.0:
            problem = (
                f"{force[2]:+g} N along z, which pulls the gel out of the sensor. On the gel a"
                f" press is against z: give {-force[2]:g}."
            )
        if problem:
            raise ConfigError(f"{self.name}: force_n is {problem}")

    @property
    def vector(self) -> Float[np.ndarray, "3"]:
        """Force as a vector, NaN for components that were not measured."""
        if np.ndim(self.force_n):
            return np.asarray(self.force_n, dtype=float)
        return np.array([np.nan, np.nan, float(self.force_n)])


@dataclass(frozen=True, eq=False)
class GelModulus:
    """Calibrated modulus of a gel.

    Attributes:
        youngs_mpa: Young's modulus.
        deviation_mpa: Standard deviation from noise of displacements and loads, and from the mesh.
        random_mpa: Standard deviation from noise alone, which more presses reduce.
        chi2: Weighted squares of the residual forces; about `freedom` for consistent data.
        freedom: Number of measured components less one.
        forces_n: Total force of each press with this modulus, (presses, 3).
    """

    youngs_mpa: float
    deviation_mpa: float
    random_mpa: float
    chi2: float
    freedom: int
    forces_n: Float[np.ndarray, "p 3"]

    @property
    def consistent(self) -> bool:
        """Whether chi2 is below its 99 % quantile."""
        return self.freedom == 0 or bool(self.chi2 <= chdtri(self.freedom, 0.01))


def calibrate_modulus(
    model: GelModel,
    loads: Sequence[KnownLoad],
    noise_mm: Real,
    *,
    smooth: bool = True,
    free_plane: bool = False,
    mesh_error: Real = _MESH_ERROR,
) -> GelModulus:
    """Calibrate the modulus of a gel with presses of known load.

    Args:
        model: Gel; its nominal modulus is the start of the search and must be right within a
            factor of thirty.
        loads: Presses of known load.
        noise_mm: Standard deviation of the displacements.
        smooth: Whether to use smooth forces. Direct forces of a nearly incompressible gel tolerate
            little noise.
        free_plane: See `GelModel.smooth_forces`.
        mesh_error: Relative standard deviation of the forces due to the mesh, common to all
            presses.

    Raises:
        ConfigError: A press shows no contact, or its load is implausible.
        ConvergenceError: Newton's method does not converge.
    """
    if not loads:
        raise ConfigError("give at least one press of known load.")
    noise = positive("noise_mm", noise_mm)
    if not (np.isfinite(mesh_error) and mesh_error >= 0):
        raise ConfigError(f"mesh_error={mesh_error}: give a fraction of the force, 0 or more.")
    if free_plane and not smooth:
        raise ConfigError("free_plane=True needs smooth=True.")
    observations = []
    for load in loads:
        _require_contact(load, noise)
        if smooth:
            contact = model.smooth_forces(
                load.displacement, noise, load.contact, free_plane=free_plane
            )
        else:
            contact = model.forces(load.displacement, noise)
        observations.append(_observe(load, contact, model.gel.youngs_mpa))

    def misfit(log_youngs: float) -> float:
        youngs = float(np.exp(log_youngs))
        return sum(o.weighted_square(o.load - youngs * o.unit_force, youngs) for o in observations)

    log_moduli = np.log([observation.modulus for observation in observations])
    # The minimum is outside the single moduli where components of a load disagree.
    bounds = (log_moduli.min() - 1.0, log_moduli.max() + 1.0)
    minimum = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    youngs = float(np.exp(minimum.x))
    information = sum(o.weighted_square(o.unit_force, youngs) for o in observations)  # Fisher's
    random = 1.0 / np.sqrt(information)
    deviation = float(np.hypot(random, float(mesh_error) * youngs))
    forces = youngs * np.stack([observation.unit_vector for observation in observations])
    freedom = sum(len(observation.load) for observation in observations) - 1
    return GelModulus(youngs, deviation, float(random), float(minimum.fun), freedom, forces)


class _Observation(NamedTuple):
    """Measured components of a load, N, and of the force per unit of modulus, N/MPa."""

    load: Float[np.ndarray, " c"]
    load_variance: float
    unit_force: Float[np.ndarray, " c"]
    unit_covariance: Float[np.ndarray, "c c"]
    unit_vector: Float[np.ndarray, "3"]  # all components, measured or not

    @property
    def modulus(self) -> float:
        """Modulus from the z component alone, which is always measured, MPa."""
        return float(self.load[-1] / self.unit_force[-1])

    def weighted_square(self, force: Float[np.ndarray, " c"], youngs: float) -> float:
        """Square of a force, weighted by the covariance at a modulus."""
        covariance = self.load_variance * np.eye(len(self.load)) + youngs**2 * self.unit_covariance
        return float(force @ np.linalg.solve(covariance, force))


def _require_contact(load: KnownLoad, noise_mm: float) -> None:
    displacement = load.displacement
    if load.contact is not None and load.contact.shape == displacement.shape[:1]:
        displacement = displacement[load.contact]
    if not np.isfinite(displacement).any():
        raise ConfigError(f"{load.name}: no displacement is known where the gel is in contact.")
    largest = float(np.nanmax(np.abs(displacement)))
    if largest <= _MIN_SIGNAL * noise_mm:
        raise ConfigError(
            f"{load.name}: the gel's face moves by {largest:.3g} mm at most in contact, no more"
            f" than {_MIN_SIGNAL:g} times noise_mm={noise_mm:g}: there is no contact, or the"
            " displacement is not in mm."
        )


def _observe(load: KnownLoad, contact: GelContact, nominal_mpa: float) -> _Observation:
    assert contact.covariance is not None
    measured, unit = np.isfinite(load.vector), contact.total / nominal_mpa
    if unit[2] >= 0.0:
        raise ConfigError(
            f"{load.name}: the gel's face moved as if pulled ({contact.total[2]:+.3g} N along z),"
            " against the load. Do displacement and force belong together, and is z out of the"
            " sensor?"
        )
    covariance = contact.covariance[np.ix_(measured, measured)] / nominal_mpa**2
    variance = float(load.deviation_n) ** 2
    observation = _Observation(load.vector[measured], variance, unit[measured], covariance, unit)
    ratio = observation.modulus / nominal_mpa
    if 1.0 / _MAX_RATIO <= ratio <= _MAX_RATIO:
        return observation
    unit_name = min(_UNITS, key=lambda name: abs(np.log(ratio / _UNITS[name])))
    is_close = abs(np.log(ratio / _UNITS[unit_name])) < np.log(3.0)
    hint = f" Is force_n in {unit_name}, not N?" if is_close else ""
    raise ConfigError(
        f"{load.name}: {load.vector[2]:g} N along z corresponds to a gel of"
        f" {observation.modulus:.3g} MPa, {ratio:.3g} times the {nominal_mpa:g} MPa of its"
        f" description.{hint} Check the units (N, mm), and that displacement and force belong to"
        " the same press."
    )
