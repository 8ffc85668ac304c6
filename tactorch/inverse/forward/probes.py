"""Probes of a recording on a body, and the data that are not displacements of nodes."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import EquilibriumResult, Newton, SoftBody, Supports
from tactorch.fem.contact import Contact
from tactorch.fem.elements import Discretisation
from tactorch.fem.linearization import ReadingRates
from tactorch.fem.readings import Wrench, surface_rows
from tactorch.linalg import map_cases
from tactorch.recording import Press, Recording

_MAX_CALIBRATING = 4  # presses for the modulus of contacts
_ASSUMED_MPA = 0.2  # modulus for the stiffness of contacts where no force is measured


@dataclass(frozen=True, eq=False)
class PressReadings:
    """Data of a press that are not displacements of nodes, on a body."""

    surface: sp.csr_matrix | None  # from the displacements of all nodes
    wrench: Wrench | None

    @staticmethod
    def of(press: Press, discretisation: Discretisation) -> "PressReadings":
        """Return the readings of a press."""
        surface, force = press.surface, press.force
        return PressReadings(
            None
            if surface is None
            else surface_rows(discretisation, surface.points_mm, surface.directions),
            None if force is None else Wrench(force.axes, force.about_mm),
        )

    def predicted(self, search: Newton, result: EquilibriumResult) -> Float[np.ndarray, " k"]:
        """Return the data at an equilibrium, mm, N or N mm."""
        parts = [np.zeros(0)]
        if self.surface is not None:
            parts.append(self.surface @ result.displacement.ravel())
        if self.wrench is not None:
            parts.append(self.wrench.value(search, result))
        return np.concatenate(parts)

    def rates(self, search: Newton, result: EquilibriumResult) -> ReadingRates | None:
        """Return their derivatives at an equilibrium; None without data."""
        parts = []
        if self.surface is not None:
            parts.append(ReadingRates.of_displacements(self.surface))
        if self.wrench is not None:
            parts.append(self.wrench.rates(search, result))
        return ReadingRates.stack(parts) if parts else None

    def by_motion(self, search: Newton, result: EquilibriumResult) -> Float[np.ndarray, "k 3"]:
        """Return the derivatives by the probe's position at constant displacements, 1/mm."""
        parts = [np.zeros((0, 3))]
        if self.surface is not None:
            parts.append(np.zeros((self.surface.shape[0], 3)))
        if self.wrench is not None:
            parts.append(self.wrench.by_motion(search, result))
        return np.vstack(parts)


def make_contact(press: Press, body: SoftBody, modulus: float) -> Contact | None:
    """Return the contact of a press with its probe, of a stiffness by a modulus (MPa), or None.

    Raises:
        ConfigError: a probe does not touch the body; names the press.
    """
    pose = press.probe
    if pose is None:
        return None
    try:
        return Contact.of(
            body.discretisation, pose.probe, pose.position_mm, modulus, rotation=pose.rotation
        )
    except ConfigError as error:
        raise ConfigError(f"{press.label}: {error}") from error


def apparent_mpa(recording: Recording, body: SoftBody) -> float:
    """Return the uniform modulus by the measured forces on the probes of some presses, MPa.

    Without other loads the force on a probe at a given pose is proportional to it. Elements are
    linear: the modulus is for the stiffness of contacts, and for starts.

    Raises:
        ConfigError: a probe does not touch the body, or the forces have the wrong sign.
        ConvergenceError: a press has no equilibrium on a uniform body; names the press.
    """
    with_both = [p for p in recording.presses if p.probe is not None and p.force is not None]
    count = min(len(with_both), _MAX_CALIBRATING)
    if not count:
        return _ASSUMED_MPA
    if body.discretisation.element.quadratic:
        body = SoftBody(body.mesh, body.material, solver=body.solver, newton=body.newton)
    chosen = [with_both[i] for i in np.linspace(0, len(with_both) - 1, count).astype(int)]
    pairs = map_cases(lambda i: _unit_forces(chosen[i], body), count)
    predicted, measured = (np.concatenate(part) for part in zip(*pairs, strict=True))
    ratio = float(predicted @ measured) / max(float(predicted @ predicted), 1e-300)
    if ratio <= 0.0:
        raise ConfigError(
            f"The measured forces of {chosen[0].label} and others pull the probe into the body; "
            "give the force on the probe (N), in the axes of the mesh."
        )
    return ratio


def _unit_forces(press: Press, body: SoftBody) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces for a modulus of 1 MPa, and the measured ones, in deviations."""
    assert press.force is not None
    supports = Supports(press.fixed, press.prescribed, press.springs)
    uniform, nothing = np.ones(body.mesh.n_tets), np.zeros((body.n_nodes, 3))
    search = body.search(uniform, nothing, supports, contact=make_contact(press, body, 1.0))
    result = search.run()
    if not result.converged:
        raise ConvergenceError(f"{press.label}: {result.reason}")
    wrench = Wrench(press.force.axes, press.force.about_mm)
    deviations = press.force.deviations
    return wrench.value(search, result) / deviations, press.force.values / deviations
