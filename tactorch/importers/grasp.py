"""Grasps of an object between two fingers with gels: tables of time, force and width of a gripper.

A table is one grasp, a row one sample. Columns (others are ignored):

| column | what | unit |
|---|---|---|
| time_s | time | s, or that of the suffix |
| force_n | force of the fingers on the object | N, or that of the suffix |
| width_mm | distance of the fingers, up to a constant offset | mm, or that of the suffix |

The press of a grasp is the part in which the gripper holds (`tactorch.importers.holds`). A grasp of
a rigid object of known size gives the offset of the width: the distance of the faces of both gels
at rest is the size of the object less twice the depth at which a gel of the stated modulus has the
measured force. The error of this modulus is an error of the distance, too. It does not change what
an object as stiff as the reference is, and is most important for the softest ones.
"""

import logging
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import ConfigError, ConvergenceError, FileError
from tactorch.fem import Supports
from tactorch.importers.holds import GraspColumns, Hold
from tactorch.importers.points import press_files
from tactorch.importers.sheets import SUFFIXES
from tactorch.mesh import Box, Cylinder, Shape, Sphere, TetMesh, read_mesh
from tactorch.mesh.lattice import lattice_mesh
from tactorch.mesh.meshing import mesh_shape
from tactorch.recording import ForceReading, GelReading, MaterialSpec, Press, Recording
from tactorch.recording.press import constant_field
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelMesh
from tactorch.touch.coupled import Coupled
from tactorch.touch.pairing import face_each_other

_log = logging.getLogger(__name__)
# Stiffness of the springs that hold a free object, over that of a grasp.
_SOFT = 0.01
# Depth of a reference over the gel's thickness: the largest, and that of the first trial, from
# which others follow by a power of the force.
_DEEPEST, _FIRST, _POWER, _TRIALS = 0.55, 0.2, 1.7, 8
_SAME_FORCE = 0.1  # relative difference, within which the power law is exact enough
_CELLS, _LAYERS, _ACROSS = 12, 2, 4  # elements of a gel, and across a reference
_OBJECT_ACROSS = 9  # elements across an object
_LARGE = 0.2  # closing over the size of an object, from which its modulus is that of large strains
_CREEP = 0.1  # change of the width while the gripper holds, over its closing, that is stated


class Opening(NamedTuple):
    """Distance of the faces of both gels at rest, less the width that the gripper reports."""

    offset_mm: float
    by_modulus_mm: float  # change by the logarithm of the gels' modulus
    deviation_mm: float
    force_n: float  # at which it was found


