"""Nuisance parameters: quantities other than the moduli that the data depend on."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tactorch.config import Options, option
from tactorch.mesh import TetMesh
from tactorch.recording import Press

_SIZES = {"poisson": 1, "force_scale": 1, "rest_scale": 3, "translation_mm": 3, "rotation_rad": 3}
_RATIOS = ("force_scale", "rest_scale")
_POISSON_LIMITS = (-0.9, 0.4995)  # above, tetrahedra of any kind lock
_MAX_RATIO = 0.9  # of posterior to prior deviation, for informative data
_MAX_Z = 8.0  # prior standard deviations from the assumed value


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Values of the nuisance parameters, common to all presses.

    The sensor's frame differs from that of the mesh by a small rigid motion: a point x is reported
    at `rotation (x - c) + c + translation`, with c the centre of the mesh's bounding box, and
    forces are rotated likewise. The true rest shape is the mesh stretched along the axes
    about where each press holds it. The true forces are the reported ones times `force_scale`.

    Attributes:
        poisson: Poisson's ratio of the whole object.
        force_scale: True over reported force.
        rest_scale: True over assumed size along x, y and z.
        translation_mm: Translation of the sensor's reports, mm.
        rotation_rad: Rotation vector of the sensor's reports, rad.
    """

    poisson: float
    force_scale: float = 1.0
    rest_scale: Float[np.ndarray, "3"] = field(default_factory=lambda: np.ones(3))
    translation_mm: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    rotation_rad: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """The rotation as a matrix; exactly the unit matrix for a zero vector."""
        return Rotation.from_rotvec(self.rotation_rad).as_matrix()

    def rotation_rates(self) -> Float[np.ndarray, "3 3"]:
        """Return, column by column, the spatial rotation by a change of each component.

        This is the left Jacobian of the rotation group (Sola, Deray and Atchuthan, 2018, eq. 145),
        the integral of exp(t W) over t from 0 to 1, with W the matrix of the rotation vector.
        """
        cross = np.cross(np.eye(3), self.rotation_rad)
        return expm(np.block([[cross, np.eye(3)], [np.zeros((3, 6))]]))[:3, 3:]


