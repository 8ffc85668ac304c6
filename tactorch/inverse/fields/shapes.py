"""Inclusions in a background as a field of Young's modulus."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.inverse.data.plain import to_plain, with_arrays
from tactorch.inverse.fields import strength
from tactorch.inverse.fields.background import Background
from tactorch.inverse.fields.base import Vector
from tactorch.inverse.fields.family import FAMILIES, Family
from tactorch.inverse.fields.inclusion import COMMON, SIZE, InclusionShape, Parameters
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.inverse.fields.sites import Sites

_UNIFORM = Background()
_SMOOTH = "legendre"  # modes of a smooth background
_ALL = slice(None)
_STEP = 1e-5  # of differences, in standard deviations of the prior


@dataclass(frozen=True, eq=False)
class ShapeField:
    """A number of inclusions in a background.

    The parameters are in standard deviations of the prior: those of the background, and then those
    of each inclusion.

    Attributes:
        prior: Prior of the parameters.
        families: The family of each inclusion.
        background: The background.
    """

    prior: ShapePrior
    families: tuple[Family, ...] = ()
    background: Background = _UNIFORM

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        return {
            "prior": to_plain(self.prior),
            "families": [family.name for family in self.families],
            "degree": self.background.degree,
            "steps": list(self.background.steps),
            "smooth": _SMOOTH,
        }

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapeField":
        """Return the field from plain JSON values, of which others are left out.

        Raises:
            ConfigError: the background has the modes of an earlier version.
        """
        is_smooth = not plain["degree"] or plain.get("smooth") == _SMOOTH
        if not is_smooth or any(plain.get("layers", ())):
            raise ConfigError(
                "The shapes have a background by the modes of an earlier version; fit them again "
                "with tactorch find."
            )
        # Earlier versions state for each inclusion whether it is an ellipsoid.
        names = ["ellipsoid" if distorted else "ball" for distorted in plain.get("distorted", ())]
        families = tuple(FAMILIES[name] for name in plain.get("families", names))
        background = Background(plain["degree"], tuple(plain.get("steps", ())))
        return ShapeField(ShapePrior(**with_arrays(plain["prior"])), families, background)

    @property
    def _terms(self) -> tuple[Background | Family, ...]:
        return self.background, *self.families

    @cached_property
    def _scale(self) -> tuple[np.ndarray, np.ndarray]:
        scales = [term.scale(self.prior) for term in self._terms]
        mean, deviation = map(np.concatenate, zip(*scales, strict=True))
        return mean, deviation

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self._scale[0])

    @property
    def deviation(self) -> Vector:
        """Standard deviations of the prior, mm and logarithms."""
        return self._scale[1]

    @property
    def n_background(self) -> int:
        """Number of parameters of the background."""
        return len(self.background.parameters)

    @cached_property
    def parts(self) -> list[slice]:
        """Parameters of each inclusion."""
        ends = np.cumsum([len(term.parameters) for term in self._terms])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def index(self, inclusion: int, *names: str) -> Int[np.ndarray, " names"]:
        """Return the places of parameters of an inclusion among all, by their names."""
        own = self.families[inclusion].parameters
        return self.parts[inclusion].start + np.array([own.index(name) for name in names])

    @property
    def linear(self) -> list[Int[np.ndarray, "2"]]:
        """Places of log-radius and log-contrast of the inclusions.

        The data depend nearly linearly on squared radius and strength, see
        `tactorch.inverse.fields.strength`.
        """
        return [self.index(k, *SIZE) for k in range(len(self.families))]

    def own(self, values: Float[np.ndarray, "*k size"], inclusion: int) -> Parameters:
        """Return the parameters of an inclusion from all, in mm and logarithms."""
        return Parameters.of(values[..., self.parts[inclusion]])

    def _inclusions(self, values: Vector) -> list[tuple[Family, Parameters]]:
        return [(family, self.own(values, k)) for k, family in enumerate(self.families)]

    def physical(self, z: Float[np.ndarray, "*k size"]) -> Float[np.ndarray, "*k size"]:
        """Return parameters in mm and logarithms from those in standard deviations."""
        mean, deviation = self._scale
        return mean + deviation * z

    def standard(self, values: Float[np.ndarray, "*k size"]) -> Float[np.ndarray, "*k size"]:
        """Return parameters in standard deviations; the inverse of `physical`."""
        mean, deviation = self._scale
        return (values - mean) / deviation

    def moved(self, z: Vector, step: Vector) -> Vector:
        """Return the parameters after a step, on which the data depend nearly linearly.

        Steps of squared radii and strengths of inclusions are straight, see
        `tactorch.inverse.fields.strength`, which is `z + step` to first order only.
        """
        values, change = self.physical(z), self.deviation * step
        new = values + change
        for logs in self.linear:
            new[logs] = strength.moved(values[logs], change[logs])
        return self.standard(new)

    def changed(self, z: Vector, **changes: Any) -> tuple["ShapeField", Vector]:
        """Return the field with another prior, background or families, and its parameters.

        Those of the same name remain, in mm and logarithms, and others are zero.
        """
        other, values = replace(self, **changes), self.physical(z)
        new, parts = [], [slice(self.n_background), *self.parts]
        for term, part, changed in zip(self._terms, parts, other._terms, strict=True):
            known = dict(zip(term.parameters, values[part], strict=True))
            new += [known.get(name, 0.0) for name in changed.parameters]
        return other, other.standard(np.array(new))

    def shapes(self, z: Vector) -> Iterator[InclusionShape]:
        """Yield the inclusions."""
        for family, own in self._inclusions(self.physical(z)):
            yield family.shape(own)

    def excess(self, z: Vector) -> Float[np.ndarray, " sides"]:
        """Return how far inclusions extend beyond each side of the box, in standard deviations.

        There are six values for each inclusion where the prior restricts them, and otherwise none.
        """
        prior, found = self.prior, [np.zeros(0)]
        for shape in self.shapes(z) if prior.outside_mm is not None else ():
            center, half = np.array(shape.center_mm), shape.half_size_mm
            beyond = [center + half - prior.high_mm, prior.low_mm - center + half]
            found.append(np.maximum(np.concatenate(beyond), 0.0) / prior.outside_mm)
        return np.concatenate(found)

    def penalty(self, z: Vector) -> float:
        """Return minus the log-density of the prior, up to a constant of the family."""
        excess = self.excess(z)
        return 0.5 * float(z @ z + excess @ excess)

    def excess_jacobian(self, z: Vector) -> Float[np.ndarray, "sides size"]:
        """Return the derivative of `excess` by the parameters, by central differences."""
        steps = _STEP * np.eye(self.size)
        changes = [self.excess(z + step) - self.excess(z - step) for step in steps]
        return np.stack(changes, axis=1) / (2.0 * _STEP)

    def log_background(
        self, values: Float[np.ndarray, "k size"], points: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, " k"]:
        """Return the log-modulus of the background of each of k fields at one point (mm) each.

        `values` are in mm and logarithms; see `physical`.
        """
        own = values[:, : self.n_background]
        return self.background.log_youngs(self.prior, own, Sites.at(points))

    def log_youngs(
        self, z: Vector, sites: Sites, fractions: Sequence[Float[np.ndarray, " elements"]] = ()
    ) -> np.ndarray:
        """Return the log-modulus of each volume, log MPa.

        Fractions of the elements inside each inclusion are used where they are given.
        """
        values = self.physical(z)
        inside = [(_ALL, np.repeat(part, sites.shape[1])) for part in fractions]
        out = self.background.log_youngs(self.prior, values[: self.n_background], sites)
        for order in self._by_sign(values):
            covered = np.zeros(len(out))
            for k, family, own in order:
                near, inner = inside[k] if fractions else family.fractions(own, sites)
                covered[near] += inner * (own.log_contrast - covered[near])
            out += covered
        return out

    def mean_youngs(self, z: Vector, sites: Sites) -> Float[np.ndarray, " volumes"]:
        """Return the arithmetic mean of the modulus over each volume, MPa.

        The smooth background of a volume is that of its centre.
        """
        values = self.physical(z)
        out = np.exp(self.background.log_youngs(self.prior, values[: self.n_background], sites))
        for order in self._by_sign(values):
            covered = np.ones(len(out))
            for _, family, own in order:
                near, inner = family.fractions(own, sites)
                covered[near] += inner * (np.exp(own.log_contrast) - covered[near])
            out *= covered
        return out

    def _by_sign(self, values: Vector) -> Iterator[list[tuple[int, Family, Parameters]]]:
        """Yield the stiff inclusions, and the soft ones, those of the largest contrast last.

        Where stiff ones overlap, that of the largest contrast counts, as one body is not stiffer
        for being described twice; a soft one in a stiff one counts with it.
        """
        found = [(k, *one) for k, one in enumerate(self._inclusions(values))]
        found.sort(key=lambda one: abs(one[2].log_contrast))
        yield [one for one in found if one[2].log_contrast > 0.0]
        yield [one for one in found if one[2].log_contrast <= 0.0]

    def jacobian(self, z: Vector, sites: Sites) -> np.ndarray:
        """Return the derivative of `log_youngs` by the parameters, (volumes, size)."""
        values, out = self.physical(z), np.zeros((len(sites.points), self.size))
        own_background = values[: self.n_background]
        out[:, : self.n_background] = self.background.jacobian(self.prior, own_background, sites)
        for order in self._by_sign(values):
            covered = np.zeros(len(out))
            for k, family, own in order:
                near, inner, slopes = family.fraction_derivative(own, sites)
                for other, *_ in order:
                    out[near, self.parts[other]] *= (1.0 - inner)[:, None]
                columns = (own.log_contrast - covered[near])[:, None] * slopes
                place = COMMON.index("log_contrast")
                out[near, self.parts[k]] = np.insert(columns, place, inner, axis=1)
                covered[near] += inner * (own.log_contrast - covered[near])
        return out * self.deviation
