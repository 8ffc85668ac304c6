"""Matched filter: where a small ball or a rod would reduce the misfit of a model most."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.fields import Candidate
from tactorch.inverse.forward.reduced import ReducedProblem
from tactorch.mesh import TetMesh

# Candidates are on an even grid in the bounding box, whose spacing in a cube is 0.14 of its size:
# between the two radii of balls, so that one of them overlaps any inclusion that the data resolve.
_CENTRES, _RADII = 400, (0.1, 0.2)  # number, and radii over the size of the body
# Half-lengths and radius of rods over the size of the body, and their directions, 30 degrees apart.
_RODS, _ROD_RADIUS, _DIRECTIONS = (0.2, 0.4), 0.07, 6

Chosen = Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]]
_Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Balls:
    """Small balls or rods in a body.

    Attributes:
        centers: Centres, mm.
        radii: Radii, mm.
        halves: Vectors from the centre to an end of a rod, mm; zero for balls.
        fractions: Fraction of each element inside each of them.
    """

    centers: Float[np.ndarray, "balls 3"]
    radii: Float[np.ndarray, " balls"]
    halves: Float[np.ndarray, "balls 3"]
    fractions: Float[np.ndarray, "m balls"]

    @staticmethod
    def of(mesh: TetMesh) -> "Balls":
        """Return balls of two radii on an even grid that are for the most part in a body."""
        extent = np.ptp(mesh.points, axis=0)
        grid = _grid(mesh, np.eye(3), np.full(3, np.cbrt(np.prod(extent) / _CENTRES)))
        size = float(np.cbrt(mesh.volumes.sum()))
        kinds = [_inside(mesh, grid, size * radius, np.zeros(3)) for radius in _RADII]
        return Balls(*_places(kinds), np.hstack([k.fractions for k in kinds]))

    @staticmethod
    def rods(mesh: TetMesh, are_wanted: Chosen) -> Iterator["Balls"]:
        """Yield the rods of each length and direction that are for the most part in a body.

        They are along the longest two sides of the bounding box, or between them, at centres that
        are wanted.
        """
        axes = np.eye(3)[np.argsort(-np.ptp(mesh.points, axis=0))]
        size = float(np.cbrt(mesh.volumes.sum()))
        radius = size * _ROD_RADIUS
        for half in size * np.array(_RODS):
            for angle in np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS:
                along = np.cos(angle) * axes[0] + np.sin(angle) * axes[1]
                across = np.cos(angle) * axes[1] - np.sin(angle) * axes[0]
                spacings = np.array([half, 1.2 * radius, 2.0 * radius])
                grid = _grid(mesh, np.stack([along, across, axes[2]]), spacings)
                yield _inside(mesh, grid[are_wanted(grid)], radius, half * along)

    def only(self, chosen: Bool[np.ndarray, " balls"]) -> "Balls":
        """Return some of the balls or rods."""
        kept = self.centers[chosen], self.radii[chosen], self.halves[chosen]
        return Balls(*kept, self.fractions[:, chosen])


def _places(kinds: Sequence[Balls]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centres, radii and half-lengths of several kinds."""
    centers = np.concatenate([kind.centers for kind in kinds])
    radii = np.concatenate([kind.radii for kind in kinds])
    return centers, radii, np.concatenate([kind.halves for kind in kinds])


def _grid(
    mesh: TetMesh, axes: Float[np.ndarray, "3 3"], spacings: _Vector
) -> Float[np.ndarray, "n 3"]:
    """Return an even grid along orthonormal axes over the extent of a body."""
    along = mesh.points @ axes.T
    low, extent = along.min(axis=0), np.ptp(along, axis=0)
    counts = np.maximum(np.rint(extent / spacings), 1).astype(int)
    ticks = [a + (np.arange(n) + 0.5) / n * b for a, b, n in zip(low, extent, counts, strict=True)]
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3) @ axes


def _inside(mesh: TetMesh, grid: Float[np.ndarray, "n 3"], radius: float, half: _Vector) -> Balls:
    """Return the rods (balls if `half` is zero) at points that are for the most part in a body."""
    width = np.cbrt(mesh.volumes)[:, None]
    distance = _distance_to_rods(mesh.centroids, grid, half)
    fractions = np.clip(0.5 + (radius - distance) / width, 0.0, 1.0)
    volume = np.pi * radius**2 * (4.0 / 3.0 * radius + 2.0 * float(np.linalg.norm(half)))
    balls = Balls(grid, np.full(len(grid), radius), np.tile(half, (len(grid), 1)), fractions)
    return balls.only(fractions.T @ mesh.volumes > 0.5 * volume)


