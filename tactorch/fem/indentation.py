"""Presses of a ball at many places of a body of linear elasticity, with one factorisation.

The compliance of the body between the contact pressures of a place (see
`tactorch.fem.contact.pressures`) gives the force at any depth there. A place takes one solve for
each profile, however many depths were measured.

A mesh as coarse as the contact makes the body too stiff there. What it misses is close to the
contact, and is found on the uniform body: the compliance between narrow profiles, relative to that
of a wide one that the mesh resolves, differs from that of a half-space. The difference is added,
over the modulus under the contact.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from tactorch.budget import check_work, work_bytes
from tactorch.errors import ConfigError
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
from tactorch.fem.local_change import GreenFunction, LocalChange, Stiffness
from tactorch.fem.materials import lame
from tactorch.fem.readings import surface_rows
from tactorch.linalg import map_cases
from tactorch.linalg.parallel import worker_count
from tactorch.mesh.closest import closest_points

_FRACTIONS = (1.0, 0.72, 0.48)  # radii of the profiles, over that of the largest contact
_FIRST, _SECOND = np.triu_indices(len(_FRACTIONS))  # pairs of profiles
_PAIRS = len(_FIRST)
_MAX_RATIO = 0.95  # of the largest radius of a profile to that of the ball
_WIDE = 1.2  # radius of the wide profile, over that of the largest contact and the mean edge
_ELEMENTS = 256  # whose derivatives are computed at once
_CHUNK_BYTES = 1 << 28  # of the arrays of the places that are computed at once
_PLACE_BYTES = 4e6  # that finding the points of the profiles of a place takes
_KEPT = 0.25  # displacements that are kept, over the memory for a computation
_NO_SHARE = 1e-6  # in the modulus under a contact, over the largest
# Relative difference of moduli that are taken as equal, as at the smooth boundary of an inclusion.
_SAME = 1e-3
_NOTHING = 1e-6  # relative change of a modulus that is left out, over the largest
# Unknowns of a change that is local: so many times the loads, as several models share them.
_MANY, _MAX_LOCAL = 3, 3000
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
        self.last: _FullSolution | None = None
        self.body, self.places, self.supports = body, tuple(places), supports
        self.balls_mm = np.array([place.ball_mm for place in self.places])
        deepest = np.array([place.deepest_mm for place in self.places])
        largest = np.minimum(contact_radius(deepest, self.balls_mm), _MAX_RATIO * self.balls_mm)
        self.radii_mm = largest[:, None] * np.array(_FRACTIONS)
        edge = float(np.sqrt(np.median(body.mesh.surface.areas) * 4.0 / np.sqrt(3.0)))
        wide = _WIDE * np.maximum(self.radii_mm[:, 0], edge)
        self._all_radii = np.column_stack([self.radii_mm, wide])
        chunks = self._chunks(worker_count() * _PLACE_BYTES)
        parts = map_cases(lambda k: self._profiles(chunks[k]), len(chunks))
        self.heights = np.concatenate([heights for _, heights in parts])
        # All places of one profile follow each other.
        profiles = zip(*(loads for loads, _ in parts), strict=True)
        self._loads = sp.vstack([part for loads in profiles for part in loads], format="csr")
        self._at_unit()

    def _chunks(self, place_bytes: float) -> list[Int[np.ndarray, " s"]]:
        """Return the places in parts whose arrays, of so many bytes a place, are small."""
        count = len(self.places)
        parts = -(-count // max(1, int(_CHUNK_BYTES / place_bytes)))
        return np.array_split(np.arange(count), parts)

    def _profiles(
        self, chunk: Int[np.ndarray, " s"]
    ) -> tuple[list[sp.csr_matrix], Float[np.ndarray, "s k"]]:
        """Return the loads of each profile of some places, the wide one last, and the heights."""
        ring, directions, weights = disc_rule()
        points, normals = [], []
        for place, radii in zip(
            [self.places[i] for i in chunk], self._all_radii[chunk], strict=True
        ):
            across = np.linalg.svd(place.normal[None])[2][1:]
            offsets = ring[:, None] * (directions @ across)
            points.append(place.contact_mm + radii[:, None, None] * offsets)
            normals.append(np.broadcast_to(-place.normal, points[-1].shape))
        at, pushes = (np.stack(parts, axis=1) for parts in (points, normals))
        queries = at.reshape(-1, 3)
        mesh = self.body.mesh
        closest = closest_points(mesh.points, mesh.surface.triangles, queries)
        rows = surface_rows(self.body.discretisation, queries, pushes.reshape(-1, 3), closest)
        means = sp.kron(
            sp.eye(len(queries) // len(weights)), sp.csr_matrix(weights[None]), format="csr"
        )
        found = closest.points.reshape(at.shape)
        heights = self._heights(chunk, found[:-1].swapaxes(0, 1)) @ weights
        loads, count = (means @ rows).tocsr(), len(chunk)
        return [loads[k * count : (k + 1) * count] for k in range(len(at))], heights

    def _heights(
        self, chunk: Int[np.ndarray, " s"], at: Float[np.ndarray, "s k q 3"]
    ) -> Float[np.ndarray, "s k q"]:
        """Return heights of surface points over a ball that touches the contact point, mm."""
        contacts = np.array([self.places[i].contact_mm for i in chunk])[:, None, None]
        normals = np.array([self.places[i].normal for i in chunk])[:, None, None]
        balls = self.balls_mm[chunk, None, None]
        apart = at - contacts
        along = (apart * normals).sum(axis=-1)
        across = np.linalg.norm(apart - along[..., None] * normals, axis=-1)
        across = np.minimum(across, _MAX_RATIO * balls)
        return np.asarray(along + np.sqrt(balls**2 - across**2) - balls)

    def _at_unit(self) -> None:
        """Compute what follows from the body of unit modulus."""
        poisson, narrowest = float(np.mean(self.body.assembly.poisson)), len(_FRACTIONS) - 1
        exact = half_space_compliance(self._all_radii, poisson)
        self._uniform = Stiffness(self.body, self.supports, np.ones(self.body.mesh.n_tets))
        self._green = GreenFunction(self.body, self._uniform, self._loads[: -len(self.places)])
        self.unit_compliance = np.empty((len(self.places), len(_FRACTIONS), len(_FRACTIONS)))
        self.missed, shares = np.empty_like(self.unit_compliance), []
        for chunk, fields, _ in self.solve(self._uniform, len(_FRACTIONS) + 1):
            compliance = self.compliance(chunk, fields)
            self.unit_compliance[chunk] = compliance[:, :-1, :-1]
            difference = exact[chunk] - compliance
            self.missed[chunk] = difference[:, :-1, :-1] - difference[:, -1:, -1:]
            alone = _Part(chunk, fields.reshape(len(fields), -1, len(chunk))[:, narrowest])
            energies = self.energies(alone, slice(None))[0]
            squares = (energies / energies.max(axis=0)) ** 2
            squares[squares < _NO_SHARE] = 0.0
            shares.append(sp.csr_matrix(squares / squares.sum(axis=0)))
        self.shares = sp.hstack(shares, format="csc")

    def at(self, youngs: Float[np.ndarray, "m *q"]) -> "IndentedBody":
        """Return the compliance of all places at these moduli (MPa).

        A body that is uniform but for a small part takes a solve for each unknown in that part,
        once, and a uniform one none.
        """
        return IndentedBody(self, youngs)

    def is_small(self, elements: Int[np.ndarray, " e"]) -> bool:
        """Return whether solving for the unknowns of elements is quicker than for all places."""
        unknowns = len(self._green.unknowns(elements))
        return unknowns <= min(_MANY * len(_FRACTIONS) * len(self.places), _MAX_LOCAL)

    def solve(self, stiffness: Stiffness, profiles: int) -> "Iterator[_Part]":
        """Yield places with their displacements by the loads of the first profiles."""
        count = len(self.places)
        size = 3 * self.body.n_nodes
        for chunk in self._chunks(8.0 * size * profiles):
            rows = (np.arange(profiles)[:, None] * count + chunk).ravel()
            yield _Part(chunk, stiffness.solve(self._loads[rows]))

    def without_solve(self, youngs: Float[np.ndarray, "m *q"]) -> "LocalChange | None":
        """Return the solution of a body that is uniform but for a small part; None for others."""
        scale = float(np.median(youngs))
        ratios = youngs / scale - 1.0
        ratios[np.abs(ratios) < _SAME] = 0.0
        elements = np.flatnonzero(ratios.reshape(len(ratios), -1).any(axis=1))
        if not self.is_small(elements):
            return None
        return LocalChange(self._green, scale, ratios, elements)

    def compliance(
        self, chunk: Int[np.ndarray, " s"], fields: Float[np.ndarray, "unknowns _"]
    ) -> Float[np.ndarray, "s k k"]:
        """Return the compliance of the mesh between the profiles of some places, mm/N."""
        count = len(chunk)
        k = fields.shape[1] // count
        result = np.empty((count, k, k))
        for a in range(k):
            loads = self._loads[a * len(self.places) + chunk]
            for b in range(k):
                moved = loads.multiply(fields[:, b * count : (b + 1) * count].T)
                result[:, a, b] = np.asarray(moved.sum(axis=1)).ravel()
        return 0.5 * (result + result.swapaxes(1, 2))

    def energies(
        self,
        part: "_Part",
        elements: slice | Int[np.ndarray, " e"],
        *,
        per_point: bool = False,
        moduli: Float[np.ndarray, "m q"] | float = 1.0,
    ) -> Float[np.ndarray, "pairs moduli s"]:
        """Return the strain energies between fields at some moduli: minus dC/dE at 1, mm^3/N^2.

        Args:
            part: Displacements by unit loads.
            elements: The elements.
            per_point: Whether moduli are those of quadrature points.
            moduli: Those of the quadrature points, MPa.
        """
        assembly = self.body.assembly
        nodes = self.body.discretisation.nodes if part.nodes is None else part.nodes
        poisson = np.broadcast_to(np.asarray(assembly.poisson), len(assembly.weights))[elements]
        first, second = (np.ascontiguousarray(value) for value in lame(poisson))
        weights = (assembly.weights * moduli)[elements]
        places = len(part.places)
        k = part.fields.shape[1] // places
        sites = weights.shape[1] if per_point else 1
        out = np.zeros((k * (k + 1) // 2, len(weights) * sites, places), dtype=np.float32)
        kernels.strain_energies(
            nodes[elements], assembly.gradients[elements], weights, first, second,
            np.ascontiguousarray(part.fields).reshape(-1, 3, k, places), out,
        )  # fmt: skip
        return out


class _Part(NamedTuple):
    """Displacements at some places, mm/N, by profiles; all places of one follow each other."""

    places: Int[np.ndarray, " s"]
    fields: Float[np.ndarray, "unknowns _"]
    nodes: Int[np.ndarray, "m _"] | None = None  # rows of the nodes of each element, if others


class _FullSolution:
    """Solutions of a body at any moduli, for a part of the places at a time."""

    def __init__(self, indentation: Indentation, youngs: Float[np.ndarray, "m *q"]) -> None:
        self._indentation, self._profiles, self._youngs = indentation, len(_FRACTIONS), youngs
        self._stiffness: Stiffness | None = None
        size = 12 * indentation.body.n_nodes * self._profiles * len(indentation.places)
        if indentation.last is not None:
            indentation.last.forget()
        indentation.last = self
        self._kept: list[_Part] | None = [] if size < _KEPT * work_bytes() else None

    @cached_property
    def compliance(self) -> Float[np.ndarray, "places k k"]:
        """Compliance of the mesh between the profiles of each place, mm/N."""
        found = np.empty_like(self._indentation.unit_compliance)
        for chunk, fields, _ in self.parts():
            found[chunk] = self._indentation.compliance(chunk, fields)
        return found

    def parts(self, keep: bool = True) -> Iterator[_Part]:
        """Yield places with their displacements.

        With `keep` they are kept where the memory suffices, until another body is solved.
        """
        if self._kept:
            yield from self._kept
            return
        indentation = self._indentation
        if self._stiffness is None:
            self._stiffness = Stiffness(indentation.body, indentation.supports, self._youngs)
        for part in indentation.solve(self._stiffness, self._profiles):
            if keep and self._kept is not None:
                self._kept.append(part)
            yield part

    def forget(self) -> None:
        """Keep neither displacements nor the factored stiffness."""
        self._kept = self._stiffness = None


class IndentedBody:
    """The places at one map of moduli.

    Attributes:
        youngs: Young's modulus of each element or quadrature point, MPa.
        compliance: Compliance between the profiles of each place, mm/N.
    """

    def __init__(self, indentation: Indentation, youngs: Float[np.ndarray, "m *q"]) -> None:
        self.youngs, self._indentation = youngs, indentation
        self._local = indentation.without_solve(youngs)
        self._softness = indentation.shares.T @ (1.0 / self._by_element)
        if self._local is None:
            mesh = self._full_solution.compliance
        else:
            mesh = (
                indentation.unit_compliance - self._local.less(len(_FRACTIONS))
            ) / self._local.scale
        self.compliance = mesh + indentation.missed * self._softness[:, None, None]

    @cached_property
    def _full_solution(self) -> _FullSolution:
        return _FullSolution(self._indentation, self.youngs)

    @cached_property
    def _by_element(self) -> Float[np.ndarray, " m"]:
        return np.asarray((self.youngs.reshape(len(self.youngs), -1) * self._point_weights).sum(1))

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
        rows = _PAIRS * len(self._indentation.places)
        check_work(f"the derivatives of {rows} forces", 4.0 * rows * self.youngs.size)
        out = np.empty((_PAIRS, rows // _PAIRS, self.youngs.size), dtype=np.float32)
        for chunk, part in self._rates():
            out[:, chunk] = part
        return out.reshape(rows, -1)

    def combined_rates(
        self, chain: sp.csr_matrix, *, logarithmic: bool = False
    ) -> Float[np.ndarray, "data moduli"]:
        """Return the product of a sparse matrix and `rates`, which are not kept.

        With `logarithmic` they are by the logarithms of factors of the elements' moduli, in single
        precision.
        """
        count = len(self._indentation.places)
        kind, size = (np.float32, len(self.youngs)) if logarithmic else (float, self.youngs.size)
        check_work(
            f"the derivatives of {chain.shape[0]} data",
            float(chain.shape[0]) * size * np.dtype(kind).itemsize,
        )
        out = np.zeros((chain.shape[0], size), dtype=kind)
        for chunk, part in self._rates(logarithmic):
            columns = chain[:, (np.arange(_PAIRS)[:, None] * count + chunk).ravel()]
            rows = np.flatnonzero(np.diff(columns.indptr))
            out[rows] += columns[rows].astype(kind) @ part.reshape(-1, size)
        return out

    def compliance_changes(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> Float[np.ndarray, "rows k"]:
        """Return minus the changes of the compliance by several changes of the moduli (MPa).

        Rows are those of `rates`. A change of all moduli by one factor is known; energies are
        computed only where a change is another.
        """
        relative = changes / self.youngs.ravel()
        factors, least = np.median(relative, axis=1), _NOTHING * np.abs(relative).max(axis=1)
        relative -= factors[:, None]
        relative[np.abs(relative) <= least[:, None]] = 0.0
        rest = relative * self.youngs.ravel()
        moved = self.compliance[:, _FIRST, _SECOND].T[..., None] * factors
        weights = self._point_weights * rest.reshape(len(rest), *self._point_weights.shape)
        softened = weights.sum(axis=2) / self._by_element**2
        missed = self._indentation.missed[:, _FIRST, _SECOND].T
        moved += missed[..., None] * (self._indentation.shares.T @ softened.T)
        self._add_energies(moved, rest)
        return moved.reshape(-1, len(changes))

    def _add_energies(
        self, moved: Float[np.ndarray, "pairs places k"], rest: Float[np.ndarray, "k moduli"]
    ) -> None:
        """Add the energies of the mesh by changes of the moduli (MPa)."""
        count, sites = len(self._by_element), self._sites
        by_element = rest.astype(np.float32).reshape(len(rest), count, sites)
        touched = np.flatnonzero(by_element.any(axis=(0, 2)))
        if not len(touched):
            return
        for part in self._fields(touched):
            for product in _each(partial(self._products, part, by_element), touched):
                moved[:, part.places] += product

    def _products(
        self,
        part: "_Part",
        by_element: Float[np.ndarray, "k m sites"],
        elements: Int[np.ndarray, " e"],
    ) -> Float[np.ndarray, "pairs s k"]:
        """Return the energies of some elements by changes of their moduli."""
        weights = np.ascontiguousarray(by_element[:, elements].reshape(len(by_element), -1))
        # One product after the other: NumPy has no fast one for a stack.
        return np.stack([(weights @ energy).T for energy in self._energies(part, elements)])

    def _fields(self, elements: Int[np.ndarray, " e"]) -> "Iterator[_Part]":
        """Yield places, with displacements of the nodes of elements."""
        indentation = self._indentation
        if self._local is not None and indentation.is_small(elements):
            yield _Part(np.arange(len(indentation.places)), *self._local.fields(elements))
        else:
            yield from self._full_solution.parts()

    def _rates(
        self, logarithmic: bool = False
    ) -> Iterator[tuple[np.ndarray, Float[np.ndarray, "pairs s moduli"]]]:
        """Yield places with minus the derivatives of their compliance by the moduli."""
        indentation = self._indentation
        everything = np.arange(len(self._by_element))
        # A change of a small part is solved without these displacements.
        for part in self._full_solution.parts(keep=self._local is None):
            missed = indentation.missed[part.places][:, _FIRST, _SECOND].T.astype(np.float32)
            softened = indentation.shares[:, part.places].T.toarray() / self._by_element
            if not logarithmic:
                points = (softened / self._by_element)[..., None] * self._point_weights
                softened = points.reshape(len(points), -1)
            out = missed[..., None] * softened.astype(np.float32)
            _each(partial(self._add_rates, part, logarithmic, out), everything)
            yield part.places, out

    def _add_rates(
        self,
        part: "_Part",
        logarithmic: bool,
        out: Float[np.ndarray, "pairs s moduli"],
        elements: Int[np.ndarray, " e"],
    ) -> None:
        """Add the energies of consecutive elements."""
        sites = 1 if logarithmic else self._sites
        moduli = slice(elements[0] * sites, (elements[-1] + 1) * sites)
        out[:, :, moduli] += self._energies(part, elements, logarithmic).swapaxes(1, 2)

    def _energies(
        self, part: "_Part", elements: Int[np.ndarray, " e"], logarithmic: bool = False
    ) -> Float[np.ndarray, "pairs moduli s"]:
        """Return the energies of elements per unit modulus, or with their moduli."""
        moduli = self.youngs.reshape(len(self.youngs), -1) if logarithmic else 1.0
        per_point = self.youngs.ndim == 2 and not logarithmic
        return self._indentation.energies(part, elements, per_point=per_point, moduli=moduli)

    @property
    def _sites(self) -> int:
        return self.youngs.size // len(self.youngs)

    @property
    def _point_weights(self) -> Float[np.ndarray, "m sites"]:
        """Share of each modulus in the mean of its element."""
        weights = self._indentation.body.assembly.weights
        if self.youngs.ndim == 1:
            return np.ones((len(weights), 1))
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _each(work: Callable[[Int[np.ndarray, " e"]], T], elements: Int[np.ndarray, " e"]) -> list[T]:
    """Call with parts of some elements, in threads."""
    parts = [elements[i : i + _ELEMENTS] for i in range(0, len(elements), _ELEMENTS)]
    # The threads of NumPy's BLAS would wait for each other beside ours.
    with threadpool_limits(1, user_api="blas"):
        return map_cases(lambda i: work(parts[i]), len(parts))


def _terms(
    ratios: Float[np.ndarray, " s"], c: Float[np.ndarray, "s k"], rates: Float[np.ndarray, "s k"]
) -> Float[np.ndarray, "s pairs"]:
    """Return the derivatives of forces by minus the compliance of each pair of profiles."""
    k = c.shape[1]
    products = ratios[:, None, None] * rates[:, :, None] * c[:, None, :]
    both = products + products.swapaxes(1, 2)
    both[:, np.arange(k), np.arange(k)] *= 0.5
    return np.asarray(both[:, _FIRST, _SECOND])


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
