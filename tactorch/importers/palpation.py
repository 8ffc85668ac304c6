"""Palpation by a robot with a ball and a force sensor, as a table in a CSV file.

A row is one sample; a probe is a series of samples at one place, while the ball moves into the
surface. Columns (others are ignored):

| column | what | unit |
|---|---|---|
| probe | number or name of the probe | |
| x_mm, y_mm, z_mm | centre of the ball | mm, or that of the suffix |
| fx_n, fy_n, fz_n | force on the ball, in the same axes | N, or that of the suffix |
| contact_x_mm, contact_y_mm, contact_z_mm | first contact found by the robot, optional | mm |
| normal_x, normal_y, normal_z | outward normal there, optional | |
| time_s, or sec and nanosec | time, optional: else rows are in its order | any |

Without the normal it is opposite to the motion. Rows of a ball that is lifted, or pressed in again,
are left out (`tactorch.importers.strokes`). The contact is found from the forces: the depth of the
first sample and the stiffness of a probe fit the force on a ball in a half-space. Samples that are
clear of the surface give the offset of the force sensor for each probe
(`tactorch.importers.offsets`); without any it is taken as zero, which shifts all depths by about as
much. The object is a block below the surface through the contacts. Its depth is stated where it is
known; otherwise it is five radii of the ball, and a search may find a stiff base above its bottom.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import Options, option
from tactorch.errors import FileError, MeshError
from tactorch.fem.contact import Ball
from tactorch.importers.contacts import Contacts, find_contacts, hysteresis, unevenness
from tactorch.importers.magnitudes import (
    Remedy,
    check_contacts,
    check_rows,
    check_surface,
)
from tactorch.importers.samples import Rows, Samples, make_samples, read_rows
from tactorch.mesh import TetMesh, read_mesh
from tactorch.mesh.block import HeightField, block_below
from tactorch.mesh.geometry import frozen
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording

_log = logging.getLogger(__name__)
_MIN_LOST = 0.05  # share of the work that is not given back, from which a message states it
_DEEP = 0.5  # depth of a ball over that of the object there, from which a message states it
# Depth of a block whose depth is not known, over the radius of the ball: its bottom adds 19 % to
# the force of a ball that is pressed in by half its radius (E. K. Dimitriadis et al., Biophys. J.
# 82 (2002), 2798-2810).
_DEPTH_PER_RADIUS = 5.0
_OTHER_CONTACT = 0.5  # distance of contacts from those of the file, over the ball's radius


@dataclass(frozen=True, kw_only=True)
class PalpationSettings(Options):
    """Object, ball and errors of a palpation, whatever its file."""

    section: ClassVar[str] = "format"
    radius_mm: float | None = option(
        None, "Radius of the ball; null: distance of its centre from the contacts in the file",
        unit="mm", gt=0,
    )  # fmt: skip
    depth_mm: float | None = option(
        None,
        "Depth of the object's bottom below the lowest contact; null: not known, so that the "
        "search finds a stiff base where the forces show one, in a block of 5 radii of the ball",
        unit="mm",
        gt=0,
    )
    margin_mm: float = option(
        8.0, "Distance of the object's sides from the outermost contacts", unit="mm", ge=0
    )
    edge_mm: float = option(3.0, "Edge length of the mesh at the surface", unit="mm", gt=0)
    mesh: Path | None = option(
        None, "Mesh of the object in mm, in the robot's axes, instead of the block"
    )
    poisson: float = option(0.45, "Poisson's ratio of the object", gt=0, lt=0.5)
    depths: int | None = option(
        4, "Presses of each probe: means over equal steps of depth; null: all samples", ge=1
    )
    noise_n: float | None = option(
        None, "Noise of a force; null: estimated from the samples", unit="N", gt=0
    )
    contact_mm: float = option(
        0.1,
        "Standard deviation of the depth of a probe, common to its presses; more where the surface "
        "is not flat",
        unit="mm",
        ge=0,
    )
    up: Literal["x+", "x-", "y+", "y-", "z+", "z-"] = option(
        "z+", "Axis of the file, and its direction, that points out of the object"
    )
    reverse_force: bool = option(False, "The forces are those on the object, not on the ball")
    check_units: bool = option(True, "Refuse magnitudes that suggest a wrong unit")

    def record(self, rows: Rows, path: str | Path) -> Recording:
        """Return the recording of the rows of a file: contacts, object and presses."""
        total, turn = len(rows.labels), self._turn()
        rows = rows.finite().turned(turn, -1.0 if self.reverse_force else 1.0)
        if without := total - len(rows.labels):
            _log.warning(
                "'%s': %d rows without a number in every column are left out.", path, without
            )
        remedy = partial(self._state_unit, rows=rows)
        samples, contacts = self._contacts(rows, Path(path), remedy)
        lost = hysteresis(samples)
        samples = samples.reduced(self.depths, -contacts.depth_mm)
        mesh, fixed, above_mm = self._body(samples, contacts, str(path), remedy)
        mesh = TetMesh(mesh.points @ turn, mesh.tets, mesh.regions)
        provenance = {
            "importer": "palpation", "file": Path(path).name, "ball_radius_mm": samples.radius_mm,
            "probes": len(samples.names), "noise_n": contacts.noise_n,
            "tare_n": float(np.median(contacts.offsets.force_n)),
            "tare_deviation_n": float(np.std(contacts.offsets.force_n)),
            "samples_clear_of_the_surface": contacts.offsets.clear, "depth_mm": self.depth_mm,
            "block": self.mesh is None, "hysteresis": lost,
            **_count_rows(samples, total, without, str(path)),
        }  # fmt: skip
        if lost is not None:
            (_log.warning if lost > _MIN_LOST else _log.info)(
                "'%s': balls are lifted in the rows, too. The rows while they are pressed in are "
                "used; lifting gives back %.0f %% less work (hysteresis).", path, 100.0 * lost,
            )  # fmt: skip
        return Recording(
            mesh, tuple(self._presses(samples, contacts, frozen(fixed), above_mm, turn)),
            MaterialSpec("linear", self.poisson), provenance=provenance,
            check_units=self.check_units,
        )  # fmt: skip

    def _contacts(self, rows: Rows, path: Path, remedy: Remedy) -> tuple[Samples, Contacts]:
        """Return the samples in contact and the contacts; refuse implausible ones."""
        if self.check_units:
            check_rows(str(path), rows, self.radius_mm, remedy)
        samples = make_samples(path, rows, self.radius_mm)
        samples, contacts = find_contacts(samples, self.noise_n, str(path))
        deepest = self._check(samples, contacts, rows, str(path))
        if self.check_units:
            modulus = float(np.median(contacts.plane_mpa)) * (1.0 - self.poisson**2)
            check_contacts(
                str(path), contacts.points_mm, float(np.median(deepest)), samples.radius_mm,
                modulus, remedy,
            )  # fmt: skip
        return samples, contacts

    def _state_unit(self, what: str, unit: str, rows: Rows) -> str:
        """Return how a unit of "force" or "position" is stated, for messages."""
        return f"convert the messages, whose unit of {what} is m or N"

    def _depth_mm(self, radius_mm: float) -> float:
        """Return the depth of the block, as stated or by the radius of the ball."""
        return _DEPTH_PER_RADIUS * radius_mm if self.depth_mm is None else self.depth_mm

    def _turn(self) -> Float[np.ndarray, "3 3"]:
        """Return the rotation of the axes of the file to those whose z points out."""
        axis = "xyz".index(self.up[0])
        turn = np.roll(np.eye(3), axis - 2, axis=1)
        return turn if self.up[1] == "+" else np.diag([1.0, -1.0, -1.0]) @ turn

    def _check(
        self, samples: Samples, contacts: Contacts, rows: Rows, source: str
    ) -> Float[np.ndarray, " probes"]:
        """Return the largest depth of each probe; refuse those that object and ball contradict."""
        deepest = np.zeros(len(samples.names))
        np.maximum.at(deepest, samples.probe, samples.advance_mm)
        deepest += contacts.depth_mm
        heights = contacts.points_mm[:, 2]
        depth_mm = self._depth_mm(samples.radius_mm)
        below = deepest - (heights - heights.min() + depth_mm)
        if self.mesh is None and below.max() >= 0.0:
            raise FileError(
                f"'{source}': probe '{samples.names[below.argmax()]}' is pressed in by "
                f"{deepest[below.argmax()]:.3g} mm, more than the object is deep; give the depth of"
                f" its bottom in mm (format.depth_mm={depth_mm:g})."
            )
        shares = deepest / (deepest - below)
        if self.mesh is None and shares.max() > _DEEP:
            _log.warning(
                "'%s': probe '%s' is pressed in by %.0f %% of the depth of the object, where "
                "forces of small strains are wrong; check format.depth_mm=%g.",
                source, samples.names[shares.argmax()], 100.0 * shares.max(), depth_mm,
            )  # fmt: skip
        if self.radius_mm is None and rows.contacts_mm is not None:
            labels = {label: i for i, label in enumerate(rows.labels.tolist())}
            known = [labels.get(name, labels[name.split(" (")[0]]) for name in samples.names]
            apart = (contacts.points_mm - rows.contacts_mm[known]) * samples.normals
            if abs(float(np.nanmedian(apart.sum(axis=1)))) > _OTHER_CONTACT * samples.radius_mm:
                raise FileError(
                    f"'{source}': contacts by the forces are {np.nanmedian(apart.sum(axis=1)):.2g} "
                    "mm from those of the file, which tell no radius of the ball where it begins "
                    "in air; give format.radius_mm."
                )
        return deepest

    def _body(
        self, samples: Samples, contacts: Contacts, source: str, remedy: Remedy
    ) -> tuple[TetMesh, Bool[np.ndarray, "n 3"], Float[np.ndarray, " probes"]]:
        """Return the object, its supports, and the heights of the contacts below its surface."""
        if self.mesh is not None:
            mesh = read_mesh(self.mesh, unit="mm")
            mesh = TetMesh(mesh.points @ self._turn().T, mesh.tets, mesh.regions)
            if self.check_units:
                lift = samples.radius_mm * samples.normals
                check_surface(source, mesh, contacts.points_mm, lift, remedy)
            low, high = mesh.bounds
            held = mesh.points[:, 2] < low[2] + 1e-3 * (high - low)[2]
            return mesh, np.repeat(held[:, None], 3, axis=1), np.zeros(len(contacts.points_mm))
        try:
            height = HeightField(contacts.points_mm)
        except MeshError as error:
            raise MeshError(f"'{source}': {error} Or give the object as format.mesh.") from error
        if height.is_plane:
            _log.warning(
                "The surface of the object is taken as a plane through its %d contacts, with a "
                "deviation of %.2g mm; give the object as format.mesh if it is another.",
                len(contacts.points_mm), height.error_mm,
            )  # fmt: skip
        block = block_below(
            height, depth_mm=self._depth_mm(samples.radius_mm), margin_mm=self.margin_mm,
            edge_mm=self.edge_mm,
        )  # fmt: skip
        fixed = np.zeros((block.mesh.n_points, 3), dtype=bool)
        fixed[block.bottom] = True
        above = height(contacts.points_mm[:, :2]) - contacts.points_mm[:, 2]
        return block.mesh, fixed, above * samples.normals[:, 2]

    def _presses(
        self,
        samples: Samples,
        contacts: Contacts,
        fixed: Bool[np.ndarray, "n 3"],
        above_mm: Float[np.ndarray, " probes"],
        turn: Float[np.ndarray, "3 3"],
    ) -> Iterator[Press]:
        """Yield the presses; poses are moved along the normal so that contacts are on the mesh."""
        ball, steps = Ball(samples.radius_mm), np.zeros(len(samples.names), dtype=int)
        normals, points = samples.normals @ turn, contacts.points_mm @ turn
        rotations = _rotations(normals)
        deviations = np.hypot(self.contact_mm, unevenness(contacts.points_mm))
        for i in np.lexsort((samples.advance_mm, samples.probe)):
            k = int(samples.probe[i])
            normal = normals[k]
            # On the axis: motion across it is that of the robot's compliance.
            depth = samples.advance_mm[i] + contacts.depth_mm[k]
            centre = points[k] + (samples.radius_mm - depth + above_mm[k]) * normal
            noise = contacts.noise_n / np.sqrt(samples.count[i])
            deviation = np.hypot(noise, contacts.offsets.deviation_n[k])
            yield Press.by_probe(
                ProbePose(ball, centre, rotations[k], deviation_mm=float(deviations[k])),
                len(fixed),
                force=ForceReading.along(normal, float(samples.force_n[i]), float(deviation)),
                fixed=fixed,
                step=int(steps[k]),
                direction=-normal,
                name=f"probe {samples.names[k]}",
            )
            steps[k] += 1


@dataclass(frozen=True, kw_only=True)
class PalpationOptions(PalpationSettings):
    """Read the palpation by a robot with a ball and a force sensor (see the module's docstring)."""

    columns: Mapping[str, str] | None = option(
        None, "Columns of quantities that have other names, such as {fz: force_z}"
    )
    units: Mapping[str, str] | None = option(
        None, "Units of quantities, if not those of the names, such as {x: m, y: m, z: m}"
    )

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a file; see `import_palpation`."""
        return self.record(read_rows(Path(path), self.columns or {}, self.units or {}), path)

    def _state_unit(self, what: str, unit: str, rows: Rows) -> str:
        prefixes = ["f"] if what == "force" else [""]
        if what == "position" and rows.contacts_mm is not None:
            prefixes.append("contact_")
        units = ", ".join(f"{prefix}{axis}: {unit}" for prefix in prefixes for axis in "xyz")
        inches = " (or in instead of cm)" if unit == "cm" else ""
        return f'give "format.units={{{units}}}"{inches}'


def import_palpation(path: str | Path, **options: Any) -> Recording:
    """Read the palpation by a robot with a ball and a force sensor (see the module's docstring).

    Args:
        path: The file.
        options: Settings, see `PalpationOptions`.

    Returns:
        A recording of material `linear`, whose presses are by a ball at its measured pose with the
        measured force along the normal. The names are `probe N`.

    Raises:
        ConfigError: a setting is not valid.
        FileError: the file cannot be used; names line, column or probe, and remedy.
        MeshError: the surface or the mesh cannot be used.
        RecordingError: the file does not make a valid recording.
    """
    return PalpationOptions(**options)(path=path)


def _count_rows(samples: Samples, total: int, without: int, source: str) -> dict[str, Any]:
    """Report the numbers of rows that are used and left out, and return them."""
    used = int(samples.count.sum())
    left = {"without a number": without, **samples.left_out}
    left = {reason: count for reason, count in left.items() if count}
    _log.info(
        "'%s': %d of %d rows are used, of %d probes. Left out: %s.", source, used, total,
        len(samples.names), ", ".join(f"{n} {reason}" for reason, n in left.items()) or "none",
    )  # fmt: skip
    return {"rows": total, "rows_used": used, "rows_left_out": left}


def _rotations(normals: Float[np.ndarray, "k 3"]) -> list[Float[np.ndarray, "3 3"]]:
    """Return rotations whose z axes are the normals."""
    across = np.linalg.svd(normals[:, None])[2][:, 1]
    axes = np.stack([across, np.cross(normals, across), normals], axis=2)
    return [frozen(rotation) for rotation in axes]