def _distance_to_rods(
    points: Float[np.ndarray, "m 3"], centers: Float[np.ndarray, "n 3"], half: _Vector
) -> Float[np.ndarray, "m n"]:
    """Return distances to the axes of rods, mm; to the centres of balls."""
    middle = centers.mean(axis=0) if len(centers) else np.zeros(3)
    points, centers = points - middle, centers - middle  # less round-off
    squares = (points**2).sum(axis=1)[:, None] + (centers**2).sum(axis=1)
    squares -= 2.0 * (points @ centers.T)
    if half.any():
        length, along = float(half @ half), (points @ half)[:, None] - centers @ half
        t = np.clip(along / length, -1.0, 1.0)
        squares += t * (t * length - 2.0 * along)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


@dataclass(frozen=True, eq=False)
class MatchedFilter:
    """Change of the residuals by small balls and rods at the map of a reduced model."""

    centers: Float[np.ndarray, "balls 3"]
    radii: Float[np.ndarray, " balls"]
    halves: Float[np.ndarray, "balls 3"]
    responses: Float[np.ndarray, "data balls"]

    @staticmethod
    def of(problem: ReducedProblem, rods: Chosen | None = None) -> "MatchedFilter":
        """Return the responses to balls of unit log-contrast in the body, in single precision.

        The data of the problem have no correlated errors; see `whitened`. Where `rods` is given,
        it returns which centres are of use, and there are rods, too.
        """
        mesh = problem.recording.mesh
        kinds = [Balls.of(mesh)]
        if rods is not None:
            kinds = [kinds[0].only(rods(kinds[0].centers)), *Balls.rods(mesh, rods)]
        inside = sp.hstack([sp.csc_matrix(kind.fractions) for kind in kinds], dtype=np.float32)
        responses = np.asarray(problem.rates @ inside) * problem.data.scale[:, None]
        return MatchedFilter(*_places(kinds), responses.astype(np.float32))

    def whitened(self, data: DataModel) -> "MatchedFilter":
        """Return the responses of data with errors that they have in common."""
        white = data.whiten(self.responses).astype(self.responses.dtype, copy=False)
        return replace(self, responses=white)

    def best(
        self,
        residuals: Float[np.ndarray, " data"],
        explained: Float[np.ndarray, "data k"],
        count: int,
        weights: Float[np.ndarray, " data"] | float = 1.0,
    ) -> list[Candidate]:
        """Return distinct balls and rods that reduce the misfit of these residuals most.

        Changes of the residuals along the columns of `explained` are those of known parameters.
        Data may have weights.
        """
        weights = np.broadcast_to(weights, residuals.shape)
        basis, _ = np.linalg.qr(weights[:, None] * explained)
        responses = self.responses * weights[:, None].astype(self.responses.dtype)
        single = basis.astype(responses.dtype)
        responses -= single @ (single.T @ responses)
        residuals = weights * residuals
        residuals = residuals - basis @ (basis.T @ residuals)
        squares = np.einsum("db,db->b", responses, responses) + 1e-12
        contrasts = -residuals @ responses / squares
        gains = 0.5 * contrasts**2 * squares
        candidates: list[Candidate] = []
        for ball in np.argsort(-gains):
            center, radius, half = self.centers[ball], float(self.radii[ball]), self.halves[ball]
            if all(_differ(c, center, radius, half) for c in candidates):
                contrast, gain = float(contrasts[ball]), float(gains[ball])
                candidates.append(Candidate(center, radius, contrast, gain, half))
            if len(candidates) == count:
                break
        return candidates


def _differ(other: Candidate, center: _Vector, radius: float, half: _Vector) -> bool:
    """Whether a candidate is at another place, or of another kind (ball or rod)."""
    apart = float(np.linalg.norm(other.center_mm - center))
    if other.half_mm.any() != half.any():
        return True
    return apart > radius + 0.5 * float(np.linalg.norm(half))
