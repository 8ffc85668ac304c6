"""The same presses on a locally refined mesh."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError
from tactorch.mesh.refine import Refinement, Sizing, refine
from tactorch.recording.press import Press
from tactorch.recording.recording import Recording


def refine_recording(recording: Recording, sizing: Sizing) -> Recording:
    """Refine the mesh of a recording; the data, loads and supports remain the same.

    See `prolong_recording`, which also takes a refinement whose `parents` are needed elsewhere.

    Args:
        recording: Recording on the coarse mesh.
        sizing: Maximum edge length (mm) at points (mm); see `tactorch.mesh.refine`.

    Returns:
        The recording on the fine mesh; `recording` where no edge is too long.

    Raises:
        ConfigError: `sizing` returns invalid edge lengths.
    """
    return prolong_recording(recording, refine(recording.mesh, sizing))


def prolong_recording(recording: Recording, refinement: Refinement) -> Recording:
    """Return a recording on the fine mesh of a refinement of its mesh.

    Only the coarse nodes are observed. New nodes have no data, and zero weight where weights are
    given. The moduli `truth` and `reference` are those of the parent elements, and `prescribed` is
    interpolated linearly.

    Nodal forces and springs stand for a surface density (N/mm^2, N/mm^3) that is linear on each
    loaded coarse triangle. Its value at a vertex is the nodal value over a third of the area of the
    vertex's loaded triangles; a uniform pressure is thus constant. A fine triangle of area A adds
    A / 3 times the density at each vertex to the load of this vertex. Totals are those of the
    coarse mesh, and nodes whose triangles are not bisected have the same load as before. As in
    `Discretisation.consistent_load_matrix`, a triangle is loaded if all its vertices have non-zero
    loads, and vertices without a loaded triangle keep theirs.

    A new node is fixed along an axis if it is on a coarse boundary triangle whose three vertices
    are. New nodes of edges and of interior faces between fixed nodes are free otherwise.

    Args:
        recording: Recording on `refinement.coarse`.
        refinement: Coarse and fine mesh.

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
    return replace(
        recording,
        mesh=refinement.mesh,
        presses=tuple(_prolong_press(press, refinement) for press in recording.presses),
        truth=None if truth is None else truth[parents],
        reference=None if reference is None else reference[parents],
        unloaded=None
        if unloaded is None
        else np.pad(unloaded, ((0, 0), (0, new), (0, 0)), constant_values=np.nan),
        check_units=False,
    )


def _prolong_press(press: Press, refinement: Refinement) -> Press:
    rows = ((0, len(refinement.ends)), (0, 0))
    fixed = _prolong_fixed(press.fixed, refinement)
    return replace(
        press,
        forces=_prolong_loads(press.forces, refinement),
        observed=np.pad(press.observed, rows),
        displacement=np.pad(press.displacement, rows, constant_values=np.nan),
        springs=_prolong_loads(press.springs, refinement),
        fixed=fixed,
        prescribed=np.where(fixed, refinement.interpolate(press.prescribed), 0.0),
        weights=None if press.weights is None else np.pad(press.weights, rows),
    )


def _prolong_loads(
    values: Float[np.ndarray, "n 3"], refinement: Refinement
) -> Float[np.ndarray, "fine 3"]:
    """Spread nodal loads of the coarse mesh to the fine nodes of its loaded triangles."""
    coarse, fine = refinement.coarse.surface, refinement.mesh.surface
    loaded = (values != 0).any(axis=1)[coarse.triangles].all(axis=1)
    loaded_fine = loaded[refinement.surface_parents]
    n = len(values)
    areas = np.bincount(
        coarse.triangles[loaded].ravel(), np.repeat(coarse.areas[loaded], 3), minlength=n
    )
    fine_areas = np.bincount(
        fine.triangles[loaded_fine].ravel(),
        np.repeat(fine.areas[loaded_fine], 3),
        minlength=refinement.mesh.n_points,
    )
    spread = areas > 0
    density = np.zeros_like(values)
    density[spread] = values[spread] / areas[spread, None]
    out = refinement.interpolate(density) * fine_areas[:, None]
    same = np.flatnonzero(~spread | np.isclose(fine_areas[:n], areas, rtol=1e-12, atol=0.0))
    out[same] = values[same]
    return out


def _prolong_fixed(
    fixed: Bool[np.ndarray, "n 3"], refinement: Refinement
) -> Bool[np.ndarray, "fine 3"]:
    """Fix the fine nodes of boundary triangles whose coarse vertices are all fixed, by axis."""
    out = np.pad(fixed, ((0, len(refinement.ends)), (0, 0)))
    by_triangle = fixed[refinement.coarse.surface.triangles].all(axis=1)[refinement.surface_parents]
    for axis in range(3):
        out[refinement.mesh.surface.triangles[by_triangle[:, axis]], axis] = True
    return out
