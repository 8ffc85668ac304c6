"""The hemisphere of `active_sampling.py`: a mesh to press, and another to invert on."""

from dataclasses import dataclass

import numpy as np

from tactorch.credibility import Patch, SimulatedPresser
from tactorch.fem import SoftBody, make_material
from tactorch.mesh import Sphere, TetMesh, box_mesh
from tactorch.phantoms.sampling import element_means
from tactorch.recording import MaterialSpec, Press

RADIUS_MM = 10.0
BACKGROUND_MPA, INCLUSION_MPA = 0.1, 0.5
POISSON = 0.45
PRESSURE_MPA = 0.012
NOISE = 0.01  # of the typical displacement under the sensor
_SAMPLES = 4  # along an element's edge, for what a boundary cuts


def hemisphere(divisions: int) -> TetMesh:
    """Mesh a hemisphere on its flat side, by a half cube of cells blown up to it.

    A ball's shells are the cube's: p goes to p |p|_max / |p|.
    """
    shape = (2 * divisions, 2 * divisions, divisions)
    cube = box_mesh((2.0, 2.0, 1.0), shape, origin_mm=(-1.0, -1.0, 0.0), tets_per_cell=5)
    length = np.linalg.norm(cube.points, axis=1)
    longest = np.abs(cube.points).max(axis=1)
    grown = RADIUS_MM * longest / np.maximum(length, 1e-12)
    return TetMesh.create(cube.points * grown[:, None], cube.tets)


def held(mesh: TetMesh) -> np.ndarray:
    """Return which nodes lie on the flat side."""
    return mesh.points[:, 2] < 1e-9


@dataclass(frozen=True, eq=False)
class Hemisphere:
    """A hemisphere with two stiff balls."""

    balls: tuple[Sphere, Sphere]

    @staticmethod
    def draw(seed: int) -> "Hemisphere":
        """Draw two balls on different sides, one shallow and one deeper."""
        rng = np.random.default_rng([seed, 16])
        around = rng.uniform(0.0, 2.0 * np.pi)
        turns = (around, around + rng.uniform(0.6, 1.4) * np.pi)
        depths = (rng.uniform(3.2, 3.8), rng.uniform(4.2, 5.0))
        heights = np.deg2rad(rng.uniform(35.0, 70.0, 2))
        radii = rng.uniform(2.0, 2.6, 2)
        balls = []
        for turn, depth, height, radius in zip(turns, depths, heights, radii, strict=True):
            flat = np.cos(height)
            axis = np.array([flat * np.cos(turn), flat * np.sin(turn), np.sin(height)])
            center = (RADIUS_MM - depth) * axis
            balls.append(Sphere(tuple(float(c) for c in center), float(radius)))
        return Hemisphere((balls[0], balls[1]))

    def log_youngs(self, points: np.ndarray) -> np.ndarray:
        """Return the logarithm of the modulus (MPa) at points (mm)."""
        inside = self.balls[0].contains(points) | self.balls[1].contains(points)
        return np.log(np.where(inside, INCLUSION_MPA, BACKGROUND_MPA))

    def truth(self, mesh: TetMesh) -> np.ndarray:
        """Return each element's mean log-modulus."""
        return element_means(mesh, self.log_youngs, _SAMPLES)


def material() -> MaterialSpec:
    """Return the law that presses and inversion share."""
    return MaterialSpec("neo_hookean", POISSON)
