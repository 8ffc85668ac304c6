"""Let a robot look for a lump: press, map, next press, until its place is known.

`MyRobot` shows what the driver of a robot implements: one method, which presses once and reports
what was measured, in mm and N in the frame of the mesh. Replace the four marked lines by calls of
your controller, force sensor and tactile sensor; here they talk to a simulated robot, whose object
is a cube of 10 mm with a stiff ball.
"""

import tempfile
from pathlib import Path

import numpy as np

from tactorch import MaterialSpec
from tactorch.errors import PoseRefusedError
from tactorch.mesh import box_mesh
from tactorch.phantoms.cubes import CubeSphere
from tactorch.robot import (
    PressCommand,
    PressReport,
    RobotPresser,
    RobotSession,
    SimulatedRobot,
    StopRule,
    press_until_known,
    pressable_patches,
)  # fmt: skip
from tactorch.sampling import LoopOptions, candidate_patches

BALL = CubeSphere(depth=0.35, radius=0.25)
LOWEST_MM = 5.0  # the arm collides with the table below


class MyRobot:
    """Driver of a robot."""

    def __init__(self) -> None:
        """Connect."""
        self.controller = SimulatedRobot(  # yours
            phantom=BALL, edge_mm=2.5, conforming=False, noise_mm=0.002
        )

    def press(self, command: PressCommand) -> PressReport:
        """Press once; the sensor is away from the object when the call returns."""
        if command.center_mm[2] < LOWEST_MM:
            raise PoseRefusedError(f"z={command.center_mm[2]:.1f} mm is below the table's guard")
        measured = self.controller.press(command)  # move, press until command.force_n, measure
        pose, force_n = measured.center_mm, measured.force_n  # of the arm and its force sensor
        points_mm, displacements_mm = measured.points_mm, measured.displacements_mm  # of the gel
        return PressReport(
            center_mm=pose, inward=measured.inward, force_n=force_n, points_mm=points_mm,
            displacements_mm=displacements_mm, noise_mm=0.002,
        )  # fmt: skip


def main(folder: Path | None = None, max_presses: int = 10) -> dict[str, float]:
    """Press until the position of the lump is known to 1.8 mm."""
    mesh = box_mesh(10.0, 5, tets_per_cell=5)  # mm
    held = mesh.points[:, 2] < 1e-6
    presser = RobotPresser(
        MyRobot(), mesh, held, MaterialSpec("neo_hookean", 0.45), pressure_mpa=0.015, noise_mm=0.002
    )
    places = [p for p in candidate_patches(mesh, held, 2.0, 1000) if p.inward[2] < -0.9]
    places = pressable_patches(places, mesh, 16, margin_mm=0.3)
    session = RobotSession(
        presser, places, folder or Path(tempfile.mkdtemp()), StopRule(width_mm=1.8)
    )
    ended = press_until_known(session, options=LoopOptions(max_presses=max_presses))
    lumps = ended.update.result.lumps
    print(f"The robot pressed {len(session.pressed)} times, and {ended.reason}.")
    off = float(np.linalg.norm(lumps[0].inclusion.center_mm - [5.0, 5.0, 6.5])) if lumps else np.inf
    print(f"The lump is {off:.2f} mm from the ball's middle.")
    return {"presses": len(session.pressed), "failed": len(session.failed), "off_mm": off}


if __name__ == "__main__":
    main()
