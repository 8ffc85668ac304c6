"""Presses by a robot's driver as presses over the nodes of the mesh of the inversion."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import Delaunay, QhullError

from tactorch.errors import RobotError, RobotTimeoutError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec, Press
from tactorch.robot.contact import axis_distances, held_on, loads, refined_at_rim
from tactorch.robot.driver import PressCommand, PressReport, Robot
from tactorch.sampling import Patch
from tactorch.sampling.candidates import all_directions

_MIN_NODES = 3  # observed, of a press that is used
_NEAR, _POINTS = 0.5, 12  # distance of points of a fit, over the radius, and least number of them


@dataclass(frozen=True, eq=False)
class RobotPresser:
    """Presser that commands a robot and turns its reports into presses.

    The pressure is uniform over the contact area at the reported pose, and its resultant is the
    measured force. Displacements are interpolated to the nodes within the measured points.

    Attributes:
        robot: Driver of the robot.
        mesh: Mesh of the inversion.
        held: Mask of its fixed nodes.
        material: Constitutive law of the object.
        pressure_mpa: Mean pressure that is commanded, MPa.
        noise_mm: Standard deviation of the displacements that is expected of a press, mm.
        timeout_seconds: Time after which a press is given up, s.
        patches: Reported pose of each press, by its name.
    """

    robot: Robot
    mesh: TetMesh
    held: Bool[np.ndarray, " n"]
    material: MaterialSpec
    pressure_mpa: float
    noise_mm: float
    timeout_seconds: float = 120.0
    patches: dict[str, Patch] = field(default_factory=dict)
    _calls: list[Any] = field(default_factory=list)

    def plan(self, patch: Patch) -> Press:
        """Return the press as it would be reported, with displacement 0."""
        forces = self.pressure_mpa * patch.forces(self.mesh)
        inside = axis_distances(patch, self.mesh.points) <= patch.radius_mm
        observed = all_directions(forces.any(axis=1) & inside)
        return Press(
            forces=forces,
            observed=observed,
            displacement=np.zeros_like(forces),
            fixed=all_directions(self.held),
            noise_mm=self.noise_mm,
            direction=patch.inward,
        )

    def press(self, patch: Patch) -> Press:
        """Carry the press out.

        Raises:
            RobotError: the robot failed, or its report cannot be used.
            RobotTimeoutError: it took longer than `timeout_seconds`.
        """
        force = self.pressure_mpa * np.pi * patch.radius_mm**2
        command = PressCommand(patch.center, patch.inward, patch.radius_mm, force)
        report = self._call(command)
        if not isinstance(report, PressReport):
            raise RobotError(
                f"the robot's press returned {type(report).__name__}; return a PressReport."
            )
        report.check()
        return self._as_press(report, patch.radius_mm)

    def _call(self, command: PressCommand) -> Any:
        """Call the driver in a separate thread, so that one that hangs can be left."""
        if self._calls and not self._calls[-1].done():
            self._wait(self._calls[-1], "the press before it")
        executor = ThreadPoolExecutor(1, thread_name_prefix="robot")
        call = executor.submit(self.robot.press, command)
        executor.shutdown(wait=False)
        self._calls[:] = [call]
        return self._wait(call, "the press")

    def _wait(self, call: Any, what: str) -> Any:
        try:
            return call.result(timeout=self.timeout_seconds)
        except FutureTimeoutError as error:
            if call.done():  # the driver's own error
                raise RobotError(f"the robot failed: {error or type(error).__name__}") from error
            raise RobotTimeoutError(
                f"{what} did not end within {self.timeout_seconds:g} s; check the robot, or raise "
                "robot.timeout_seconds."
            ) from None
        except RobotError:
            raise
        except Exception as error:  # whatever code of another package raises
            raise RobotError(f"the robot failed: {type(error).__name__}: {error}") from error

    def _as_press(self, report: PressReport, radius_mm: float) -> Press:
        patch = Patch(
            np.asarray(report.center_mm, float), np.asarray(report.inward, float), radius_mm
        )
        displacement, observed, noise = _at_nodes(report, patch, self.mesh)
        if observed.sum() < _MIN_NODES:
            raise RobotError(
                f"only {int(observed.sum())} nodes of the mesh are within the "
                f"{len(report.points_mm)} measured points; use a finer mesh, or report points over "
                "the whole contact area."
            )
        name = _press_name(report)
        self.patches[name] = patch
        return Press(
            forces=loads(patch, self.mesh, np.asarray(report.force_n, float)),
            observed=all_directions(observed),
            displacement=displacement,
            fixed=all_directions(self.held),
            noise_mm=noise * float(report.noise_mm),
            direction=patch.inward,
            name=name,
        )

    def fine_prediction(
        self, press: Press, youngs_mpa: float
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]] | None:
        """Return predictions of a mesh that is fine at the rim of the contact, and of the mesh.

        See `tactorch.inverse.shapes.draft.FinePrediction`.
        """
        patch = self.patches.get(press.name)
        if patch is None:
            return None
        mesh = refined_at_rim(self.mesh, patch).mesh
        # New nodes of a held face are held as well.
        held = held_on(mesh, self.mesh, self.held)
        predicted = []
        for on, fixed in ((mesh, held), (self.mesh, self.held)):
            body = SoftBody(on, self._law, element="tet10")
            forces = loads(patch, on, press.total_force)
            supports = Supports(fixed=all_directions(fixed))
            result = body.equilibrate(np.full(on.n_tets, youngs_mpa), forces, supports).require()
            predicted.append(result.displacement[: self.mesh.n_points])
        return predicted[0], predicted[1]

    @cached_property
    def _law(self) -> Any:
        return make_material(
            self.material.name, self.material.poisson, **dict(self.material.parameters)
        )

    def plain(self) -> dict[str, Any]:
        """Return the poses as plain values, from which `restore` continues."""
        return {
            name: [patch.center.tolist(), patch.inward.tolist(), patch.radius_mm]
            for name, patch in self.patches.items()
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take over the poses of presses of a continued run."""
        for name, (center, inward, radius) in plain.items():
            self.patches[name] = Patch(np.array(center), np.array(inward), float(radius))


