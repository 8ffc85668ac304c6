"""A simulated robot with delays, wrong poses and a force limit, on a separate mesh."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ForceLimitError, PoseRefusedError, RobotError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.transfer import Transfer
from tactorch.mesh import TetMesh, face_nodes
from tactorch.mesh.closest import closest_points
from tactorch.phantoms import Phantom
from tactorch.phantoms.library import PHANTOMS  # noqa: F401  (the registry of the section)
from tactorch.robot.contact import across, loads, refined_at_rim
from tactorch.robot.driver import PressCommand, PressReport
from tactorch.sampling import Patch
from tactorch.sampling.candidates import all_directions

#: Drivers by name. Packages add theirs by an entry point of the group `tactorch.presser`.
PRESSERS = Registry(
    "presser",
    {
        "none": "tactorch.robot.simulated:NoRobot",
        "simulated": "tactorch.robot.simulated:SimulatedRobot",
        "driver": "tactorch.robot.driver:CustomRobot",
    },
)
_SAMPLES = 4  # along the edge of an element that an inclusion cuts
_RINGS = 6  # of measured points, over the radius


@dataclass(frozen=True)
class NoRobot(Options):
    """No robot: presses are appended to the recording by others."""

    section: ClassVar[str] = "presser"


@dataclass(frozen=True)
class SimulatedRobot(Options):
    """Simulated robot with delays, wrong poses and a force limit, for tests without a robot.

    Presses are solved with quadratic elements on a mesh that conforms to the inclusions, and that
    is not the mesh of the inversion. The achieved pose differs from the commanded one, and the
    reported pose from both. All deviations are of normal distributions.
    """

    section: ClassVar[str] = "presser"

    phantom: Any = option("cube_sphere", "Object and its inclusions", section="phantom")
    poisson: float = option(0.45, "Poisson's ratio of the object, neo-Hookean", gt=-1, lt=0.5)
    edge_mm: float = option(1.0, "Edge length of the mesh of the presses", unit="mm", gt=0)
    conforming: bool = option(
        True, "Whether faces of elements follow the inclusions; false: elements have mean moduli"
    )
    held_face: str = option("z-", "Face of the bounding box that is held")
    noise_mm: float = option(0.003, "Noise of displacements", unit="mm", gt=0)
    pose_deviation_mm: float = option(
        0.2, "Deviation of the achieved position from the commanded one, across the push",
        unit="mm", ge=0,
    )  # fmt: skip
    tilt_deviation_deg: float = option(
        0.5, "Deviation of the achieved direction from the commanded one", unit="degrees", ge=0
    )
    report_deviation_mm: float = option(
        0.05, "Deviation of the reported position from the achieved one, across the push",
        unit="mm", ge=0,
    )  # fmt: skip
    force_deviation: float = option(
        0.005, "Relative deviation of the reported force from the achieved one", ge=0
    )
    max_force_n: float | None = option(None, "Force limit; null: none", unit="N", gt=0)
    at_limit: Literal["stop", "refuse"] = option(
        "stop", "Press up to the limit and report that, or refuse the press"
    )
    failure_rate: float = option(
        0.0, "Probability that a pose is refused; a refused pose stays refused", ge=0, le=1
    )
    move_seconds: float = option(0.0, "Time of a motion to a pose", unit="s", ge=0)
    press_seconds: float = option(0.0, "Time of a press", unit="s", ge=0)
    real_time: bool = option(False, "Wait for these times; false: only count them")
    seed: int = option(0, "Seed of all deviations", ge=0)
    sleep: Callable[[float], None] = field(default=time.sleep, repr=False, compare=False)

    @property
    def elapsed_seconds(self) -> float:
        """Time of the simulated clock, s."""
        return float(self._clock[0])

    @cached_property
    def _clock(self) -> list[float]:
        return [0.0]

    def press(self, command: PressCommand) -> PressReport:
        """Carry a press out; see `tactorch.robot.Robot.press`."""
        rng = np.random.default_rng([self.seed, *_place(command)])
        self._pass(self.move_seconds)
        if rng.uniform() < self.failure_rate:
            raise PoseRefusedError(f"the pose at {_text(command.center_mm)} mm is refused")
        force, stopped = self._limited(command)
        patch = self._achieved(command, rng)
        self._pass(self.press_seconds)
        points = _disc(patch, self.mesh)
        moved = self._displacements(patch, force, points)
        shift = self.report_deviation_mm * _across(patch.inward, rng)
        measured = force * (1.0 + self.force_deviation * rng.standard_normal())
        return PressReport(
            patch.center + shift,
            patch.inward,
            measured * patch.inward,
            points + shift,
            moved + self.noise_mm * rng.standard_normal(moved.shape),
            self.noise_mm,
            stopped,
        )

    def _pass(self, seconds: float) -> None:
        self._clock[0] += seconds
        if self.real_time and seconds:
            self.sleep(seconds)

    def _limited(self, command: PressCommand) -> tuple[float, str]:
        """Return the force that is reached, N, and why it is less than commanded."""
        limit = self.max_force_n
        if limit is None or command.force_n <= limit:
            return command.force_n, ""
        if self.at_limit == "refuse":
            raise ForceLimitError(
                f"the press needs {command.force_n:.3g} N, more than the limit of {limit:g} N"
            )
        return limit, "force limit"

    def _achieved(self, command: PressCommand, rng: np.random.Generator) -> Patch:
        tilt = np.deg2rad(self.tilt_deviation_deg) * _across(command.inward, rng)
        inward = command.inward + tilt
        center = command.center_mm + self.pose_deviation_mm * _across(command.inward, rng)
        mesh = self.mesh
        center = closest_points(mesh.points, mesh.surface.triangles, center[None]).points[0]
        return Patch(center, inward / np.linalg.norm(inward), command.radius_mm)

    def _displacements(
        self, patch: Patch, force_n: float, points: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 3"]:
        fine = refined_at_rim(self.mesh, patch)
        held = np.isin(np.arange(fine.mesh.n_points), face_nodes(fine.mesh, self.held_face))
        body = SoftBody(fine.mesh, make_material("neo_hookean", self.poisson), element="tet10")
        forces = loads(patch, fine.mesh, force_n * patch.inward)
        supports = Supports(fixed=all_directions(held))
        result = body.equilibrate(self._youngs[fine.parents], forces, supports)
        if not result.converged:
            raise RobotError(f"the object collapses at {_text(patch.center)} mm: {result.reason}")
        return Transfer.between(body.discretisation, points)(result.displacement)

    @cached_property
    def _phantom(self) -> Phantom:
        return self.phantom if isinstance(self.phantom, Phantom) else self.phantom.build()

    @cached_property
    def mesh(self) -> TetMesh:
        """Mesh of the presses, before it is refined at the rims of contacts."""
        conforming = self.conforming and bool(self._phantom.inclusions)
        return self._phantom.mesh(self.edge_mm, conforming=conforming)

    @cached_property
    def outline(self) -> Any:
        """Shape of the object without its inclusions, which a user knows."""
        return self._phantom.body

    @cached_property
    def _youngs(self) -> Float[np.ndarray, " m"]:
        samples = 1 if self.conforming else _SAMPLES
        return np.asarray(self._phantom.on_mesh(self.mesh, samples))


def _disc(patch: Patch, mesh: TetMesh) -> Float[np.ndarray, "k 3"]:
    """Return points of the surface within a patch, mm, on rings."""
    flat = [np.zeros((1, 2))]
    for ring in range(1, _RINGS + 1):
        turns = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        flat.append(ring / _RINGS * np.column_stack([np.cos(turns), np.sin(turns)]))
    points = patch.center + patch.radius_mm * np.concatenate(flat) @ across(patch.inward)
    closest: np.ndarray = closest_points(mesh.points, mesh.surface.triangles, points).points
    return closest


def _across(inward: Float[np.ndarray, "3"], rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Return a normal vector of unit deviation across a direction."""
    vector = rng.standard_normal(3)
    return vector - (vector @ inward) * inward


def _place(command: PressCommand) -> list[int]:
    values = np.round(np.concatenate([command.center_mm, command.inward]) * 1e6).astype(np.int64)
    return [int(value) & 0xFFFFFFFF for value in values]


def _text(point: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{x:.2f}' for x in point)})"
