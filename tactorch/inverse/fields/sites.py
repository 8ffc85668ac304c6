"""The volumes around points, for each of which a field gives one modulus."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from tactorch.fem.assembly import Assembly
from tactorch.inverse.fields.inclusion import InclusionShape
from tactorch.mesh import TetMesh
from tactorch.mesh.quadrature import samples_around

_CENTROID = np.full((1, 4), 0.25)
_WIDTH = 0.15  # width of a boundary over the cube root of the element's volume


@dataclass(frozen=True, eq=False)
class Sites:
    """The volumes for which a field gives moduli: those of the quadrature points.

    Attributes:
        points: Sample points of each volume, (volumes, samples, 3), mm.
        width: Width of a boundary in each volume, mm.
        shape: Shape of the array of moduli, (elements, quadrature points).
    """

    points: Float[np.ndarray, "volumes samples 3"]
    width: Float[np.ndarray, " volumes"]
    shape: tuple[int, int]

    @staticmethod
    def of(assembly: Assembly) -> "Sites":
        """Return the volumes around the quadrature points of a body's elements."""
        return Sites.around(assembly.discretisation.mesh, assembly.discretisation.element.points)

    @staticmethod
    def around(mesh: TetMesh, rule: Float[np.ndarray, "q 4"] = _CENTROID) -> "Sites":
        """Return the volumes around points of each element, or the elements."""
        points = samples_around(rule) @ mesh.points[mesh.tets]
        width = _WIDTH * np.cbrt(np.repeat(mesh.volumes, len(rule)))
        points = points.reshape(mesh.n_tets * len(rule), -1, 3)
        return Sites(points, width, (mesh.n_tets, len(rule)))

    @cached_property
    def centers(self) -> Float[np.ndarray, "volumes 3"]:
        """Centre of each volume, mm."""
        return self.points.mean(axis=1)

    @cached_property
    def radii(self) -> Float[np.ndarray, " volumes"]:
        """Largest distance of the sample points of each volume from its centre, mm."""
        apart = self.points - self.centers[:, None]
        return np.asarray(np.linalg.norm(apart, axis=2).max(axis=1)) * (1.0 + 1e-9)

    def fraction_inside(
        self, shape: InclusionShape, elements: Int[np.ndarray, " k"]
    ) -> Float[np.ndarray, " k"]:
        """Return the fraction of each of some elements inside an inclusion, by sample points."""
        points = self.points.reshape(self.shape[0], -1, 3)[elements]
        inside = shape.contains(points.reshape(-1, 3)).reshape(points.shape[:2])
        return np.asarray(inside.mean(axis=1))

    @staticmethod
    def at(points: Float[np.ndarray, "n 3"]) -> "Sites":
        """Return points (mm), at which boundaries are sharp."""
        return Sites(points[:, None], np.zeros(len(points)), (len(points), 1))
