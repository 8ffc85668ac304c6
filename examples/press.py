"""Press a cube and compare with the exact answer.

A unit cube of the paper's Neo-Hookean material, free to spread sideways, carries a nominal pressure
of a fifth of its Young's modulus. Its field is uniform, so the exact stretches solve two scalar
equations, and the finite elements must find them on any mesh.
"""

import numpy as np

from tactorch import SoftBody, Supports, make_material
from tactorch.mesh import box_mesh, face_nodes

YOUNGS_MPA, PRESSURE_MPA = 1.0, 0.2
# Poisson's ratio: stretch, lateral stretch (from the equations, not from a mesh).
EXACT = {
    0.30: (0.828310984658, 1.056797425871),
    0.45: (0.833017354831, 1.084927637795),
    0.49: (0.834457641796, 1.092545793302),
}


def stretches(poisson: float) -> tuple[float, float]:
    """Return the stretch along the load and across it."""
    mesh = box_mesh(1.0, 3)  # 1 mm, three cells along each edge
    body = SoftBody(mesh, make_material("neo_hookean", poisson))
    rollers = Supports(fixed=mesh.points < 1e-9)  # each low side slides in its plane
    youngs = np.full(mesh.n_tets, YOUNGS_MPA)
    forces = body.pressure("z+", PRESSURE_MPA).numpy()  # N
    moved = body.equilibrate(youngs, forces, rollers).require().displacement  # mm
    top, side = face_nodes(mesh, "z+"), face_nodes(mesh, "x+")
    return 1.0 + moved[top, 2].mean(), 1.0 + moved[side, 0].mean()


def main() -> dict[float, tuple[float, float]]:
    """Press at three Poisson's ratios."""
    found = {}
    for poisson, exact in EXACT.items():
        found[poisson] = stretches(poisson)
        off = np.abs(np.subtract(found[poisson], exact)).max()
        print(
            f"nu {poisson:.2f}: stretch {found[poisson][0]:.9f}, lateral {found[poisson][1]:.9f}, "
            f"off by {off:.1e}"
        )
    return found


if __name__ == "__main__":
    main()
