"""Palpation by a robot with a ball and a force sensor, as a table in a CSV file.

A row is one sample; a probe is a series of samples at one place, while the ball moves into the
surface. Columns (others are ignored):

| column | what | unit |
|---|---|---|
| probe | number of the probe | |
| x_mm, y_mm, z_mm | centre of the ball | mm |
| fx_n, fy_n, fz_n | force on the ball, in the same axes | N |
| contact_x_mm, contact_y_mm, contact_z_mm | first contact found by the robot, optional | mm |
| normal_x, normal_y, normal_z | outward normal there, optional | |

Without the normal it is opposite to the motion. The contact is found from the forces: the depth of
the first sample and the stiffness of a probe fit the force on a ball in a half-space. Samples that
are clear of the surface give the offset of the force sensor; without any it is taken as zero, which
shifts all depths by about as much. The object is a block below the surface through the contacts;
its depth is not known to the robot and has to be stated.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import Options, option
from tactorch.fem.contact import Ball
from tactorch.importers.contacts import Contacts, find_contacts, unevenness
from tactorch.importers.samples import Samples, read_samples
from tactorch.mesh import TetMesh, read_mesh
from tactorch.mesh.block import HeightField, block_below
from tactorch.mesh.geometry import frozen
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording


@dataclass(frozen=True, kw_only=True)
class PalpationSettings(Options):
    """Object, ball and errors of a palpation, whatever its file."""

    section: ClassVar[str] = "format"
    radius_mm: float | None = option(
        None, "Radius of the ball; null: distance of its centre from the contacts in the file",
        unit="mm", gt=0,
    )  # fmt: skip
    depth_mm: float = option(
        15.0, "Depth of the object's bottom below the lowest contact", unit="mm", gt=0
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
        4, "Presses of each probe: successive samples are averaged; null: all samples", ge=1
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
    check_units: bool = option(True, "Refuse magnitudes that suggest a wrong unit")

    def record(self, samples: Samples, path: str | Path) -> Recording:
        """Return the recording of the samples of a file: contacts, object and presses."""
        samples, contacts = find_contacts(samples, self.noise_n, str(path))
        samples = samples.reduced(self.depths)
        mesh, fixed, above_mm = self._body(samples, contacts)
        provenance = {
            "importer": "palpation", "file": Path(path).name, "ball_radius_mm": samples.radius_mm,
            "probes": len(samples.numbers), "noise_n": contacts.noise_n, "tare_n": contacts.tare_n,
            "samples_clear_of_the_surface": contacts.clear, "depth_mm": self.depth_mm,
            "block": self.mesh is None,
        }  # fmt: skip
        return Recording(
            mesh, tuple(self._presses(samples, contacts, frozen(fixed), above_mm)),
            MaterialSpec("linear", self.poisson), provenance=provenance,
            check_units=self.check_units,
        )  # fmt: skip

    def _body(
        self, samples: Samples, contacts: Contacts
    ) -> tuple[TetMesh, Bool[np.ndarray, "n 3"], Float[np.ndarray, " probes"]]:
        """Return the object, its supports, and the heights of the contacts below its surface."""
        if self.mesh is not None:
            mesh = read_mesh(self.mesh, unit="mm")
            low, high = mesh.bounds
            held = mesh.points[:, 2] < low[2] + 1e-3 * (high - low)[2]
            return mesh, np.repeat(held[:, None], 3, axis=1), np.zeros(len(contacts.points_mm))
        height = HeightField(contacts.points_mm)
        block = block_below(
            height, depth_mm=self.depth_mm, margin_mm=self.margin_mm, edge_mm=self.edge_mm
        )
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
    ) -> Iterator[Press]:
        """Yield the presses; poses are moved along the normal so that contacts are on the mesh."""
        ball, steps = Ball(samples.radius_mm), np.zeros(len(samples.numbers), dtype=int)
        rotations = [_rotation(normal) for normal in samples.normals]
        deviations = np.hypot(self.contact_mm, unevenness(contacts.points_mm))
        for i in np.lexsort((samples.advance_mm, samples.probe)):
            k = int(samples.probe[i])
            normal = samples.normals[k]
            # On the axis: motion across it is that of the robot's compliance.
            depth = samples.advance_mm[i] + contacts.depth_mm[k]
            centre = contacts.points_mm[k] + (samples.radius_mm - depth + above_mm[k]) * normal
            deviation = contacts.noise_n / np.sqrt(samples.count[i])
            yield Press.by_probe(
                ProbePose(ball, centre, rotations[k], deviation_mm=float(deviations[k])),
                len(fixed),
                force=ForceReading.along(normal, float(samples.force_n[i]), float(deviation)),
                fixed=fixed,
                step=int(steps[k]),
                direction=-normal,
                name=f"probe {samples.numbers[k]}",
            )
            steps[k] += 1


@dataclass(frozen=True, kw_only=True)
class PalpationOptions(PalpationSettings):
    """Read the palpation by a robot with a ball and a force sensor (see the module's docstring)."""

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a file; see `import_palpation`."""
        samples = read_samples(Path(path), self.radius_mm, check_units=self.check_units)
        return self.record(samples, path)


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


def _rotation(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation whose z axis is the normal."""
    across = np.linalg.svd(normal[None])[2][1:]
    return frozen(np.column_stack([across[0], np.cross(normal, across[0]), normal]))
