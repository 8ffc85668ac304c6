"""The part of `tactorch live` in which a robot presses by itself."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tactorch.cli.settings import material_spec
from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.fem import MATERIALS  # noqa: F401  (the registry of the section)
from tactorch.inverse.search.draft_errors import DraftOptions
from tactorch.mesh import TetMesh, face_nodes, read_mesh
from tactorch.phantoms import Phantom
from tactorch.robot import RobotPresser, RobotSession, SimulatedRobot, StopRule, pressable_patches
from tactorch.robot.driver import CustomRobot
from tactorch.sampling import Observer, Patch, candidate_patches
from tactorch.sampling.candidates import MIN_FACING

_MANY = 100_000  # candidates before those are left out that cannot be pressed
_EDGE_PER_RADIUS = 0.7


@dataclass(frozen=True)
class RobotOptions(Options):
    """Object of a robot, its presses and what it may do."""

    section: ClassVar[str] = "robot"

    mesh: Path | None = option(
        None, "Mesh of the object (.vtu, .msh), mm; null: that of the simulated robot's object"
    )
    material: Any = option("neo_hookean", "Material of the object", section="material")
    held_face: str = option("z-", "Face of the bounding box that is held")
    radius_mm: float = option(2.0, "Radius of the sensor's contact area", unit="mm", gt=0)
    pressure_mpa: float = option(0.015, "Mean pressure of a press", unit="MPa", gt=0)
    noise_mm: float = option(
        0.003, "Noise of displacements that is expected of a press", unit="mm", gt=0
    )
    pose_deviation_mm: float = option(
        0.05, "Standard deviation of the reported positions", unit="mm", ge=0
    )
    margin_mm: float = option(
        0.3, "Distance of the contact from edges of the object, at least", unit="mm", ge=0
    )
    approach: tuple[float, float, float] = option(
        (0.0, 0.0, -1.0), "Direction from which the robot comes"
    )
    max_tilt_deg: float = option(
        45.0, "Largest angle between a push and this direction", unit="degrees", gt=0, le=180
    )
    candidates: int = option(25, "Number of places that may be pressed", ge=1)
    timeout_seconds: float = option(120.0, "Time after which a press is given up", unit="s", gt=0)
    max_failures: int = option(
        5, "Failures of the robot one after the other at which the run ends", ge=1
    )


def make_session(
    presser: Any, options: RobotOptions, stop: StopRule, folder: Path, observer: Observer
) -> tuple[RobotSession, DraftOptions]:
    """Return the session of a robot, and the errors that its fits take into account."""
    robot = presser.build() if isinstance(presser, CustomRobot) else presser
    mesh = _mesh(robot, options)
    held = np.zeros(mesh.n_points, dtype=bool)
    held[face_nodes(mesh, options.held_face)] = True
    driven = RobotPresser(
        robot, mesh, held, material_spec(options.material), options.pressure_mpa,
        options.noise_mm, options.timeout_seconds,
    )  # fmt: skip
    session = RobotSession(
        driven, _candidates(mesh, held, options), folder, stop, options.max_failures, (observer,)
    )
    return session, DraftOptions(pose_deviation_mm=options.pose_deviation_mm)


def _mesh(robot: Any, options: RobotOptions) -> TetMesh:
    if options.mesh is not None:
        return read_mesh(options.mesh, unit="mm")
    if not isinstance(robot, SimulatedRobot):
        raise ConfigError("'robot.mesh' is missing; give robot.mesh=FILE, the mesh of the object.")
    return Phantom(robot.outline, (), 1.0).mesh(_EDGE_PER_RADIUS * options.radius_mm)


def _candidates(mesh: TetMesh, held: np.ndarray, options: RobotOptions) -> list[Patch]:
    approach = np.array(options.approach)
    length = float(np.linalg.norm(approach))
    if not length > 0:
        raise ConfigError("robot.approach=[0, 0, 0]: give a direction.")
    patches = candidate_patches(mesh, held, options.radius_mm, _MANY, min_facing=MIN_FACING)
    least = np.cos(np.deg2rad(options.max_tilt_deg)) * length
    reached = [patch for patch in patches if float(patch.inward @ approach) >= least]
    return pressable_patches(reached, mesh, options.candidates, margin_mm=options.margin_mm)
