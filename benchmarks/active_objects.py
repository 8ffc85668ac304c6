"""The hemisphere of `active_sampling.py`: a mesh to press, and another to invert on."""

from dataclasses import dataclass

import numpy as np

from tactorch.fem import SoftBody, make_material
from tactorch.mesh import Sphere, TetMesh, box_mesh
from tactorch.mesh.quadrature import element_means
from tactorch.recording import MaterialSpec
from tactorch.sampling import SimulatedPresser

RADIUS_MM = 10.0
BACKGROUND_MPA, INCLUSION_MPA = 0.1, 0.5
POISSON = 0.4
SENSOR_MM, PRESSURE_MPA = 3.0, 0.012
NOISE_MM = 0.003  # 1 % of the typical displacement under the sensor, 0.3 mm
_SAMPLES = 4  # along an element's edge, for what a boundary cuts


def hemisphere(across: int, up: int) -> TetMesh:
    """Mesh a hemisphere on its flat side, by a half cube of cells blown up to it.

    A ball's shells are the cube's: p goes to p |p|_max / |p|. Flat facets lack volume, so that
    meshes of unlike fineness would differ in shape: the radius is adjusted to the true volume.
    """
    cube = box_mesh(
        (2.0, 2.0, 1.0), (across, across, up), origin_mm=(-1.0, -1.0, 0.0), tets_per_cell=5
    )
    length = np.linalg.norm(cube.points, axis=1)
    longest = np.abs(cube.points).max(axis=1)
    grown = RADIUS_MM * longest / np.maximum(length, 1e-12)
    mesh = TetMesh.create(cube.points * grown[:, None], cube.tets)
    lacking = 2.0 / 3.0 * np.pi * RADIUS_MM**3 / mesh.volumes.sum()
    return TetMesh.create(mesh.points * np.cbrt(lacking), mesh.tets)


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
        depths = (rng.uniform(3.4, 3.8), rng.uniform(4.2, 4.8))
        heights = np.deg2rad(rng.uniform(35.0, 70.0, 2))
        radii = rng.uniform(2.7, 3.1, 2)
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


def make_presser(body: Hemisphere, finer: TetMesh, mesh: TetMesh, seed: int) -> SimulatedPresser:
    """Press on one mesh and report over the other; with quadratic elements unless it is the same.

    On the same mesh, data and inversion share the model: the inverse crime, as the paper has it.
    """
    law = make_material("neo_hookean", POISSON)
    return SimulatedPresser(
        body=SoftBody(finer, law, element="tet4" if finer is mesh else "tet10"),
        youngs=np.exp(body.truth(finer)),
        held=held(finer),
        mesh=mesh,
        mesh_held=held(mesh),
        pressure_mpa=PRESSURE_MPA,
        noise_mm=NOISE_MM,
        seed=seed,
    )