@dataclass(frozen=True)
class NuisancePrior(Options):
    """Nuisance parameters to be estimated; each field is a prior standard deviation, or None.

    The prior is normal about the recording's values: for Poisson's ratio, translation and rotation
    in their units, for the scales in their logarithms (0.1 is about 10 %). The optimizer's variable
    is z, the difference from there in standard deviations.

    Without springs of known stiffness, weight or prescribed motion the scales of forces and moduli
    are one unknown: the data are then uninformative about `force_scale`, and its deviation remains
    that of the prior.
    """

    section: ClassVar[str] = "nuisance"
    poisson: float | None = option(None, "Deviation of Poisson's ratio; null: known", gt=0)
    force_scale: float | None = option(
        None, "Relative deviation of true from reported force; null: known", gt=0
    )
    rest_scale: float | None = option(
        None, "Relative deviation of true from assumed size, each axis; null: known", gt=0
    )
    translation_mm: float | None = option(
        None, "Deviation of the sensor's offset, each axis; null: known", unit="mm", gt=0
    )
    rotation_rad: float | None = option(
        None, "Deviation of the sensor's rotation, each axis; null: known", unit="rad", gt=0
    )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)

    @property
    def size(self) -> int:
        """Number of values that are estimated."""
        return sum(_SIZES[name] for name in self.names)

    def parts(self, values: Float[np.ndarray, " k"]) -> dict[str, np.ndarray]:
        """Split values, in the order of z, by parameter."""
        ends = np.cumsum([_SIZES[name] for name in self.names])[:-1]
        return dict(zip(self.names, np.split(values, ends), strict=True)) if self.names else {}

    def nuisance(self, z: Float[np.ndarray, " k"], assumed: Nuisance) -> Nuisance:
        """Return the values at z."""
        changes: dict[str, Any] = {}
        for name, part in self.parts(z).items():
            shift, origin = getattr(self, name) * part, getattr(assumed, name)
            value = origin * np.exp(shift) if name in _RATIOS else origin + shift
            changes[name] = float(value[0]) if _SIZES[name] == 1 else value
        return replace(assumed, **changes)

    def z(self, values: Mapping[str, np.ndarray], assumed: Nuisance) -> Float[np.ndarray, " k"]:
        """Return z of values, by name; the inverse of `nuisance`."""
        parts = [np.zeros(0)]
        for name in self.names:
            value = np.atleast_1d(values[name])
            origin = np.atleast_1d(getattr(assumed, name))
            shift = np.log(value / origin) if name in _RATIOS else value - origin
            parts.append(shift / getattr(self, name))
        return np.concatenate(parts)

    def slopes(self) -> Float[np.ndarray, " k"]:
        """Return d(value, or log of a scale) / dz: the prior deviations of the components."""
        parts = (np.full(_SIZES[name], getattr(self, name)) for name in self.names)
        return np.concatenate([np.zeros(0), *parts])

    def limits(self, assumed: Nuisance) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of z."""
        low, high = np.full(self.size, -_MAX_Z), np.full(self.size, _MAX_Z)
        if self.poisson is not None:  # the first component
            ends = (np.array(_POISSON_LIMITS) - assumed.poisson) / self.poisson
            low[0], high[0] = max(low[0], ends[0]), min(high[0], ends[1])
        return low, high


@dataclass(frozen=True, eq=False)
class NuisanceEstimate:
    """Estimate of one nuisance parameter.

    Attributes:
        value: Its components.
        deviation: Their posterior standard deviations, relative for scales; NaN where the problem
            is too large for a dense matrix, or an equilibrium is unstable.
        prior_deviation: Their prior standard deviation.
    """

    value: Float[np.ndarray, " c"]
    deviation: Float[np.ndarray, " c"]
    prior_deviation: float

    @property
    def is_informative(self) -> bool:
        """Whether the data reduce the deviation of some component by a tenth or more."""
        return bool((self.deviation < _MAX_RATIO * self.prior_deviation).any())

    def text(self) -> str:
        """Return the components with their standard deviations as text."""
        pairs = zip(np.atleast_1d(self.value), np.atleast_1d(self.deviation), strict=True)
        return ", ".join(f"{value:.3g} (standard deviation {dev:.2g})" for value, dev in pairs)


@dataclass(frozen=True, eq=False)
class PressModel:
    """A press at given nuisance values: true forces, true rest shape, reported displacement."""

    forces: Float[np.ndarray, "n 3"]  # true forces on the mesh's nodes, in its frame, N
    arm: Float[np.ndarray, "n 3"]  # true rest position relative to the support of the press, mm
    drift: Float[np.ndarray, "n 3"]  # reported displacement at zero displacement, mm
    values: Nuisance
    rest: Float[np.ndarray, "n 3"]  # assumed position relative to the centre of rotation, mm

    @staticmethod
    def of(press: Press, mesh: TetMesh, values: Nuisance) -> "PressModel":
        """Return the model of a press.

        The support does not move with the size of the object: it is at the mean position of the
        supported nodes along each axis, and an axis without support has the centre.
        """
        points, center, rotation = mesh.points, mesh.bounds.mean(axis=0), values.rotation
        supported = press.fixed | (press.springs > 0)
        support = np.array(
            [points[on, a].mean() if (on := supported[:, a]).any() else center[a] for a in range(3)]
        )
        rest, arm = points - center, (points - support) * values.rest_scale
        # This form is exactly zero at the assumed values.
        true = rest + (arm - (points - support))
        drift = true @ rotation.T - rest + values.translation_mm
        forces = values.force_scale * (press.forces @ rotation)
        return PressModel(forces, arm, drift, values, rest)

    def reported(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the displacement that the sensor reports where the true one is u, mm."""
        return self.drift + u[: len(self.rest)] @ self.values.rotation.T

    def rates(self, name: str, u: Float[np.ndarray, "nodes 3"]) -> tuple[list[Any], list[Any]]:
        """Return the change of the true forces, and of the report, by each component.

        The true displacement u is fixed; of scales the component is the logarithm.
        """
        rotation = self.values.rotation
        if name == "force_scale":
            return [self.forces], []
        if name == "rest_scale":
            return [], [np.outer(self.arm[:, a], rotation[:, a]) for a in range(3)]
        if name == "translation_mm":
            return [], [np.broadcast_to(row, self.rest.shape) for row in np.eye(3)]
        if name == "rotation_rad":
            forces, rates = self.forces @ rotation.T, self.values.rotation_rates().T
            reported = self.reported(u) + self.rest - self.values.translation_mm
            return (
                [-np.cross(rate, forces) @ rotation for rate in rates],
                [np.cross(rate, reported) for rate in rates],
            )
        return [], []
