"""The gel's Young's modulus from presses of known load (inverse finite elements).

At given displacements and Poisson's ratio, forces are proportional to Young's modulus. So each
press tells a force per unit of modulus, and the modulus is where all of these fit the loads, both
with their errors: F ~ E g, weighed by the variance of F - E g.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.gel.contact import Contact
from tactorch.sensor.gel.model import GelModel

_MESH = 0.02  # relative error of a gel's forces by its mesh, see benchmarks/gel_contact.py
_SEEN = 6.0  # times the noise: displacement from which there is contact
_NEAR = 30.0  # times the stated modulus, beyond which a unit is taken to be wrong
_UNITS = {"mN": 1e3, "g": 1e3 / 9.80665}  # per N


@dataclass(frozen=True, eq=False)
class KnownLoad:
    """A press whose total force was measured beside.

    Attributes:
        displacement: Of the nodes of the gel's face, mm; NaN where not seen.
        force_n: Total force on the gel in the sensor's frame, N, NaN for a component that was not
            measured; or along z alone. A press is against z: negative.
        deviation_n: Standard deviation of each component, N.
        touched: Nodes that may bear a force; None for all.
        name: What messages call it.

    Raises:
        ConfigError: A force is zero, pulls, or is not finite.
    """

    displacement: Float[np.ndarray, "k 3"]
    force_n: Float[np.ndarray, "3"] | Real
    deviation_n: Real
    touched: Bool[np.ndarray, " k"] | None = None
    name: str = "press"

    def __post_init__(self) -> None:
        positive(f"{self.name}: deviation_n", self.deviation_n)
        force = self.vector
        if np.isinf(force).any() or np.isnan(force[2]):
            raise ConfigError(
                f"{self.name}: force_n is {force.tolist()}; give N along z at least, and finite."
            )
        if force[2] == 0.0:
            raise ConfigError(f"{self.name}: force_n is 0 N along z, which tells no modulus.")
        if force[2] > 0.0:
            raise ConfigError(
                f"{self.name}: force_n is {force[2]:+g} N along z, which pulls the gel out of the"
                f" sensor. On the gel a press is against z: give {-force[2]:g}."
            )

    @property
    def vector(self) -> Float[np.ndarray, "3"]:
        """The force, NaN where not measured."""
        if np.ndim(self.force_n):
            return np.asarray(self.force_n, dtype=float)
        return np.array([np.nan, np.nan, float(self.force_n)])


@dataclass(frozen=True, eq=False)
class GelModulus:
    """What known loads tell of a gel.

    Attributes:
        youngs_mpa: Young's modulus.
        deviation_mpa: Its standard deviation, by noise of displacements and loads and by the mesh.
        random_mpa: That by noise alone, which more presses lessen.
        chi2: Weighed squares of what loads and forces disagree by; about `freedom` if all is well.
        freedom: Measured components of the loads, less one.
        forces_n: Total force that each press takes with this modulus, (presses, 3).
    """

    youngs_mpa: float
    deviation_mpa: float
    random_mpa: float
    chi2: float
    freedom: int
    forces_n: Float[np.ndarray, "p 3"]

    @property
    def consistent(self) -> bool:
        """Whether presses disagree by no more than their stated errors would in 99 of 100 cases."""
        from scipy.stats import chi2

        return self.freedom == 0 or bool(self.chi2 <= chi2.ppf(0.99, self.freedom))


def calibrate_modulus(
    model: GelModel,
    loads: Sequence[KnownLoad],
    noise_mm: Real,
    *,
    smooth: bool = True,
    tilted: bool = False,
    mesh_error: Real = _MESH,
) -> GelModulus:
    """Find the modulus with which a gel takes the loads that were measured.

    Args:
        model: The gel; its modulus is where the search starts, and must be right within a factor
            of thirty.
        loads: Presses of known load.
        noise_mm: Standard deviation of the displacements.
        smooth: Whether to ask for smooth forces. The direct ones of a gel that keeps its volume
            bear little noise.
        tilted: See `GelModel.smooth_forces`.
        mesh_error: Standard deviation of the forces by the mesh, relative, common to all presses.

    Raises:
        ConfigError: A press shows no contact, or its load fits no gel.
        ConvergenceError: The gel collapses.
    """
    if not loads:
        raise ConfigError("give at least one press of known load.")
    noise = positive("noise_mm", noise_mm)
    if not (np.isfinite(mesh_error) and mesh_error >= 0):
        raise ConfigError(f"mesh_error={mesh_error}: give a share of the force, 0 or more.")
    stated = float(model.gel.youngs_mpa)
    if tilted and not smooth:
        raise ConfigError("tilted displacements need smooth=True.")
    told = []
    for load in loads:
        _require_contact(load, noise)
        if smooth:
            found = model.smooth_forces(load.displacement, noise, load.touched, tilted=tilted)
        else:
            found = model.forces(load.displacement, noise)
        told.append(_Told.of(load, found, stated))
    return _fitted(told, stated, float(mesh_error))


@dataclass(frozen=True, eq=False)
class _Told:
    """A load, and the force per unit of modulus that its press took; measured components only.

    Attributes:
        load: N.
        load_variance: N^2.
        unit: N/MPa.
        unit_covariance: (N/MPa)^2.
        whole: All three components of the unit force.
        name: Of the press.
    """

    load: Float[np.ndarray, " c"]
    load_variance: float
    unit: Float[np.ndarray, " c"]
    unit_covariance: Float[np.ndarray, "c c"]
    whole: Float[np.ndarray, "3"]
    name: str

    @staticmethod
    def of(load: KnownLoad, found: Contact, stated_mpa: float) -> "_Told":
        assert found.covariance is not None
        on = np.isfinite(load.vector)
        unit = found.total / stated_mpa
        if unit[2] >= 0.0:
            raise ConfigError(
                f"{load.name}: the gel's face moved as if pulled ({found.total[2]:+.3g} N along z),"
                " against the load. Do displacement and force belong together, and is z out of the"
                " sensor?"
            )
        covariance = found.covariance[np.ix_(on, on)] / stated_mpa**2
        variance = float(load.deviation_n) ** 2
        return _Told(load.vector[on], variance, unit[on], covariance, unit, load.name)

    def variance(self, youngs: float) -> Float[np.ndarray, "c c"]:
        """Of load less force, N^2."""
        return self.load_variance * np.eye(len(self.load)) + youngs**2 * self.unit_covariance

    def chi2(self, youngs: float) -> float:
        """Weighed squares of load less force."""
        off = self.load - youngs * self.unit
        return float(off @ np.linalg.solve(self.variance(youngs), off))

    def information(self, youngs: float) -> float:
        """How sharply the load tells the modulus, 1/MPa^2."""
        return float(self.unit @ np.linalg.solve(self.variance(youngs), self.unit))


def _fitted(told: list[_Told], stated_mpa: float, mesh_error: float) -> GelModulus:
    """Find the modulus at which chi2 is least."""
    for one in told:  # along z, which always counts
        _require_plausible(one, one.load[-1] / one.unit[-1], stated_mpa)

    def misfit(log_youngs: float) -> float:
        return sum(one.chi2(float(np.exp(log_youngs))) for one in told)

    alone = np.log([one.load[-1] / one.unit[-1] for one in told])
    # Where the load's own components disagree, or are none too certain, the least lies beyond.
    bounds = (alone.min() - 1.0, alone.max() + 1.0)
    found = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    youngs = float(np.exp(found.x))
    random = 1.0 / np.sqrt(sum(one.information(youngs) for one in told))
    deviation = float(np.hypot(random, mesh_error * youngs))
    forces = youngs * np.stack([one.whole for one in told])
    freedom = sum(len(one.load) for one in told) - 1
    return GelModulus(youngs, deviation, float(random), float(found.fun), freedom, forces)


def _require_contact(load: KnownLoad, noise_mm: float) -> None:
    moved = load.displacement
    if load.touched is not None and load.touched.shape == moved.shape[:1]:
        moved = moved[load.touched]
    if not np.isfinite(moved).any():
        raise ConfigError(f"{load.name}: no displacement is known where the gel is touched.")
    size = float(np.nanmax(np.abs(moved)))
    if size <= _SEEN * noise_mm:
        raise ConfigError(
            f"{load.name}: the gel's face moves by {size:.3g} mm at most where it is touched, no"
            f" more than {_SEEN:g} times noise_mm={noise_mm:g}: there is no contact, or the"
            " displacement is not in mm."
        )


def _require_plausible(one: _Told, youngs: float, stated_mpa: float) -> None:
    ratio = youngs / stated_mpa
    if 1.0 / _NEAR <= ratio <= _NEAR:
        return
    unit, off = min(((u, abs(np.log(ratio / f))) for u, f in _UNITS.items()), key=lambda x: x[1])
    hint = f" Is force_n in {unit}, not N?" if off < np.log(3.0) else ""
    raise ConfigError(
        f"{one.name}: {one.load[-1]:g} N along z asks for a gel of {youngs:.3g} MPa, {ratio:.3g}"
        f" times the {stated_mpa:g} MPa of its description.{hint} Check the units (N, mm), and that"
        " displacement and force belong to the same press."
    )
