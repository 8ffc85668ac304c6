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

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.config import Options, option
from tactorch.errors import FileError
from tactorch.fem.contact import Ball
from tactorch.fem.contact.pressures import ball_force
from tactorch.importers.tables import read_table
from tactorch.mesh import TetMesh, read_mesh
from tactorch.mesh.block import HeightField, block_below
from tactorch.recording import ForceReading, MaterialSpec, Press, ProbePose, Recording

_log = logging.getLogger(__name__)
_POSITION = ("x_mm", "y_mm", "z_mm")
_FORCE = ("fx_n", "fy_n", "fz_n")
_CONTACT = ("contact_x_mm", "contact_y_mm", "contact_z_mm")
_NORMAL = ("normal_x", "normal_y", "normal_z")
_MIN_SAMPLES = 4  # of a probe
_MIN_TRAVEL = 0.05  # of a probe, over the ball's radius
_MIN_CLEAR = 20  # samples clear of the surface that tell the offset of the force sensor
_UNIT = 0.2  # of the length of a unit normal, which rounding and averaging change
_MIN_UP = 0.05  # component of a normal along z, the axis of the height of the surface
_STEPS = 60  # of the search for the first contact, within the ball's radius
_COMMON = 0.3  # deviation of the depth of the first sample among probes, over the ball's radius
_OUTLIER = 12.0  # deviation of a sample from its probe, in standard deviations of the noise
_MAX_SAMPLE = 2  # of a probe that are left out as outliers
_NAMED = 8  # probes that a message names


