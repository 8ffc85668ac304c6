"""Matched filter: the places where a small ball would reduce the misfit of a model most."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.inverse.data import DataModel
from tactorch.inverse.problem import InverseProblem
from tactorch.mesh import TetMesh

_CENTRES = 400  # candidates, on an even grid in the bounding box
_RADII = (0.1, 0.2)  # of the candidates, over the size of the body


class Candidate(NamedTuple):
    """A ball that would reduce the misfit."""

    center_mm: Float[np.ndarray, "3"]
    radius_mm: float
    log_contrast: float
    gain: float  # reduction of half the sum of squared residuals, linearised


@dataclass(frozen=True, eq=False)
class Balls:
    """Small balls on an even grid in a body.

    Attributes:
        centers: Centres, mm.
        radii: Radii, mm.
        fractions: Fraction of each element inside each ball.
    """

    centers: Float[np.ndarray, "balls 3"]
    radii: Float[np.ndarray, " balls"]
    fractions: Float[np.ndarray, "m balls"]

    @staticmethod
    def of(mesh: TetMesh) -> "Balls":
        """Return the balls that are for the most part in a body."""
        size = float(np.cbrt(mesh.volumes.sum()))
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        spacing = float(np.cbrt(np.prod(high - low) / _CENTRES))
        counts = np.maximum(np.rint((high - low) / spacing), 1).astype(int)
        axes = [
            a + (np.arange(n) + 0.5) / n * (b - a)
            for a, b, n in zip(low, high, counts, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        width = np.cbrt(mesh.volumes)[:, None]
        distance = np.linalg.norm(mesh.centroids[:, None] - grid, axis=2)
        centers, radii, columns = [], [], []
        for radius in size * np.array(_RADII):
            fractions = np.clip(0.5 + (radius - distance) / width, 0.0, 1.0)
            inside = fractions.T @ mesh.volumes > 0.5 * 4.0 / 3.0 * np.pi * radius**3
            centers.append(grid[inside])
            radii.append(np.full(int(inside.sum()), radius))
            columns.append(fractions[:, inside])
        return Balls(np.concatenate(centers), np.concatenate(radii), np.hstack(columns))


@dataclass(frozen=True, eq=False)
class MatchedFilter:
    """Change of the residuals by small balls at the uniform map, for linear elements."""

    centers: Float[np.ndarray, "balls 3"]
    radii: Float[np.ndarray, " balls"]
    responses: Float[np.ndarray, "data balls"]

    @staticmethod
    def of(problem: InverseProblem, youngs_mpa: float) -> "MatchedFilter":
        """Compute the responses to balls of unit log-contrast on a grid in the body."""
        mesh = problem.recording.mesh
        jacobian = problem.evaluate(np.full(mesh.n_tets, youngs_mpa)).jacobian() * youngs_mpa
        balls = Balls.of(mesh)
        return MatchedFilter(balls.centers, balls.radii, jacobian @ balls.fractions)

    def best(
        self,
        residuals: Float[np.ndarray, " data"],
        explained: Float[np.ndarray, "data k"],
        data: DataModel,
        count: int,
    ) -> list[Candidate]:
        """Return distinct balls that reduce the misfit of these residuals most.

        Changes of the residuals along the columns of `explained` are those of known parameters.
        """
        basis, _ = np.linalg.qr(explained)
        responses = data.whiten(self.responses)
        responses = responses - basis @ (basis.T @ responses)
        residuals = residuals - basis @ (basis.T @ residuals)
        squares = np.einsum("db,db->b", responses, responses) + 1e-12
        contrasts = -residuals @ responses / squares
        gains = 0.5 * contrasts**2 * squares
        candidates: list[Candidate] = []
        for ball in np.argsort(-gains):
            center, radius = self.centers[ball], float(self.radii[ball])
            if all(np.linalg.norm(c.center_mm - center) > radius for c in candidates):
                candidates.append(
                    Candidate(center, radius, float(contrasts[ball]), float(gains[ball]))
                )
            if len(candidates) == count:
                break
        return candidates
