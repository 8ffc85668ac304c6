"""The same presses on a locally refined mesh."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError
from tactorch.mesh.refine import Refinement, Sizing, refine
from tactorch.mesh.smooth_tractions import smooth_traction
from tactorch.mesh.tractions import LoadedSurface, loaded_triangles
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording


def refine_recording(
    recording: Recording, sizing: Sizing, *, smooth_tractions: bool = False
) -> Recording:
    """Refine the mesh of a recording; the data, loads and supports remain the same.

    See `prolong_recording`, which also takes a refinement whose `parents` are needed elsewhere.

    Args:
        recording: Recording on the coarse mesh.
        sizing: Maximum edge length (mm) at points (mm); see `tactorch.mesh.refine`.
        smooth_tractions: See `prolong_recording`.

    Returns:
        The recording on the fine mesh; `recording` where no edge is too long.

    Raises:
        ConfigError: `sizing` returns invalid edge lengths.
    """
    refinement = refine(recording.mesh, sizing)
    return prolong_recording(recording, refinement, smooth_tractions=smooth_tractions)


def prolong_recording(
    recording: Recording, refinement: Refinement, *, smooth_tractions: bool = False
) -> Recording:
    """Return a recording on the fine mesh of a refinement of its mesh.

    Only the coarse nodes are observed. New nodes have no data, and zero weight where weights are
    given. The moduli `truth` and `reference` are those of the parent elements, and `prescribed` is
    interpolated linearly. The provenance states no inverse crime.

    Nodal forces stand for a traction (N/mm^2) that is linear on each loaded coarse triangle; see
    `tactorch.mesh.tractions`. Those of the fine mesh are the integrals of the same traction, so
    that the total force and moment remain. Springs stand for a density (N/mm^3), whose value at a
    vertex is that of the spring over a third of the area of the vertex's triangles. A fine triangle
    of area A adds A / 3 times the density at each vertex to the spring of this vertex; none is
    negative. Nodes whose triangles are not bisected, or that have no loaded triangle, keep their
    values.

    A new node is fixed along an axis if it is on a coarse boundary triangle whose three vertices
    are. New nodes of edges and of interior faces between fixed nodes are free otherwise.

    Args:
        recording: Recording on `refinement.coarse`.
        refinement: Coarse and fine mesh.
        smooth_tractions: Where a contact ends within triangles, and its rim is refined, the
            traction is the smoothest with these nodal forces that vanishes at the rim; see
            `tactorch.mesh.smooth_tractions`.

    Returns:
        The recording on `refinement.mesh`; `recording` where that has no new nodes.

    Raises:
        RecordingError: The recording is on another mesh than `refinement.coarse`.
    """
    coarse = refinement.coarse
    if recording.mesh is not coarse and recording.mesh.content_hash() != coarse.content_hash():
        raise RecordingError(
            f"refinement is of another mesh ({coarse.n_points} nodes, {coarse.n_tets} elements) "
            f"than the recording's ({recording.mesh.n_points} nodes, {recording.mesh.n_tets} "
            "elements); refine the mesh of this recording"
        )
    if not len(refinement.ends):
        return recording
    new, parents = len(refinement.ends), refinement.parents
    unloaded, truth, reference = recording.unloaded, recording.truth, recording.reference
    provenance = dict(recording.provenance)
    if provenance.get("inverse_crime"):
        provenance["inverse_crime"] = False  # the presses were not computed on the fine mesh
    return replace(
        recording,
        mesh=refinement.mesh,
        presses=tuple(
            _prolong_press(press, refinement, smooth_tractions) for press in recording.presses
        ),
        truth=None if truth is None else truth[parents],
        reference=None if reference is None else reference[parents],
        unloaded=None
        if unloaded is None
        else np.pad(unloaded, ((0, 0), (0, new), (0, 0)), constant_values=np.nan),
        provenance=provenance,
        check_units=False,
    )


def _prolong_press(press: Press, refinement: Refinement, smooth: bool) -> Press:
    rows = ((0, len(refinement.ends)), (0, 0))
    fixed = prolong_fixed(press.fixed, refinement)
    return replace(
        press,
        forces=_prolong_forces(press.forces, refinement, smooth),
        observed=np.pad(press.observed, rows),
        displacement=np.pad(press.displacement, rows, constant_values=np.nan),
        springs=_prolong_springs(press.springs, refinement),
        fixed=fixed,
        prescribed=np.where(fixed, refinement.interpolate(press.prescribed), 0.0),
        weights=None if press.weights is None else np.pad(press.weights, rows),
    )


def _prolong_forces(
    forces: Float[np.ndarray, "n 3"], refinement: Refinement, smooth: bool
) -> Float[np.ndarray, "fine 3"]:
    """Return the nodal forces of the same traction on the fine mesh."""
    coarse, fine = _loaded(forces, refinement)
    traction = smooth_traction(refinement, coarse, fine, forces) if smooth else None
    if traction is None:
        traction = refinement.interpolate(coarse.tractions(forces))
    out = fine.mass @ traction
    return _with_unchanged(out, forces, coarse, fine)


def _prolong_springs(
    springs: Float[np.ndarray, "n 3"], refinement: Refinement
) -> Float[np.ndarray, "fine 3"]:
    """Spread springs of the coarse mesh to the fine nodes of its triangles; none is negative."""
    coarse, fine = _loaded(springs, refinement)
    density = np.zeros_like(springs)
    density[coarse.nodes] = springs[coarse.nodes] / coarse.areas_around[coarse.nodes, None]
    out = refinement.interpolate(density) * fine.areas_around[:, None]
    return _with_unchanged(out, springs, coarse, fine)


def _loaded(
    values: Float[np.ndarray, "n 3"], refinement: Refinement
) -> tuple[LoadedSurface, LoadedSurface]:
    """Return the loaded triangles of the coarse mesh, and those of the fine mesh within them."""
    surface, mesh = refinement.coarse.surface, refinement.mesh
    inside = loaded_triangles(surface, values)[refinement.surface_parents]
    triangles, areas = mesh.surface.triangles[inside], mesh.surface.areas[inside]
    return LoadedSurface.of(surface, values), LoadedSurface(triangles, areas, mesh.n_points)


def _with_unchanged(
    out: Float[np.ndarray, "fine 3"],
    values: Float[np.ndarray, "n 3"],
    coarse: LoadedSurface,
    fine: LoadedSurface,
) -> Float[np.ndarray, "fine 3"]:
    """Restore the values of nodes without loaded triangles, or whose triangles are not bisected."""
    n, before = len(values), coarse.areas_around
    same = np.isclose(fine.areas_around[:n], before, rtol=1e-12, atol=0.0) | (before == 0)
    out[:n][same] = values[same]
    return out


def prolong_fixed(
    fixed: Bool[np.ndarray, "n 3"], refinement: Refinement
) -> Bool[np.ndarray, "fine 3"]:
    """Fix the fine nodes of boundary triangles whose coarse vertices are all fixed, by axis."""
    out = np.pad(fixed, ((0, len(refinement.ends)), (0, 0)))
    by_triangle = fixed[refinement.coarse.surface.triangles].all(axis=1)[refinement.surface_parents]
    rows, axes = np.nonzero(by_triangle)
    out[refinement.mesh.surface.triangles[rows], axes[:, None]] = True
    return out
