"""Equilibria of several load cases from nearby displacements, with one factorisation.

The displacements u move by f = -K0^-1 r(u), with the unbalanced forces r and the tangent K0 of one
of the cases, and by Anderson's combination of the last moves (D. G. Anderson, "Iterative procedures
for nonlinear integral equations", J. ACM 12 (1965), 547-560; H. F. Walker and P. Ni, SIAM J. Numer.
Anal. 49 (2011), 1715-1735). All cases are solved at once, which takes a fraction of the time of
single right-hand sides, and no tangent is assembled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tactorch.fem.newton import Newton
from tactorch.linalg.pool import Lease, SharedLease
from tactorch.linalg.solver import IndefiniteError

# Nine contacts that share a factorisation reach 1e-5 of the load in 12 iterations and 1e-6 in 14, a
# depth of 4 not all of them.
_MAX_ITERATIONS, _DEPTH = 20, 6
_MOVE_RTOL = 0.1  # of the moves, by iterative solvers: Anderson's combination corrects them
_WORSE = 10.0  # rise of the unbalanced force over the least one at which a case is left
# Least eigenvalue of the normal matrix of the changes of moves, over the largest, that is above
# round-off.
_DEPENDENT = 1e-14
_NEAR = 1.5  # ratio of moduli up to which a factorisation serves as well as a new one
NodalField = Float[np.ndarray, "nodes 3"]


@dataclass(eq=False)
class _Case:
    """The displacements of a load case, and those with the least unbalanced force."""

    search: Newton
    u: NodalField
    best: NodalField
    least: float = np.inf  # unbalanced force, relative
    moves: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)  # u, f before

    def unbalanced(self) -> Float[np.ndarray, " unknowns"] | None:
        """Return the unbalanced forces; None where the case is at its end."""
        found = self.search.unbalanced(self.u)
        if found is None or found[1] > _WORSE * self.least:
            return None
        if found[1] < self.least:
            self.best, self.least = self.u, found[1]
        return None if found[1] <= self.search.options.rtol else found[0]

    def move(self, step: Float[np.ndarray, " unknowns"]) -> None:
        """Move by f, combined with the last moves."""
        u = self.u.ravel()
        new = u + step
        if self.moves:
            changes = np.stack([step - f for _, f in self.moves], axis=1)
            paths = np.stack([u - before for before, _ in self.moves], axis=1)
            normal = changes.T @ changes
            weights = np.linalg.lstsq(normal, changes.T @ step, rcond=_DEPENDENT)[0]
            new -= (paths + changes) @ weights
        self.moves = [*self.moves, (u, step)][-_DEPTH:]
        self.u = new.reshape(-1, 3)


def approach(
    searches: Sequence[Newton], starts: Sequence[NodalField], lease: SharedLease
) -> list[NodalField]:
    """Return displacements (mm) of load cases near equilibrium, or at it.

    Args:
        searches: The load cases, of the same supports and similar tangents.
        starts: Displacements to start from, which have the prescribed values, mm.
        lease: The factorisation that they share; without one of similar moduli the tangent at the
            mean of the starts is factored, or that of the first case where that inverts elements.
    """
    cases = [_Case(search, u, u) for search, u in zip(searches, starts, strict=True)]
    with lease.hold() as held:
        if not (_is_near(held, searches[0]) or _factor(searches[0], starts, held)):
            return list(starts)
        active = cases
        for _ in range(_MAX_ITERATIONS):
            pairs = [(case, case.unbalanced()) for case in active]
            left = [(case, forces) for case, forces in pairs if forces is not None]
            if not left:
                break
            active = [case for case, _ in left]
            try:
                steps = held.solve(np.stack([-forces for _, forces in left], axis=1), _MOVE_RTOL)
            except IndefiniteError:
                break
            for case, step in zip(active, steps.T, strict=True):
                case.move(step)
    return [case.best for case in cases]


def _is_near(lease: Lease, search: Newton) -> bool:
    """Return whether a lease has the factorisation of a tangent of similar moduli."""
    about = lease.about
    if lease.factored is None or not isinstance(about, np.ndarray):
        return lease.factored is not None
    ratios = search.youngs / about
    return bool(ratios.max() < _NEAR and ratios.min() > 1.0 / _NEAR)


def _factor(search: Newton, starts: Sequence[NodalField], lease: Lease) -> bool:
    """Factor a tangent near those of the load cases; return whether there is one."""
    tangents = (search.tangent_at(u) for u in (np.mean(starts, axis=0), starts[0]))
    return any(lease.factor(tangent, search.youngs) for tangent in tangents if tangent is not None)
