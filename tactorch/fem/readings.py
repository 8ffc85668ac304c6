"""Data of a press that are not displacements of nodes, with their derivatives at equilibrium.

A displacement along a direction at a point of the surface is linear in the nodal displacements. A
component of the force or moment on a probe, or on a support that is moved, follows from the
equilibrium; its derivative by Young's modulus has a direct part where the support is a part of the
body's boundary.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.fem.elements import Discretisation
from tactorch.fem.linearization import ReadingRates
from tactorch.fem.newton import EquilibriumResult, Newton
from tactorch.mesh.closest import Closest, closest_points

_MAX_DISTANCE = 0.05  # of a datum from the surface, over the size of the body


def surface_rows(
    discretisation: Discretisation,
    points_mm: Float[np.ndarray, "k 3"],
    directions: Float[np.ndarray, "k 3"],
    closest: Closest | None = None,
) -> sp.csr_matrix:
    """Return the map from nodal displacements to those along directions at surface points.

    The points of the surface are those nearest to the given ones, `closest` where they are known
    already. A `ConfigError` names one that is far from the surface.
    """
    mesh, surface = discretisation.mesh, discretisation.mesh.surface
    closest = closest or closest_points(mesh.points, surface.triangles, points_mm)
    farthest = int(closest.distances.argmax())
    if closest.distances[farthest] > _MAX_DISTANCE * mesh.diagonal:
        raise ConfigError(
            f"surface point {farthest} at {np.round(points_mm[farthest], 3).tolist()} mm is "
            f"{closest.distances[farthest]:.3g} mm from the body; check its unit and axes."
        )
    nodes = discretisation.surface_nodes(surface.triangles[closest.triangles])
    values = discretisation.surface_values(closest.barycentric)
    entries = values[:, :, None] * directions[:, None, :]
    columns = 3 * nodes[:, :, None] + np.arange(3)
    rows = np.repeat(np.arange(len(points_mm)), entries[0].size if len(entries) else 0)
    shape = (len(points_mm), 3 * discretisation.n_nodes)
    return sp.csr_matrix((entries.ravel(), (rows, columns.ravel())), shape=shape)


@dataclass(frozen=True, eq=False)
class Wrench:
    """Components of the force and moment on a probe, or on the support that is moved.

    A `ConfigError` is raised where there is no probe and no support is moved.
    """

    axes: Float[np.ndarray, "k 6"]  # each row has the weights of force (N) and moment (N mm)
    about_mm: Float[np.ndarray, "3"]  # point of the moment

    def value(self, search: Newton, result: EquilibriumResult) -> Float[np.ndarray, " k"]:
        """Return the components at an equilibrium."""
        if search.contact is not None:
            forces = search.contact.at(result.displacement).forces
        else:
            forces = self._on_support(search, result)
        return np.asarray(self._weights(search, result) @ forces.ravel())

    def rates(self, search: Newton, result: EquilibriumResult) -> ReadingRates:
        """Return the derivatives at an equilibrium."""
        weights = self._weights(search, result)
        if search.contact is None:
            weights[:, ~self._moved(search).ravel()] = 0.0
            rows = -search.tangent_times(result, weights.T).T
            turned = self._by_arms(self._on_support(search, result))
            return ReadingRates(sp.csr_matrix(rows + turned), sp.csr_matrix(-weights))
        contact = search.contact.at(result.displacement)
        rows = (search.contact.tangent(contact) @ weights.T).T
        return ReadingRates.of_displacements(sp.csr_matrix(rows + self._by_arms(contact.forces)))

    def _on_support(
        self, search: Newton, result: EquilibriumResult
    ) -> Float[np.ndarray, "nodes 3"]:
        """Forces of the body on the support that is moved, N."""
        return np.where(self._moved(search), -search.support_forces(result), 0.0)

    def _by_arms(self, forces: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "k unknowns"]:
        """Derivatives of the moments of constant forces by the displacements."""
        turned: np.ndarray = np.cross(forces[None], self.axes[:, None, 3:])
        return turned.reshape(len(self.axes), -1)

    def by_motion(self, search: Newton, result: EquilibriumResult) -> Float[np.ndarray, "k 3"]:
        """Return the derivatives by the position of the probe at constant displacements, 1/mm."""
        assert search.contact is not None
        contact = search.contact.tangent(search.contact.at(result.displacement))
        forces = contact @ self._weights(search, result).T
        return -forces.reshape(-1, 3, len(self.axes)).sum(axis=0).T

    def _weights(
        self, search: Newton, result: EquilibriumResult
    ) -> Float[np.ndarray, "k unknowns"]:
        """Weight of each nodal force in each component."""
        positions = search.assembly.discretisation.extend(search.assembly.points)
        arms = positions + result.displacement - self.about_mm
        turns = np.cross(self.axes[:, None, 3:], arms[None])
        return np.asarray((self.axes[:, None, :3] + turns).reshape(len(self.axes), -1))

    def _moved(self, search: Newton) -> Bool[np.ndarray, "nodes 3"]:
        moved = (search.supports.prescribed != 0.0).any(axis=1)
        if not moved.any():
            raise ConfigError(
                "A force is measured where nothing is prescribed: there is no probe, and no "
                "support is moved. Give the probe, or the prescribed displacement."
            )
        return search.supports.fixed & moved[:, None]
