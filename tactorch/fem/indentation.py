"""Presses of a ball at many places of a body of linear elasticity, with one factorisation.

The compliance of the body between the contact pressures of a place (see
`tactorch.fem.contact.pressures`) gives the force at any depth there. A place takes one solve for
each profile, however many depths were measured.

A mesh as coarse as the contact makes the body too stiff there. What it misses is close to the
contact, and is found on the uniform body: the compliance between narrow profiles, relative to that
of a wide one that the mesh resolves, differs from that of a half-space. The difference is added,
over the modulus under the contact.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import kernels
from tactorch.fem.body import SoftBody
from tactorch.fem.boundary import Supports
from tactorch.fem.contact.pressures import (
    contact_coefficients,
    contact_radius,
    disc_rule,
    half_space_compliance,
    restriction_ratio,
)
from tactorch.fem.materials import lame
from tactorch.fem.readings import surface_rows
from tactorch.linalg import map_cases
from tactorch.mesh.closest import closest_points

_FRACTIONS = (1.0, 0.72, 0.48)  # radii of the profiles, over that of the largest contact
_MAX_RATIO = 0.95  # of the largest radius of a profile to that of the ball
_WIDE = 1.2  # radius of the wide profile, over that of the largest contact and the mean edge
_MAX_COLUMNS = 96  # right-hand sides solved at once
_ELEMENTS = 256  # whose derivatives are computed at once
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class BallPlace:
    """A place at which a ball is pressed along one axis.

    Attributes:
        contact_mm: Point of the surface on the axis.
        normal: Outward unit vector of the axis.
        ball_mm: Radius of the ball.
        deepest_mm: Largest depth.
    """

    contact_mm: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    ball_mm: float
    deepest_mm: float


class Indentation:
    """Places on a body.

    Args:
        body: The body, of the material `linear`.
        supports: Its supports.
        places: The places.

    Attributes:
        places: The places.
        radii_mm: Radii of the profiles of each place, largest first.
        balls_mm: Radius of the ball at each place.
        heights: Mean height of the surface over the ball's, for each profile, when the ball
            touches the contact point, mm; the depth is added to it.

    Raises:
        ConfigError: the material is another, or a place is far from the surface.
    """

    def __init__(self, body: SoftBody, supports: Supports, places: Sequence[BallPlace]) -> None:
        if type(body.assembly.material).__name__ != "LinearElastic":
            raise ConfigError(
                "Presses at many places with one factorisation need material 'linear'; the "
                f"material is {type(body.assembly.material).__name__}."
            )
        self.body, self.places, self._supports = body, tuple(places), supports
        self.balls_mm = np.array([place.ball_mm for place in self.places])
        deepest = np.array([place.deepest_mm for place in self.places])
        largest = np.minimum(contact_radius(deepest, self.balls_mm), _MAX_RATIO * self.balls_mm)
        self.radii_mm = largest[:, None] * np.array(_FRACTIONS)
        edge = float(np.sqrt(np.median(body.mesh.surface.areas) * 4.0 / np.sqrt(3.0)))
        wide = _WIDE * np.maximum(self.radii_mm[:, 0], edge)
        self._all_radii = np.column_stack([self.radii_mm, wide])
        self._loads, self.heights = self._profiles()
        self._unit = self._solve(np.ones(body.mesh.n_tets), self._loads)

    def _profiles(self) -> tuple[sp.csr_matrix, Float[np.ndarray, "places k"]]:
        """Return the loads of all profiles, the wide ones last, and the heights."""
        ring, directions, weights = disc_rule()
        points, normals = [], []
        for place, radii in zip(self.places, self._all_radii, strict=True):
            across = np.linalg.svd(place.normal[None])[2][1:]
            offsets = ring[:, None] * (directions @ across)
            points.append(place.contact_mm + radii[:, None, None] * offsets)
            normals.append(np.broadcast_to(-place.normal, points[-1].shape))
        # All places of one profile follow each other.
        at, pushes = (np.stack(parts, axis=1) for parts in (points, normals))
        queries = at.reshape(-1, 3)
        mesh = self.body.mesh
        closest = closest_points(mesh.points, mesh.surface.triangles, queries)
        rows = surface_rows(self.body.discretisation, queries, pushes.reshape(-1, 3), closest)
        means = sp.kron(
            sp.eye(len(queries) // len(weights)), sp.csr_matrix(weights[None]), format="csr"
        )
        found = closest.points.reshape(at.shape)
        heights = self._heights(found[:-1].swapaxes(0, 1)) @ weights
        return (means @ rows).tocsr(), heights

    def _heights(self, at: Float[np.ndarray, "places k q 3"]) -> Float[np.ndarray, "places k q"]:
        """Return heights of surface points over a ball that touches the contact point, mm."""
        contacts = np.array([place.contact_mm for place in self.places])[:, None, None]
        normals = np.array([place.normal for place in self.places])[:, None, None]
        balls = self.balls_mm[:, None, None]
        apart = at - contacts
        along = (apart * normals).sum(axis=-1)
        across = np.linalg.norm(apart - along[..., None] * normals, axis=-1)
        across = np.minimum(across, _MAX_RATIO * balls)
        return np.asarray(along + np.sqrt(balls**2 - across**2) - balls)

    def at(self, youngs: Float[np.ndarray, "m *q"]) -> "IndentedBody":
        """Return the compliance of all places at these moduli (MPa).

        A uniform body takes no solve.
        """
        count = len(_FRACTIONS) * len(self.places)
        if np.ptp(youngs) <= 1e-12 * youngs.max():
            fields = self._unit[:, :count] / np.float32(youngs.ravel()[0])
        else:
            fields = self._solve(youngs, self._loads[:count])
        return IndentedBody(self, youngs, fields)

    def _solve(
        self, youngs: Float[np.ndarray, "m *q"], loads: sp.csr_matrix
    ) -> Float[np.ndarray, "unknowns profiles"]:
        """Return the displacements by loads in single precision, mm/N."""
        nothing = np.zeros((self.body.n_nodes, 3))
        search = self.body.search(youngs, nothing, self._supports)
        linearization = search.linearize(search.run().require())
        fields = np.empty(loads.shape[::-1], dtype=np.float32)
        # Solutions by a factorisation in single precision are as accurate as they are stored.
        lease = self.body.pool.lease(single_precision=True)
        if not lease.factor(linearization.tangent):
            raise ConvergenceError("The stiffness matrix is not positive definite; hold the body.")
        for first in range(0, fields.shape[1], _MAX_COLUMNS):
            block = slice(first, first + _MAX_COLUMNS)
            forces = loads[block].T.toarray(order="F")
            forces[linearization.fixed] = 0.0
            fields[:, block] = lease.solve(forces)
        lease.close()
        return fields

    def compliance(
        self, fields: Float[np.ndarray, "unknowns profiles"]
    ) -> Float[np.ndarray, "places k k"]:
        """Return the compliance of the mesh between the profiles of each place, mm/N."""
        count = len(self.places)
        k = fields.shape[1] // count
        result = np.empty((count, k, k))
        for a in range(k):
            loads = self._loads[a * count : (a + 1) * count]
            for b in range(k):
                moved = loads.multiply(fields[:, b * count : (b + 1) * count].T)
                result[:, a, b] = np.asarray(moved.sum(axis=1)).ravel()
        return 0.5 * (result + result.swapaxes(1, 2))

    @cached_property
    def missed(self) -> Float[np.ndarray, "places k k"]:
        """Compliance that the mesh misses at each contact, times its modulus, 1/mm."""
        poisson = float(np.mean(self.body.assembly.poisson))
        exact = half_space_compliance(self._all_radii, poisson)
        difference = exact - self.compliance(self._unit)
        return np.asarray(difference[:, :-1, :-1] - difference[:, -1:, -1:])

    @cached_property
    def shares(self) -> Float[np.ndarray, "m places"]:
        """Share of each element in the modulus under each contact, which is a harmonic mean.

        They are proportional to the square of the energy of the narrowest profile, so that they are
        those of the elements at the contact.
        """
        count, last = len(self.places), len(_FRACTIONS) - 1
        narrowest = self._unit[:, last * count : (last + 1) * count]
        energies = self.energies(narrowest, slice(None), per_point=False)[0]
        squares: np.ndarray = (energies / energies.max(axis=0)) ** 2
        return squares / squares.sum(axis=0)

    def energies(
        self, fields: Float[np.ndarray, "unknowns profiles"], elements: slice, *, per_point: bool
    ) -> Float[np.ndarray, "pairs moduli places"]:
        """Return the strain energies between fields per unit modulus: minus dC/dE, mm^3/N^2.

        Args:
            fields: Displacements by unit loads, mm/N.
            elements: The elements.
            per_point: Whether moduli are those of quadrature points.
        """
        assembly, places = self.body.assembly, len(self.places)
        poisson = np.broadcast_to(np.asarray(assembly.poisson), len(assembly.weights))[elements]
        first, second = (np.ascontiguousarray(value) for value in lame(poisson))
        weights = assembly.weights[elements]
        k = fields.shape[1] // places
        sites = weights.shape[1] if per_point else 1
        out = np.zeros((k * (k + 1) // 2, len(weights) * sites, places), dtype=np.float32)
        kernels.strain_energies(
            self.body.discretisation.nodes[elements], assembly.gradients[elements], weights,
            first, second, np.ascontiguousarray(fields).reshape(-1, 3, k, places), out,
        )  # fmt: skip
        return out


class IndentedBody:
    """The places at one map of moduli.

    Attributes:
        youngs: Young's modulus of each element or quadrature point, MPa.
        compliance: Compliance between the profiles of each place, mm/N.
    """

    def __init__(
        self,
        indentation: Indentation,
        youngs: Float[np.ndarray, "m *q"],
        fields: Float[np.ndarray, "unknowns profiles"],
    ) -> None:
        self.youngs, self._indentation, self._fields = youngs, indentation, fields
        softness = (1.0 / self._by_element) @ indentation.shares
        missed = indentation.missed * softness[:, None, None]
        self.compliance = indentation.compliance(fields) + missed

    @cached_property
    def _by_element(self) -> Float[np.ndarray, " m"]:
        weights = self._indentation.body.assembly.weights
        if self.youngs.ndim == 1:
            return self.youngs
        return np.asarray((self.youngs * weights).sum(axis=1) / weights.sum(axis=1))

    def press(
        self, places: Int[np.ndarray, " s"], depths_mm: Float[np.ndarray, " s"]
    ) -> "BallForces":
        """Return the forces of presses, each at a place to a depth (mm)."""
        indentation = self._indentation
        depths = depths_mm[:, None] + indentation.heights[places]
        c, rates = contact_coefficients(self.compliance[places], depths)
        ratios = restriction_ratio(
            indentation.radii_mm[places], indentation.balls_mm[places], depths_mm
        )
        return BallForces(places, ratios * c.sum(axis=1), _terms(ratios, c, rates))

    @cached_property
    def rates(self) -> Float[np.ndarray, "rows moduli"]:
        """Minus the derivatives of the compliance by the moduli, in single precision.

        There is a row for each pair of profiles and place; all places of a pair follow each other.
        """
        k = len(_FRACTIONS)
        rows = k * (k + 1) // 2 * len(self._indentation.places)
        out = np.empty((rows, self.youngs.size), dtype=np.float32)

        def work(elements: slice, moduli: slice) -> None:
            part = self._rates_of(elements)
            out[:, moduli] = part.swapaxes(1, 2).reshape(rows, -1)

        self._by_parts(work)
        return out

    def compliance_changes(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> Float[np.ndarray, "rows k"]:
        """Return minus the changes of the compliance by several changes of the moduli (MPa).

        Rows are those of `rates`, which are not kept.
        """
        columns = changes.astype(np.float32)

        def work(elements: slice, moduli: slice) -> np.ndarray:
            # One product after the other: NumPy has no fast one for a stack.
            part = np.ascontiguousarray(columns[:, moduli])
            return np.stack([part @ rates for rates in self._rates_of(elements)])

        total: np.ndarray = np.array(self._by_parts(work)).sum(axis=0, dtype=np.float64)
        return total.swapaxes(1, 2).reshape(-1, len(changes))

    def _by_parts(self, work: Callable[[slice, slice], T]) -> list[T]:
        """Call with slices of elements, and of their moduli, in threads."""
        count = len(self._indentation.body.assembly.weights)
        sites = self.youngs.size // count
        firsts = range(0, count, _ELEMENTS)

        def part(i: int) -> T:
            first, last = firsts[i], min(firsts[i] + _ELEMENTS, count)
            return work(slice(first, last), slice(first * sites, last * sites))

        # The threads of NumPy's BLAS would wait for each other beside ours.
        with threadpool_limits(1, user_api="blas"):
            return map_cases(part, len(firsts))

    def _rates_of(self, elements: slice) -> Float[np.ndarray, "pairs moduli places"]:
        """Minus the derivatives of the compliance by the moduli of some elements."""
        indentation = self._indentation
        rows, cols = np.triu_indices(len(_FRACTIONS))
        per_point = self.youngs.ndim == 2
        rates = indentation.energies(self._fields, elements, per_point=per_point)
        softened = indentation.shares[elements] / self._by_element[elements, None] ** 2
        if per_point:
            weights = indentation.body.assembly.weights[elements]
            points = weights / weights.sum(axis=1, keepdims=True)
            softened = (points[:, :, None] * softened[:, None]).reshape(-1, softened.shape[1])
        missed = indentation.missed[:, rows, cols].T.astype(np.float32)
        rates += missed[:, None, :] * softened.astype(np.float32)
        return rates


def _terms(
    ratios: Float[np.ndarray, " s"], c: Float[np.ndarray, "s k"], rates: Float[np.ndarray, "s k"]
) -> Float[np.ndarray, "s pairs"]:
    """Return the derivatives of forces by minus the compliance of each pair of profiles."""
    k = c.shape[1]
    rows, cols = np.triu_indices(k)
    products = ratios[:, None, None] * rates[:, :, None] * c[:, None, :]
    both = products + products.swapaxes(1, 2)
    both[:, np.arange(k), np.arange(k)] *= 0.5
    return np.asarray(both[:, rows, cols])


@dataclass(frozen=True, eq=False)
class BallForces:
    """Forces of presses by a ball.

    Attributes:
        places: Place of each press.
        force_n: Force on the ball along the outward normal, N.
        terms: Its derivative by minus the compliance between profiles.
    """

    places: Int[np.ndarray, " s"]
    force_n: Float[np.ndarray, " s"]
    terms: Float[np.ndarray, "s pairs"]
