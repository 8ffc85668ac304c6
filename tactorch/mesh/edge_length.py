"""Search for the settings of fTetWild that give a median edge length.

fTetWild takes its edge length as an upper limit. It stops as soon as elements are well shaped,
whatever their size, and triangles on a curved surface stay as small as its envelope demands: in an
envelope of width e around a ball of radius r, edges are at most about (8 e r)^(1/2) long. Here it
coarsens its result, the envelope is a fraction of the edge length, and both are adapted until the
median edge length fits; boundary nodes are then moved onto the surface.
"""

import logging
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import MeshError
from tactorch.mesh.geometry import enclosed_volume
from tactorch.mesh.snap import onto_surface
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Points, Triangles

_log = logging.getLogger(__name__)
#: Number of meshes that are made at most.
MAX_ATTEMPTS = 6
_ENOUGH = 0.1  # deviation of the median edge length that ends the search
#: Deviation of the median edge length that is reported.
TOLERANCE = 0.2
_FIRST_ENVELOPE, _LAST_ENVELOPE = 0.06, 0.15  # width, over the edge length
_FIRST_FACTOR, _MAX_FACTOR = 0.85, 1.5  # edge length given to fTetWild over that of the result
_NARROWER = 0.4  # factor on the envelope where parts are lost
_MAX_LOSS = 0.1  # of the volume; more indicates lost parts

#: Mesher: edge length and width of the envelope, mm, to a mesh.
Mesher = Callable[[float, float], TetMesh]
#: Callback: number of meshes made, of those to make at most, and a note.
Progress = Callable[[int, int, str], None]


class _Attempt(NamedTuple):
    mesh: TetMesh
    envelope: float  # over the edge length
    factor: float
    ratio: float  # of the median edge length to the target
    loss: float  # of volume, as a fraction


def fit_edge_length(
    mesher: Mesher,
    vertices: Points,
    triangles: Triangles,
    length_mm: float,
    progress: Progress | None = None,
) -> TetMesh:
    """Return the mesh whose median edge length is closest to a given one.

    A warning tells a deviation of more than 20 %, as small features of a shape demand. `progress`
    is called after each mesh.

    Raises:
        MeshError: no mesh could be made, or all lost parts of the shape.
    """
    volume = enclosed_volume(vertices, triangles)
    envelope, factor = _FIRST_ENVELOPE, _FIRST_FACTOR
    attempts: list[_Attempt] = []
    failure: MeshError | None = None
    for number in range(1, MAX_ATTEMPTS + 1):
        try:
            mesh = mesher(factor * length_mm, envelope * length_mm)
        except MeshError as error:  # thin parts vanish in a wide envelope
            failure, envelope = error, _NARROWER * envelope
            continue
        mesh = onto_surface(mesh, vertices, triangles, 2.0 * envelope * length_mm)
        ratio = float(np.median(mesh.edge_lengths)) / length_mm
        loss = 1.0 - float(mesh.volumes.sum()) / volume
        attempts.append(_Attempt(mesh, envelope, factor, ratio, loss))
        best = min(attempts, key=_cost)
        done = _cost(best) < _ENOUGH
        if progress is not None:
            note = f", median edge {best.ratio * length_mm:.3g} mm"
            progress(number, number if done else MAX_ATTEMPTS, note)
        if done:
            break
        envelope, factor = _next(attempts)
    if not attempts:
        raise failure or MeshError("No mesh could be made.")
    best = min(attempts, key=_cost)
    if abs(best.loss) > _MAX_LOSS:
        raise MeshError(
            f"The mesh loses {best.loss:.0%} of the volume: the shape has parts thinner than the"
            f" edge length of {length_mm:.4g} mm; choose a smaller one."
        )
    if abs(best.ratio - 1.0) > TOLERANCE:
        _log.warning(
            "The median edge length is %.3g mm, not %.3g mm: %s.",
            best.ratio * length_mm, length_mm,
            "curvature and small features of the surface need smaller elements"
            if best.ratio < 1.0 else "the shape has few places for nodes",
        )  # fmt: skip
    return best.mesh


def mean_ratios(mesh: TetMesh) -> Float[np.ndarray, " m"]:
    """Return the quality of each element: 1 for a regular tetrahedron, 0 for a flat one.

    It is the mean ratio 12 (3 V)^(2/3) / (sum of squared edges) (A. Liu and B. Joe, BIT 34, 1994,
    p. 268).
    """
    squares = (mesh.edge_lengths**2)[mesh.tet_edges].sum(axis=1)
    return np.asarray(12.0 * (3.0 * mesh.volumes) ** (2.0 / 3.0) / squares)


def _cost(attempt: _Attempt) -> float:
    lost = max(abs(attempt.loss) - _MAX_LOSS, 0.0)
    return abs(float(np.log(attempt.ratio))) + 100.0 * lost


def _next(attempts: list[_Attempt]) -> tuple[float, float]:
    """Return envelope and factor of the next mesh.

    It is interpolated between a factor that gives too long edges and one that gives too short ones.
    """
    last = attempts[-1]
    if abs(last.loss) > _MAX_LOSS:
        return _NARROWER * last.envelope, last.factor
    long = min((a for a in attempts if a.ratio > 1.0), key=lambda a: a.factor, default=None)
    short = max((a for a in attempts if a.ratio <= 1.0), key=lambda a: a.factor, default=None)
    if long is not None and short is not None and short.factor < long.factor:
        part = np.log(short.ratio) / np.log(short.ratio / long.ratio)
        factor = short.factor * (long.factor / short.factor) ** np.clip(part, 0.2, 0.8)
        return last.envelope, float(factor)
    if long is None and last.envelope < _LAST_ENVELOPE:
        return min(2.0 * last.envelope, _LAST_ENVELOPE), last.factor
    return last.envelope, min(last.factor / last.ratio, _MAX_FACTOR)
