"""Forces at finite strains, by an expansion in the amplitude of the measured displacement.

Forces and displacements are power series in a factor of the measured displacement (the
perturbation of the asymptotic numerical method; Damil and Potier-Ferry, 1990). Every order is the
solution of a linear problem with the tangent at rest: two solves an order, and no iteration that
may fail.
"""

import numpy as np

from tactorch.errors import ConvergenceError
from tactorch.sensor.gel.body import NodeVectors as Nodes
from tactorch.sensor.gel.force_fit import ForceFit, Vectors
from tactorch.sensor.gel.model import GelModel

_ORDERS = 3
_DIFFERENCE = 0.05  # of the factor, for derivatives of the internal forces
_MAX_DEPTH = 0.6  # of the thickness
_MAX_LAST = 0.15  # of the total force in the last order, above which the series is not summed


def expand_forces(fit: ForceFit, linear: Vectors) -> tuple[Vectors, Vectors]:
    """Return forces (N) and displacements (mm) of the face at finite strains.

    The first order are the `linear` forces, at small strains. The prior of the fit to the
    displacements of a frame keeps its weight.

    Raises:
        ConvergenceError: The deformation is too large for the expansion.
    """
    depth_mm = -float(fit.face_displacement(linear)[:, 2].min())
    thickness_mm = float(fit.model.gel.thickness_mm)
    if depth_mm > _MAX_DEPTH * thickness_mm:
        raise ConvergenceError(
            f"the gel is deformed too much for its model: it would be pressed in by {depth_mm:.3g}"
            f" mm of its {thickness_mm:g} mm. Is the depth of this frame right?"
        )
    model, face = fit.model, fit.model.gel_mesh.face
    forces, moved = [linear], [_solve(model, model.load_matrix @ linear)]
    for order in range(2, _ORDERS + 1):
        relaxed = _solve(model, _nonlinear_forces(model, moved, linear, order))
        forces.append(fit.refit(relaxed[face]))
        if order < _ORDERS:
            moved.append(_solve(model, model.load_matrix @ forces[-1]) - relaxed)
    on_face = [part[face] for part in moved]
    on_face.append(fit.face_displacement(forces[-1]) - relaxed[face])
    totals = [part.sum(axis=0) for part in forces]
    whole = float(np.linalg.norm(np.sum(totals, axis=0)))
    last = float(np.linalg.norm(totals[-1])) / max(whole, 1e-300)
    if last > _MAX_LAST:
        raise ConvergenceError(
            f"the gel is deformed too much for its model: the last correction for finite strains is"
            f" {last:.0%} of the force. The depth is too large for the gel's thickness, or wrong."
        )
    return np.sum(forces, axis=0), np.sum(on_face, axis=0)


def _solve(model: GelModel, forces: Nodes) -> Nodes:
    """Displacements at small strains of all element nodes by forces on them, mm."""
    return model.rest.linearization.solve(forces.ravel()).reshape(-1, 3)


def _nonlinear_forces(model: GelModel, moved: list[Nodes], linear: Vectors, order: int) -> Nodes:
    """Coefficient of an order of the internal forces by the displacements of lower orders, N.

    Even and odd coefficients follow from sums and differences at plus and minus a small factor;
    those of lower orders are in balance with the loads.
    """
    above, below = (
        _internal_forces(model, np.sum([f ** (n + 1) * u for n, u in enumerate(moved)], axis=0))
        for f in (_DIFFERENCE, -_DIFFERENCE)
    )
    if order == 2:
        return 0.5 * (above + below) / _DIFFERENCE**2
    first = _DIFFERENCE * (model.load_matrix @ linear)
    return (0.5 * (above - below) - first) / _DIFFERENCE**3


def _internal_forces(model: GelModel, displacement: Nodes) -> Nodes:
    """Elastic forces at displacements of all element nodes; ConvergenceError if one is inverted."""
    response = model.body.assembly.respond(displacement)
    if response is None:
        raise ConvergenceError(
            "the measured deformation inverts elements of the gel; the depth or the markers of this"
            " frame are wrong."
        )
    return model.body.assembly.internal_force(response, model.youngs)