def _press_name(report: PressReport) -> str:
    center = ", ".join(f"{x:.4f}" for x in np.asarray(report.center_mm))
    stopped = f", stopped: {report.stopped}" if report.stopped else ""
    return f"robot at ({center}) mm{stopped}"


class NodalValues(NamedTuple):
    """Displacements of nodes by measured points.

    Attributes:
        displacement: Displacements, zero where they are not observed, (n, 3), mm.
        observed: Nodes within the measured points, (n,).
        noise: Standard deviation at a node over that at a point, root mean square.
    """

    displacement: Float[np.ndarray, "n 3"]
    observed: Bool[np.ndarray, " n"]
    noise: float


def _at_nodes(report: PressReport, patch: Patch, mesh: TetMesh) -> NodalValues:
    """Return displacements at the loaded nodes within the measured points.

    A quadratic polynomial is fitted to the points around each node, by weights that fall to zero at
    a distance of half the radius (moving least squares). It averages the noise of many points.
    """
    loaded = np.flatnonzero(patch.forces(mesh).any(axis=1))
    plane = np.linalg.svd(patch.inward[None])[2][1:]  # two axes across the push
    points, nodes = (
        (p - patch.center) @ plane.T for p in (np.asarray(report.points_mm), mesh.points[loaded])
    )
    displacement, observed = np.zeros((mesh.n_points, 3)), np.zeros(mesh.n_points, dtype=bool)
    try:
        inside = Delaunay(points).find_simplex(nodes) >= 0
    except (QhullError, ValueError):  # fewer than three points, or all on a line
        return NodalValues(displacement, observed, 1.0)
    rows = [_smoothing(points, node, _NEAR * patch.radius_mm) for node in nodes[inside]]
    if rows:
        displacement[loaded[inside]] = np.array(rows) @ np.asarray(report.displacements_mm)
    observed[loaded[inside]] = True
    return NodalValues(
        displacement, observed, float(np.sqrt(np.sum(np.square(rows)) / len(rows))) if rows else 1.0
    )


def _smoothing(
    points: Float[np.ndarray, "k 2"], node: Float[np.ndarray, "2"], reach_mm: float
) -> Float[np.ndarray, " k"]:
    """Return the weights of measured points in the value at a node."""
    offsets = points - node
    distances = np.linalg.norm(offsets, axis=1)
    reach = max(reach_mm, 1.01 * float(np.sort(distances)[min(_POINTS, len(points)) - 1]))
    weights = np.maximum(1.0 - (distances / reach) ** 2, 0.0)
    x, y = (offsets / reach).T
    terms = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    # The value of the polynomial at the node is its first coefficient.
    root = np.sqrt(weights)
    return np.linalg.pinv(terms * root[:, None], rcond=1e-6)[0] * root
