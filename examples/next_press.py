"""Let tactorch choose where to press next.

A simulated robot holds a sensor of 2.5 mm radius over a cube with a stiff ball in a corner, and may
press three times. After each press all presses so far are inverted, and the rule predicts at which
place the next one would lower the map's expected error most.
"""

import numpy as np

from tactorch import MaterialSpec, SoftBody, make_material
from tactorch.mesh import box_mesh
from tactorch.sampling import ExpectedError, SimulatedPresser, candidate_patches, sample

BALL_MM = np.array([3.0, 3.0, 7.0])


def main() -> dict[str, float]:
    """Press three times, and print the uncertainty of the map."""
    mesh = box_mesh(10.0, 4)  # mm
    bottom = mesh.points[:, 2] < 1e-6
    truth = np.where(np.linalg.norm(mesh.centroids - BALL_MM, axis=1) < 2.5, 0.5, 0.1)  # MPa
    law = MaterialSpec("neo_hookean", poisson=0.45)
    body = SoftBody(mesh, make_material(law.name, law.poisson), element="tet10")
    robot = SimulatedPresser(body, truth, bottom, mesh, bottom, pressure_mpa=0.01, noise_mm=0.005)
    places = candidate_patches(mesh, bottom, radius_mm=2.5, count=20)

    steps = sample(robot, mesh, places, ExpectedError(), budget=3, material=law, start_mpa=0.1)
    for step in steps:
        where = ", ".join(f"{x:.1f}" for x in places[step.place].center)
        print(f"pressed at ({where}) mm: deviation of log-moduli {step.rms_deviation:.3f}")
    stiffest = mesh.centroids[steps[-1].youngs.argmax()]
    off = float(np.linalg.norm(stiffest - BALL_MM))
    print(f"the stiffest element is {off:.1f} mm from the ball's middle")
    return {
        "first": steps[0].rms_deviation,
        "last": steps[-1].rms_deviation,
        "places": len({step.place for step in steps}),
        "off_mm": off,
    }


if __name__ == "__main__":
    main()