@dataclass(frozen=True, kw_only=True)
class PalpationOptions(Options):
    """Read the palpation by a robot with a ball and a force sensor (see the module's docstring)."""

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
        0.1, "Standard deviation of the depth of a probe, common to its presses", unit="mm", ge=0
    )
    check_units: bool = option(True, "Refuse magnitudes that suggest a wrong unit")

    def __call__(self, *, path: str | Path) -> Recording:
        """Read a file; see `import_palpation`."""
        samples = _read(Path(path), self.radius_mm, check_units=self.check_units)
        samples, contacts = _find_contacts(samples, self.noise_n, str(path))
        samples = samples.reduced(self.depths)
        block = self._body(samples, contacts)
        return _record(self, samples, contacts, *block, source=Path(path).name)

    def _body(
        self, samples: "Samples", contacts: "Contacts"
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


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of probes.

    Attributes:
        numbers: Number of each probe in the file.
        normals: Outward unit normal of each probe.
        origins_mm: A point on the axis of each probe at which its ball touches nothing or little.
        radius_mm: Radius of the ball.
        probe: Index of the probe of each sample.
        centres_mm: Centre of the ball.
        advance_mm: Motion along minus the normal from the origin.
        force_n: Force on the ball along the normal.
        count: Number of samples that were averaged.
    """

    numbers: Int[np.ndarray, " probes"]
    normals: Float[np.ndarray, "probes 3"]
    origins_mm: Float[np.ndarray, "probes 3"]
    radius_mm: float
    probe: Int[np.ndarray, " s"]
    centres_mm: Float[np.ndarray, "s 3"]
    advance_mm: Float[np.ndarray, " s"]
    force_n: Float[np.ndarray, " s"]
    count: Float[np.ndarray, " s"]

    def keep(self, kept: Bool[np.ndarray, " s"]) -> "Samples":
        """Return some of the samples, and the probes that have any."""
        probes, inverse = np.unique(self.probe[kept], return_inverse=True)
        return replace(
            self,
            numbers=self.numbers[probes], normals=self.normals[probes],
            origins_mm=self.origins_mm[probes], probe=inverse, centres_mm=self.centres_mm[kept],
            advance_mm=self.advance_mm[kept], force_n=self.force_n[kept], count=self.count[kept],
        )  # fmt: skip

    def reduced(self, depths: int | None) -> "Samples":
        """Return means of successive samples, so many of each probe."""
        if depths is None:
            return self
        order = np.lexsort((self.advance_mm, self.probe))
        sizes = np.bincount(self.probe)
        rank = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        parts = np.minimum(rank * depths // np.repeat(sizes, sizes), depths - 1)
        key = self.probe[order] * depths + parts
        _, group, count = np.unique(key, return_inverse=True, return_counts=True)

        def mean(values: np.ndarray) -> np.ndarray:
            total = np.zeros((len(count), *values.shape[1:]))
            np.add.at(total, group, values[order])
            return total / count.reshape(-1, *(1,) * (values.ndim - 1))

        return replace(
            self, probe=mean(self.probe).astype(int), centres_mm=mean(self.centres_mm),
            advance_mm=mean(self.advance_mm), force_n=mean(self.force_n), count=count * 1.0,
        )  # fmt: skip


class Contacts(NamedTuple):
    """First contacts.

    Attributes:
        points_mm: First contact of each probe.
        depth_mm: Depth of the ball at its origin, (probes,), mm.
        noise_n: Standard deviation of the noise of a sample.
        tare_n: Offset of the force sensor, which the forces no longer have.
        clear: Number of samples that are clear of the surface.
    """

    points_mm: Float[np.ndarray, "probes 3"]
    depth_mm: Float[np.ndarray, " probes"]
    noise_n: float
    tare_n: float
    clear: int


def _read(path: Path, radius_mm: float | None, *, check_units: bool) -> Samples:
    """Read the file; rows and probes without use are left out, and named."""
    table = read_table(
        path, "palpation", ("probe", *_POSITION, *_FORCE), (*_CONTACT, *_NORMAL)
    )

    def columns(names: tuple[str, ...]) -> Float[np.ndarray, "s 3"]:
        return np.column_stack([table[name] for name in names])

    centres, forces = columns(_POSITION), columns(_FORCE)
    bad = ~np.isfinite(np.column_stack([table["probe"], centres, forces])).all(axis=1)
    if bad.any():
        _log.warning("'%s': %d rows without a number in every column are left out.", path, bad.sum())
    numbers, first, probe = np.unique(
        np.where(bad, np.nan, table["probe"]), return_index=True, return_inverse=True
    )
    if check_units:
        _check_units(path, centres[~bad], forces[~bad])
    has_contacts = _CONTACT[0] in table
    ends = [_first_and_last(np.flatnonzero((probe == k) & ~bad)) for k in range(len(numbers))]
    starts = np.array([a for a, _ in ends])
    motion = centres[[b for _, b in ends]] - centres[starts]
    travel = np.linalg.norm(motion, axis=1)
    normals = -motion / np.maximum(travel, 1e-300)[:, None]
    radius = radius_mm
    if has_contacts:
        normals, contacts = columns(_NORMAL)[first], columns(_CONTACT)[first]
        if radius is None:
            radius = _radius(path, centres[starts], contacts)
    if radius is None:
        raise FileError(
            f"'{path}' has no contacts that tell the radius of the ball; give format.radius_mm."
        )
    lengths = np.linalg.norm(normals, axis=1)
    faults = {
        "no number": ~np.isfinite(numbers),
        f"fewer than {_MIN_SAMPLES} samples": np.bincount(probe[~bad], minlength=len(numbers))
        < _MIN_SAMPLES,
        f"a travel of less than {_MIN_TRAVEL * radius:.2g} mm": travel < _MIN_TRAVEL * radius,
        "no unit normal": ~(np.abs(lengths - 1.0) < _UNIT),
        "a normal that does not point upwards (z)": ~(normals[:, 2] > _MIN_UP * lengths),
    }
    usable = np.ones(len(numbers), dtype=bool)
    for reason, faulty in faults.items():
        _name_probes(path, numbers[faulty & usable], reason)
        usable &= ~faulty
    if not usable.any():
        raise FileError(
            f"'{path}' has no probe that can be used; see the warnings. Normals must point out of "
            "the object, with z upwards."
        )
    normals = normals / np.maximum(lengths, 1e-300)[:, None]
    origins = centres[starts]
    advance = -((centres - origins[probe]) * normals[probe]).sum(axis=1)
    force = (forces * normals[probe]).sum(axis=1)
    whole = np.where(np.isfinite(numbers), numbers, -1).astype(int)
    samples = Samples(
        whole, normals, origins, radius, probe, centres, advance, force, np.ones(len(force))
    )
    return samples.keep(~bad & usable[probe])


def _first_and_last(rows: Int[np.ndarray, " k"]) -> tuple[int, int]:
    return (int(rows[0]), int(rows[-1])) if len(rows) else (0, 0)


def _check_units(
    path: Path, centres: Float[np.ndarray, "s 3"], forces: Float[np.ndarray, "s 3"]
) -> None:
    span = float(np.linalg.norm(np.ptp(centres, axis=0))) if len(centres) else 0.0
    if not 1.0 < span < 1e4:
        raise FileError(
            f"'{path}': positions span {span:.3g} mm; another unit? Convert to mm, or pass "
            "format.check_units=false."
        )
    largest = float(np.linalg.norm(forces, axis=1).max())
    if not 1e-3 < largest < 1e3:
        raise FileError(
            f"'{path}': forces reach {largest:.3g} N; another unit? Convert to N, or pass "
            "format.check_units=false."
        )


def _radius(
    path: Path, starts: Float[np.ndarray, "probes 3"], contacts: Float[np.ndarray, "probes 3"]
) -> float:
    """Return the distance of the ball's centre from the contacts, mm."""
    distances = np.linalg.norm(starts - contacts, axis=1)
    distances = distances[np.isfinite(distances) & (distances > 0.0)]
    if not len(distances):
        raise FileError(f"'{path}' has no contact; give format.radius_mm.")
    radius = float(np.median(distances))
    _log.info("The radius of the ball is %.3g mm by the contacts of the file.", radius)
    return radius


def _name_probes(path: str | Path, numbers: np.ndarray, reason: str) -> None:
    if len(numbers):
        shown = ", ".join(f"{n:g}" for n in numbers[:_NAMED])
        more = f" and {len(numbers) - _NAMED} more" if len(numbers) > _NAMED else ""
        _log.warning("'%s': probes with %s are left out: %s%s.", path, reason, shown, more)


def _find_contacts(
    samples: Samples, noise_n: float | None, source: str
) -> tuple[Samples, Contacts]:
    """Return the samples without offset and outliers, and the first contacts."""
    noise = noise_n or _noise(samples)
    tare, clear = 0.0, 0
    depths = _first_depths(samples, noise)
    # Samples that are clear of the surface by more than the uncertainty of its place.
    free = samples.advance_mm + depths[samples.probe] < -_MIN_TRAVEL * samples.radius_mm
    if free.sum() >= _MIN_CLEAR:
        tare, clear = float(np.median(samples.force_n[free])), int(free.sum())
        samples = replace(samples, force_n=samples.force_n - tare)
        depths = _first_depths(samples, noise)
    else:
        _log.warning(
            "'%s' has %d samples that are clear of the surface, of %d that are needed: the offset "
            "of the force sensor is taken as zero.", source, free.sum(), _MIN_CLEAR,
        )
    samples, depths = _without_outliers(samples, depths, noise, source)
    contacts = samples.origins_mm - (samples.radius_mm - depths)[:, None] * samples.normals
    return samples, Contacts(contacts, depths, noise, tare, clear)


def _noise(samples: Samples) -> float:
    """Estimate the noise of a force from second differences along each probe, N.

    Samples at equal steps are assumed; the curvature of the force adds to the noise. The median
    over probes hardly depends on those that end in something stiff.
    """
    order = np.lexsort((samples.advance_mm, samples.probe))
    force, probe = samples.force_n[order], samples.probe[order]
    second = force[2:] - 2.0 * force[1:-1] + force[:-2]
    same = probe[2:] == probe[:-2]
    return float(max(np.median(np.abs(second[same])) / (0.6745 * np.sqrt(6.0)), 1e-6))


def _half_space(samples: Samples, depths: Float[np.ndarray, " probes"]) -> np.ndarray:
    """Force of each sample on a half-space of unit plane-strain modulus, N/MPa."""
    return ball_force(samples.advance_mm + depths[samples.probe], samples.radius_mm)


def _first_depths(samples: Samples, noise: float) -> Float[np.ndarray, " probes"]:
    """Return the depth of the ball at each origin that fits the forces best, mm.

    A depth is negative where the origin is clear of the surface. The most frequent depth is more
    probable than others.
    """
    radius, count = samples.radius_mm, len(samples.numbers)
    travel = np.zeros(count)
    np.maximum.at(travel, samples.probe, samples.advance_mm)
    lowest = float(np.median(travel))
    grid = np.linspace(-lowest, 0.5 * radius, 2 * _STEPS)
    costs = np.array([_cost(samples, np.full(count, depth)) for depth in grid]) / noise**2
    common = grid[np.argmin(np.median(costs, axis=1))]
    prior = ((grid - common) / (_COMMON * radius)) ** 2
    best = np.argmin(costs + prior[:, None], axis=0)
    depths: np.ndarray = grid[best]
    return depths


def _cost(samples: Samples, depths: Float[np.ndarray, " probes"]) -> Float[np.ndarray, " probes"]:
    """Sum of squares of each probe left by the best modulus, N^2."""
    force, unit = samples.force_n, _half_space(samples, depths)
    count = len(samples.numbers)
    products = (np.bincount(samples.probe, a * b, count)
                for a, b in ((unit, force), (unit, unit), (force, force)))  # fmt: skip
    mixed, squares, total = products
    gain = np.where(squares > 0.0, np.maximum(mixed, 0.0) ** 2 / np.maximum(squares, 1e-300), 0.0)
    return total - gain


def _without_outliers(
    samples: Samples, depths: Float[np.ndarray, " probes"], noise: float, source: str
) -> tuple[Samples, Float[np.ndarray, " probes"]]:
    """Leave out probes whose force does not rise, and single samples far from their neighbours."""
    unit, count = _half_space(samples, depths), len(samples.numbers)
    squares = np.bincount(samples.probe, unit**2, count)
    stiffness = np.bincount(samples.probe, unit * samples.force_n, count) / np.maximum(squares, 1e-300)
    flat = stiffness * np.sqrt(squares) < 3.0 * noise
    _name_probes(source, samples.numbers[flat], "a force that does not rise")
    residual = np.abs(samples.force_n - stiffness[samples.probe] * unit)
    # A sample counts as an outlier beside the others of its probe, which have their own misfit.
    middle = np.array([np.median(residual[samples.probe == k]) for k in range(count)])
    far = residual > _OUTLIER * np.maximum(noise, middle[samples.probe])
    few = np.bincount(samples.probe, far, count) <= _MAX_SAMPLE
    far &= few[samples.probe]
    if far.any():
        named = np.unique(samples.numbers[samples.probe[far]])
        _log.warning(
            "'%s': %d samples far from the others of their probe are left out, of probes %s.",
            source, far.sum(), ", ".join(map(str, named[:_NAMED])),
        )  # fmt: skip
    kept = ~far & ~flat[samples.probe]
    if not kept.any():
        raise FileError(
            f"'{source}': no probe's force rises with depth; give the force on the ball in N, along"
            " the outward normal."
        )
    return samples.keep(kept), depths[np.unique(samples.probe[kept])]


def _record(
    options: PalpationOptions,
    samples: Samples,
    contacts: Contacts,
    mesh: TetMesh,
    fixed: Bool[np.ndarray, "n 3"],
    above_mm: Float[np.ndarray, " probes"],
    source: str,
) -> Recording:
    """Return the recording; poses are moved along the normal so that contacts are on the mesh."""
    fixed.setflags(write=False)
    ball, presses, steps = Ball(samples.radius_mm), [], np.zeros(len(samples.numbers), dtype=int)
    rotations = [_rotation(normal) for normal in samples.normals]
    for i in np.lexsort((samples.advance_mm, samples.probe)):
        k = int(samples.probe[i])
        normal = samples.normals[k]
        # On the axis: motion across it is that of the robot's compliance.
        depth = samples.advance_mm[i] + contacts.depth_mm[k]
        centre = contacts.points_mm[k] + (samples.radius_mm - depth + above_mm[k]) * normal
        pose = ProbePose(ball, centre, rotations[k], deviation_mm=options.contact_mm)
        deviation = contacts.noise_n / np.sqrt(samples.count[i])
        force = ForceReading.along(normal, float(samples.force_n[i]), float(deviation))
        presses.append(
            Press.by_probe(
                pose, mesh.n_points, force=force, fixed=fixed, step=int(steps[k]),
                direction=-normal, name=f"probe {samples.numbers[k]}",
            )  # fmt: skip
        )
        steps[k] += 1
    provenance = {
        "importer": "palpation", "file": source, "ball_radius_mm": samples.radius_mm,
        "probes": len(samples.numbers), "noise_n": contacts.noise_n, "tare_n": contacts.tare_n,
        "samples_clear_of_the_surface": contacts.clear, "depth_mm": options.depth_mm,
        "block": options.mesh is None,
    }  # fmt: skip
    return Recording(
        mesh, tuple(presses), MaterialSpec("linear", options.poisson),
        provenance=provenance, check_units=options.check_units,
    )  # fmt: skip


def _rotation(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation whose z axis is the normal."""
    across = np.linalg.svd(normal[None])[2][1:]
    rotation = np.column_stack([across[0], np.cross(normal, across[0]), normal])
    rotation.setflags(write=False)
    return rotation
