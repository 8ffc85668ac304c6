"""Press plan: locations, pressures and the support of the object."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.errors import ConfigError, MeshError
from tactorch.mesh.closest import closest_points
from tactorch.mesh.geometry import farthest_point_order
from tactorch.mesh.sharp_edges import sharp_edges
from tactorch.mesh.tetmesh import FaceName, TetMesh, face_nodes, select_face
from tactorch.mesh.topology import Surface

Point = tuple[float, float, float]
_MAX_DISTANCE = 0.05  # of a pressed point from the surface, over the diagonal
_SHARP = np.cos(np.deg2rad(40.0))  # cosine of the angle between normals at a sharp edge


@dataclass(frozen=True)
class PressSite:
    """Location of presses with increasing pressure: a face, or a patch of it."""

    face: str  # of `tactorch.mesh.FACE_NAMES`
    center_mm: Point | None = None  # of the patch; None for the whole face or a patch in its middle

    @property
    def axis(self) -> int:
        """Axis of the face's normal: 0, 1 or 2."""
        return "xyz".index(self.face[0])

    @property
    def tangential(self) -> list[int]:
        """The two other axes."""
        return [i for i in range(3) if i != self.axis]

    @property
    def opposite(self) -> str:
        """Opposite face, which is supported."""
        return self.face[0] + ("-" if self.face[1] == "+" else "+")

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector into the object."""
        return np.eye(3)[self.axis] * (-1.0 if self.face[1] == "+" else 1.0)

    @property
    def name(self) -> str:
        """Name in messages and reports."""
        if self.center_mm is None:
            return self.face
        return f"{self.face} at ({', '.join(f'{x:.4g}' for x in self.center_mm)}) mm"


@dataclass(frozen=True, eq=False)
class SurfaceSite:
    """Location of presses on a surface of any shape."""

    point_mm: Float[np.ndarray, "3"]  # of the surface
    direction: Float[np.ndarray, "3"]  # unit vector into the object
    opposite: str  # supported side of the bounding box

    @property
    def axis(self) -> int:
        """Axis of the normal of the supported side: 0, 1 or 2."""
        return "xyz".index(self.opposite[0])

    @property
    def tangential(self) -> list[int]:
        """The two other axes."""
        return [i for i in range(3) if i != self.axis]

    @property
    def name(self) -> str:
        """Name in messages and reports."""
        return f"({', '.join(f'{x:.4g}' for x in self.point_mm)}) mm"


@dataclass(frozen=True)
class PressPlan(Options):
    """Presses on flat faces with increasing pressure, the opposite face supported.

    With `points_mm` or a number of `points` presses are on a surface of any shape, and the side
    `base` is supported.

    Pressure is a dead load: per area of the undeformed object, along the undeformed normal.
    `pressures_mpa`, `p_max_mpa` and `steps` are made consistent; the first has precedence.
    """

    section = "press"
    faces: tuple[FaceName, ...] = option(("z+",), "Pressed faces", nonempty=True)
    pressures_mpa: tuple[float, ...] | None = option(
        None, "Increasing pressure of each step; null: equal steps to p_max_mpa",
        unit="MPa", gt=0, nonempty=True,
    )  # fmt: skip
    p_max_mpa: float = option(0.02, "Pressure of the last load step", unit="MPa", gt=0)
    steps: int = option(4, "Number of equal load steps (t in the paper)", ge=1)
    patch_radius_mm: float | None = option(
        None, "Radius of a circular pressed patch; null: the whole face", unit="mm", gt=0
    )
    patch_centers_mm: tuple[Point, ...] | None = option(
        None, "Points projected onto each face as centres of patches; null: the middle",
        unit="mm", nonempty=True,
    )  # fmt: skip
    support: Literal["springs", "fixed", "roller"] = option(
        "springs",
        "Support of the opposite face; springs: each node on zero-length springs along all axes "
        "(the paper's); fixed: no displacement; roller: none along the normal, tangentially free",
    )
    spring_n_per_mm: float = option(
        1.0, "Stiffness of each spring (k_c of the paper)", unit="N/mm", gt=0
    )

    points_mm: tuple[Point, ...] | None = option(
        None, "Points of a surface of any shape, pressed along its normal by a round tool of"
        " patch_radius_mm, instead of faces",
        unit="mm", nonempty=True,
    )  # fmt: skip
    points: int | None = option(
        None, "Number of points that are spread over the surface, away from its edges and the base,"
        " instead of points_mm",
        ge=1,
    )  # fmt: skip
    base: FaceName = option("z-", "Supported side of presses at points")

    def __post_init__(self) -> None:
        faces: Any = self.faces
        if isinstance(faces, str):
            object.__setattr__(self, "faces", (faces,))
        super().__post_init__()
        if len(set(self.faces)) < len(self.faces):
            raise ConfigError(f"press.faces={list(self.faces)} repeats a face; name each once.")
        if self.pressures_mpa is None:
            ramp = tuple(self.p_max_mpa * i / self.steps for i in range(1, self.steps + 1))
            object.__setattr__(self, "pressures_mpa", ramp)
        if any(later <= former for former, later in pairwise(self.pressures)):
            raise ConfigError(f"press.pressures_mpa={list(self.pressures)} must increase.")
        object.__setattr__(self, "p_max_mpa", self.pressures[-1])
        object.__setattr__(self, "steps", len(self.pressures))
        given = [n for n in ("points_mm", "points", "patch_centers_mm") if getattr(self, n)]
        if len(given) > 1:
            raise ConfigError(f"press.{given[0]} and press.{given[1]} are given; give one.")
        if given and given[0] != "patch_centers_mm" and self.patch_radius_mm is None:
            raise ConfigError(f"press.{given[0]} needs press.patch_radius_mm, that of the tool.")
        if self.patch_centers_mm is not None and self.patch_radius_mm is None:
            raise ConfigError(
                "press.patch_centers_mm is given without press.patch_radius_mm; give both."
            )

    def sites_on(self, mesh: TetMesh) -> "tuple[PressSite | SurfaceSite, ...]":
        """Return all pressed locations on a mesh."""
        if self.points_mm is None and self.points is None:
            try:
                for face in self.faces:
                    select_face(mesh, face)
            except MeshError as error:
                advice = "press=around presses points that are spread over a curved surface."
                raise MeshError(f"press.faces: {error} {advice}") from error
            return self.sites
        surface = mesh.surface
        points = self._spread(mesh) if self.points_mm is None else np.array(self.points_mm)
        closest = closest_points(mesh.points, surface.triangles, points)
        farthest = int(closest.distances.argmax())
        if closest.distances[farthest] > _MAX_DISTANCE * mesh.diagonal:
            raise ConfigError(
                f"press.points_mm: {points[farthest].tolist()} is "
                f"{closest.distances[farthest]:.3g} mm from the surface of the body; move it there."
            )
        return tuple(
            SurfaceSite(point, -_normal(surface, int(triangle), weights), self.base)
            for triangle, weights, point, _ in zip(*closest, strict=True)
        )

    def _spread(self, mesh: TetMesh) -> Float[np.ndarray, "k 3"]:
        """Return nodes of the surface, each far from those before it, the highest first."""
        surface, radius = mesh.surface, self.patch_radius_mm or 0.0
        sharp = np.unique(sharp_edges(surface.triangles, surface.normals, _SHARP))
        points = mesh.points[surface.nodes()]
        borders = mesh.points[sharp], mesh.points[face_nodes(mesh, self.base)]
        apart = [cKDTree(border).query(points)[0] for border in borders if len(border)]
        free = points[np.min(apart, axis=0) >= radius]
        if len(free) < (self.points or 0):
            raise ConfigError(
                f"press.points={self.points}: the surface has {len(free)} nodes that are "
                f"press.patch_radius_mm={radius:g} away from edges and the side {self.base}; ask "
                "for fewer points, or use a smaller radius or a finer mesh."
            )
        heights = free @ PressSite(self.base).direction
        return free[farthest_point_order(free, self.points or 0, int(heights.argmax()))]

    @property
    def pressures(self) -> tuple[float, ...]:
        """Pressure of each load step, MPa."""
        return self.pressures_mpa or ()

    @property
    def sites(self) -> tuple[PressSite, ...]:
        """All pressed locations, face by face."""
        if self.patch_centers_mm is None:
            return tuple(PressSite(face) for face in self.faces)
        return tuple(PressSite(f, center) for f in self.faces for center in self.patch_centers_mm)


def _normal(
    surface: Surface, triangle: int, weights: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the outward normal at a point of a triangle, interpolated between its nodes.

    Triangles beyond a sharp edge do not count: near the rim of a flat side the normal is the
    side's on every mesh.
    """
    smooth = surface.normals @ surface.normals[triangle] > _SHARP
    touching = surface.triangles[:, :, None] == surface.triangles[triangle]
    vectors = (surface.areas * smooth)[:, None] * surface.normals
    at_nodes = touching.any(axis=1).T @ vectors
    at_nodes /= np.linalg.norm(at_nodes, axis=1, keepdims=True)
    normal: np.ndarray = weights @ at_nodes
    return normal / np.linalg.norm(normal)