@dataclass(frozen=True, kw_only=True)
class GraspOptions(GraspColumns):
    """Read grasps between two fingers with gels (see the module's docstring)."""

    section: ClassVar[str] = "format"
    shape: Literal["ball", "box", "cylinder", "mesh"] = option("ball", "Shape of the object")
    size_mm: tuple[float, ...] = option(
        (),
        "Diameter of a ball; sides of a box along x, y and z; diameter and length of a cylinder "
        "along z",
        unit="mm", gt=0,
    )  # fmt: skip
    mesh: Path | None = option(None, "Mesh of the object in mm, for shape=mesh")
    along: Literal["x", "y", "z"] = option(
        "x", "Axis of the object along which it is grasped, through the middle of its box"
    )
    edge_mm: float | None = option(
        None, "Edge length of the mesh; null: a ninth of the object's size", unit="mm", gt=0
    )
    poisson: float = option(0.45, "Poisson's ratio of the object", gt=0, lt=0.5)
    gel: GelLayer = option(
        help="Gel of each finger, whose width and height are along the next two axes"
    )
    gel_deviation: float = option(
        0.3, "Standard deviation of the logarithm of the gels' modulus", ge=0
    )
    reference: Path | None = option(None, "Grasp of a rigid object, or folder of such grasps")
    reference_shape: Literal["ball", "box"] = option("ball", "Shape of the rigid object")
    reference_mm: float | None = option(
        None, "Diameter of the rigid ball, or side of the box", unit="mm", gt=0
    )
    offset_mm: float | None = option(
        None,
        "Distance of the faces of both gels less the width that is reported, where there is no "
        "reference",
        unit="mm",
    )
    offset_deviation_mm: float = option(0.3, "Standard deviation of this distance", unit="mm", ge=0)
    compliance_mm_per_n: float = option(
        0.0, "By how much the fingers bend for each newton, beyond a reference of another force",
        ge=0,
    )  # fmt: skip
    force_deviation: float = option(0.02, "Standard deviation of a force over the force", gt=0)

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a table, or a folder of tables; see `import_grasp`."""
        holds = [self.hold(file) for file in press_files(Path(path), SUFFIXES, "table")]
        opening, mesh = self._opening(), self._mesh()
        size = float(np.ptp(mesh.points[:, "xyz".index(self.along)]))
        stiffness = float(np.median([hold.force_n for hold in holds])) / size
        springs = np.full(mesh.points.shape, _SOFT * stiffness / mesh.n_points)
        presses = [
            self._press(hold, opening, self._apart(hold, opening, size, path), mesh, springs)
            for hold in holds
        ]
        provenance = {
            "importer": "grasp", "file": Path(path).name, "offset_mm": opening.offset_mm,
            "offset_by_log_modulus_mm": opening.by_modulus_mm,
            "holds": [asdict(hold) for hold in holds],
        }  # fmt: skip
        material = MaterialSpec(self.gel.material, self.poisson)
        return Recording(mesh, tuple(presses), material, provenance=provenance)

    def _mesh(self) -> TetMesh:
        if self.shape == "mesh":
            if self.mesh is None:
                raise ConfigError("format.mesh is required with format.shape=mesh.")
            return read_mesh(self.mesh, unit="mm")
        counts = {"ball": 1, "box": 3, "cylinder": 2}
        if len(self.size_mm) != counts[self.shape]:
            raise ConfigError(
                f"format.size_mm={list(self.size_mm)}: a {self.shape} has {counts[self.shape]} "
                "sizes, in mm."
            )
        size = self.size_mm
        shape: Shape = Box((0.0, 0.0, 0.0), size) if self.shape == "box" else (
            Sphere((0.0, 0.0, 0.0), size[0] / 2)
            if self.shape == "ball"
            else Cylinder((0.0, 0.0, 0.0), size[0] / 2, size[1])
        )  # fmt: skip
        smallest = float(np.ptp(np.array(shape.bounds()), axis=0).min())
        return mesh_shape(shape, self.edge_mm or smallest / _OBJECT_ACROSS, 0.1, "auto")

    def _opening(self) -> Opening:
        """Return the offset of the width, by the reference or as stated."""
        if self.offset_mm is not None and (self.reference or self.compliance_mm_per_n):
            raise ConfigError(
                "format.offset_mm is instead of format.reference and format.compliance_mm_per_n; "
                "leave these out."
            )
        if self.reference is None:
            if self.offset_mm is None:
                raise ConfigError(
                    "format.reference is required: a grasp of a rigid object, with its size as "
                    "format.reference_mm; or give format.offset_mm."
                )
            return Opening(self.offset_mm, 0.0, self.offset_deviation_mm, 0.0)
        if self.reference_mm is None:
            raise ConfigError("format.reference_mm is required: the size of the rigid object.")
        holds = [self.hold(file) for file in press_files(self.reference, SUFFIXES, "table")]
        found = [self._by_reference(hold, self.reference_mm) for hold in holds]
        forces = np.array([one.force_n for one in found])
        offsets = np.array([one.offset_mm for one in found])
        offsets -= self.compliance_mm_per_n * (forces - forces.mean())
        spread = float(offsets.std()) if len(found) > 1 else 0.0
        return Opening(
            float(offsets.mean()),
            float(np.mean([one.by_modulus_mm for one in found])),
            float(np.hypot(self.offset_deviation_mm, spread)),
            float(forces.mean()),
        )

    def _by_reference(self, hold: Hold, size_mm: float) -> Opening:
        middle, layer = (0.0, 0.0, 0.0), self.gel
        is_ball = self.reference_shape == "ball"
        shape = Sphere(middle, size_mm / 2) if is_ball else Box(middle, size_mm)
        try:
            depth, by_modulus = rigid_depth(layer, shape, hold.force_n)
        except ConvergenceError as error:
            raise ConfigError(
                f"'{self.reference}': {hold.force_n:.3g} N press the rigid object through more "
                f"than {_DEEPEST:.0%} of gels of {layer.thickness_mm:g} mm and "
                f"{layer.youngs_mpa:g} MPa; check format.gel.youngs_mpa and "
                f"format.gel.thickness_mm. ({error})"
            ) from error
        offset = size_mm - 2.0 * depth - hold.width_mm
        _log.info(
            "reference '%s': %.3g N at a width of %.4g mm; it is %.2g mm deep in each gel, whose "
            "faces are at %.4g mm.", hold.name, hold.force_n, hold.width_mm, depth,
            hold.width_mm + offset,
        )  # fmt: skip
        return Opening(offset, -2.0 * by_modulus, 0.0, hold.force_n)

    def _apart(self, hold: Hold, opening: Opening, size: float, path: str | Path) -> float:
        """Return the distance of the faces of both gels at rest (mm); state what is unusual."""
        bent = self.compliance_mm_per_n * (hold.force_n - opening.force_n)
        apart = hold.width_mm + opening.offset_mm + bent
        closed = size - apart
        if not 0.0 < apart < size:
            raise FileError(
                f"'{path}': in '{hold.name}' the gels are {apart:.4g} mm apart, and the object is"
                f" {size:.4g} mm wide along {self.along}; check format.size_mm, "
                "format.reference_mm and the unit of the width."
            )
        if closed > _LARGE * size:
            _log.warning(
                "'%s': object and gels yield by %.0f %% of the size of the object. Its modulus is "
                "that of a neo-Hookean solid at this strain; hardness and small strains may give "
                "another.",
                hold.name, 100.0 * closed / size,
            )  # fmt: skip
        if abs(hold.creep_mm) > _CREEP * closed:
            _log.warning(
                "'%s': the width changes by %.2g mm while the force is constant. The object "
                "creeps, and its modulus is that of this time.", hold.name, hold.creep_mm,
            )  # fmt: skip
        _log.info(
            "'%s': %.3g N at a width of %.4g mm, to which object and gels yield by %.3g mm; widths "
            "are %.2g s later than forces.",
            hold.name, hold.force_n, hold.width_mm, closed, hold.lag_s,
        )  # fmt: skip
        return apart

    def _press(
        self,
        hold: Hold,
        opening: Opening,
        apart: float,
        mesh: TetMesh,
        springs: Float[np.ndarray, "n 3"],
    ) -> Press:
        low, high = mesh.bounds
        axis = "xyz".index(self.along)
        size = float((high - low)[axis])
        first, pose = (_pose(0.5 * (low + high), axis, distance) for distance in (size, apart))
        # Widths of a hold are wrong independently; forces rise with the power 1.5 (Hertz).
        by_width = 1.5 * hold.force_n * hold.width_deviation_mm / (size - apart)
        deviation = np.linalg.norm(
            [self.force_deviation * hold.force_n, hold.force_deviation_n, by_width]
        )
        constant, none = partial(constant_field, n_points=mesh.n_points), np.zeros((0, 2))
        return Press(
            constant("forces"),
            constant("observed"),
            constant("displacement"),
            springs=springs,
            direction=pose[:3, 2],
            name=hold.name,
            force=ForceReading.along(-pose[:3, 2], hold.force_n, float(deviation)),
            gel=GelReading(
                self.gel.numbers, pose, first, none, none, np.zeros(0),
                np.array([self.gel_deviation, 0.5 * opening.deviation_mm, 0.0]),
                np.array([size, opening.by_modulus_mm]),
            ),
        )  # fmt: skip


def import_grasp(path: str | Path, **options: Any) -> Recording:
    """Read grasps between two fingers with gels (see the module's docstring).

    Args:
        path: Table of a grasp, or a folder of tables of grasps of one object.
        options: Settings, see `GraspOptions`.

    Returns:
        A recording with a press for each grasp, whose datum is the force between the gels.

    Raises:
        ConfigError: a setting is not valid, or the reference does not fit to the gels.
        FileError: a table cannot be used; names file, quantity and remedy.
    """
    return GraspOptions(**options)(path=path)


def rigid_depth(layer: GelLayer, shape: Shape, force_n: float) -> tuple[float, float]:
    """Return the depth of a rigid object in each of two gels that press it with a force, mm.

    The second number is its change by the logarithm of the gels' modulus, mm. The object is grasped
    along z.

    Raises:
        ConvergenceError: the gels are softer than that they can have this force.
    """
    low, high = np.array(shape.bounds())
    size = float((high - low)[2])
    # Gaps are those of the shape, and all nodes are fixed: the mesh may be coarse.
    mesh = lattice_mesh(shape, float((high - low).min()) / _ACROSS)
    gel = GelMesh(layer, 2.0 * min(layer.half_size_mm) / _CELLS, _LAYERS)
    facing = face_each_other(mesh, shape, gel, _pose(0.5 * (low + high), 2, size))
    assert facing is not None
    deepest = _DEEPEST * layer.thickness_mm
    rigid = Supports(fixed=np.ones(mesh.points.shape, dtype=bool))
    both = Coupled(
        facing, mesh, gel, MaterialSpec(layer.material, layer.poisson), rigid,
        body_mpa=layer.youngs_mpa, depth_mm=deepest,
    )  # fmt: skip
    youngs, u = both.youngs(np.full((mesh.n_tets, 1), layer.youngs_mpa)), None
    depth, power, last = _FIRST * layer.thickness_mm, _POWER, None
    for _ in range(_TRIALS):
        state = both.solve(youngs, np.array([0.0, 0.0, depth]), u)
        u = state.displacement
        force = float(state.contact.pair_forces(u)[:, 2].sum())
        if last is not None:
            power = float(np.log(force / last[1]) / np.log(depth / last[0]))
        miss = float(np.log(force_n / force))
        if last is not None and abs(miss) < _SAME_FORCE:
            break
        if depth >= deepest and miss > 0.0:
            raise ConvergenceError(f"{force:.3g} N are reached at {depth:.3g} mm.")
        last, depth = (depth, force), min(depth * float(np.exp(miss / power)), deepest)
    # The force of a rigid object is proportional to the modulus of the gels.
    return depth * float(np.exp(miss / power)), -depth / power


def _pose(middle: Float[np.ndarray, "3"], axis: int, apart_mm: float) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the gel on the lower side of an axis, half of a distance from a point."""
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), axis + 1, axis=0)
    pose[:3, 3] = middle - 0.5 * apart_mm * pose[:3, 2]
    return pose
