"""Recipe of a dataset: all settings that determine its samples."""

from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option, to_mapping
from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, make_material
from tactorch.inverse import Settings
from tactorch.mesh import BodyFile, Box, Shape, TetMesh
from tactorch.mesh.geometry import bounding_diagonal
from tactorch.mesh.lattice import lattice_mesh
from tactorch.mesh.tetmesh import FaceName
from tactorch.phantoms import Phantom, RandomPhantom
from tactorch.phantoms.draws import Range, check_ranges
from tactorch.recording import MaterialSpec
from tactorch.simulation import PressPlan
from tactorch.touch.coupled import check_material
from tactorch.touch.options import TouchOptions

LINEAR = "linear"


@dataclass(frozen=True)
class PressDraw(Options):
    """Distribution of plans of presses.

    A pressure of `load` follows the object's stiffness, as a person presses soft objects more
    gently; its logarithm is uniformly distributed.
    """

    section: ClassVar[str] = "dataset.presses"
    faces: tuple[tuple[FaceName, ...], ...] = option(
        (("z+", "x+", "y+"),), "Sets of pressed faces, one of which is drawn", nonempty=True
    )
    p_max_mpa: Range = option((0.02, 0.02), "Range of the highest pressure", unit="MPa", gt=0)
    load: Range | None = option(
        None, "Range of the highest pressure over the median modulus, in place of p_max_mpa", gt=0
    )
    steps: tuple[int, ...] = option(
        (4,), "Numbers of load steps, one of which is drawn", ge=1, nonempty=True
    )
    patch_radius_mm: Range | None = option(
        None, "Range of the radius of pressed patches; null: whole faces", unit="mm", gt=0
    )
    patches: tuple[int, int] = option((1, 1), "Fewest and most patches on each face", ge=1)
    patch_share: float = option(
        1.0, "Share of the plans that press patches; the others press whole faces", ge=0, le=1
    )
    support: Literal["springs", "fixed", "roller"] = option(
        "springs", "Support of the opposite face"
    )
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "p_max_mpa", "load", "patch_radius_mm", "patches")
        for faces, steps in product(self.faces, self.steps):  # refuse plans that cannot be made
            self._plan(p_max_mpa=self.p_max_mpa[0], steps=steps, faces=faces)

    def _plan(self, **options: Any) -> PressPlan:
        return PressPlan(support=self.support, spring_n_per_mm=self.spring_n_per_mm, **options)

    def draw(
        self, rng: np.random.Generator, bounds: Float[np.ndarray, "2 3"], youngs_mpa: float
    ) -> PressPlan:
        """Draw a plan for an object of a bounding box, mm, and a median modulus, MPa."""
        faces = self.faces[int(rng.integers(len(self.faces)))]
        if self.load is None:
            p_max_mpa = float(rng.uniform(*self.p_max_mpa))
        else:
            p_max_mpa = youngs_mpa * float(np.exp(rng.uniform(*np.log(self.load))))
        steps = self.steps[int(rng.integers(len(self.steps)))]
        plan = {"p_max_mpa": p_max_mpa, "steps": steps, "faces": faces}
        if self.patch_radius_mm is None or rng.random() >= self.patch_share:
            return self._plan(**plan)
        radius = float(rng.uniform(*self.patch_radius_mm))
        count = int(rng.integers(self.patches[0], self.patches[1] + 1))
        margin = np.minimum(radius, (bounds[1] - bounds[0]) / 2)
        centers = rng.uniform(bounds[0] + margin, bounds[1] - margin, (count, 3)).tolist()
        return self._plan(**plan, patch_radius_mm=radius, patch_centers_mm=centers)


@dataclass(frozen=True)
class MeshSizes(Options):
    """Sizes of the elements of random objects."""

    section: ClassVar[str] = "dataset.mesh"
    relative_edge_length: float = option(
        0.1, "Edge length as a fraction of the bounding box's diagonal", gt=0
    )
    fine_relative: float | None = option(
        0.05, "The same of the mesh to simulate on; null: the same mesh, an inverse crime", gt=0
    )

    def meshes(
        self, phantom: Phantom, *, any_shape: bool = False
    ) -> tuple[TetMesh, TetMesh | None]:
        """Return the recording's mesh and the simulation's; they are the same every time.

        Args:
            phantom: The body.
            any_shape: Whether bodies that are no boxes are meshed, by a lattice.

        Raises:
            ConfigError: The body is no box.
            MeshError: The elements are larger than parts of the body.
        """
        if any_shape and not isinstance(phantom.body, Box):
            mesh = partial(_lattice, phantom)
        else:
            mesh = partial(phantom.mesh, generator="structured")
        fine = self.fine_relative
        coarse_mesh = mesh(relative_edge_length=self.relative_edge_length)
        return coarse_mesh, None if fine is None else mesh(relative_edge_length=fine)


def _lattice(phantom: Phantom, relative_edge_length: float) -> TetMesh:
    body = phantom.body
    stamp = Path(body.path).stat().st_mtime_ns if isinstance(body, BodyFile) else 0
    return _lattice_of(body, relative_edge_length * bounding_diagonal(body.bounds()), stamp)


@lru_cache(maxsize=4)
def _lattice_of(body: Shape, edge_length_mm: float, stamp: int) -> TetMesh:
    """Mesh a body; that of a file, which takes seconds, is the same in all samples."""
    return lattice_mesh(body, edge_length_mm)


@dataclass(frozen=True)
class Recipe(Options):
    """Settings that determine the samples of a dataset, in any order of their computation.

    `material` has no Young's modulus. `inversion` are the settings of the inversion of each
    recording; "linear" stores the linear image in place of a reconstruction (see
    `tactorch.inverse.fit.linear_image`), None nothing.
    """

    section: ClassVar[str] = "dataset"
    name: str = option(help="Name of the dataset")
    count: int = option(help="Number of samples", ge=1)
    family: Any = option("inclusions", "Family of objects", section="family")
    seed: int = option(0, "Seed of all random draws", ge=0)
    views: int = option(1, "Recordings of each object, with their own presses and noise", ge=1)
    presses: PressDraw = option(factory=PressDraw, help="Distribution of the presses")
    touch: TouchOptions = option(
        factory=TouchOptions, help="Sensor that is pressed on the bodies, in place of presses"
    )
    mesh: MeshSizes = option(factory=MeshSizes, help="Sizes of the elements")
    poisson: Range | None = option(
        None, "Range of Poisson's ratio; null: that of the material", ge=0, lt=0.5
    )
    samples: int = option(4, "Samples per edge that average the modulus over cut elements", ge=1)
    snr_db: Range | None = option(
        (40.0, 40.0), "Range of the signal-to-noise ratio; null: no noise", unit="dB"
    )
    shard: int = option(50, "Samples in a file", ge=1)
    material: MaterialSpec = field(default_factory=lambda: MaterialSpec("neo_hookean", 0.45))
    element: str = "tet4"
    inversion: Settings | str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ranges(self, "snr_db", "poisson")
        if isinstance(self.inversion, str) and self.inversion != LINEAR:
            raise ConfigError(f"inversion={self.inversion!r}: give settings, {LINEAR!r} or None.")
        if isinstance(self.inversion, Settings) and self.inversion.max_seconds is not None:
            raise ConfigError(
                "max_seconds would make samples depend on the machine; limit max_iterations."
            )
        if self.element not in ELEMENTS:
            raise ConfigError(f"element={self.element!r}: choose one of {', '.join(ELEMENTS)}.")
        self._check_samples()

    def _check_samples(self) -> None:
        """Refuse what no sample could be made of, and files that cannot be read."""
        make_material(self.material.name, self.material.poisson, **self.material.parameters)
        if self.has_touch:
            self._check_touch()
        self.meshes(self.drawn(0).phantom)

    @property
    def has_touch(self) -> bool:
        """Whether a sensor is pressed on the bodies, and its images are stored."""
        return self.touch.sensor is not None

    def _check_touch(self) -> None:
        sensor = self.touch.description()
        check_material(self.material, sensor.gel.material)
        try:
            self.touch.gel_mesh(sensor.gel)
        except ConfigError as error:
            raise ConfigError(f"dataset.touch.gel_edge_mm: {error}") from error

    def meshes(self, phantom: Phantom) -> tuple[TetMesh, TetMesh | None]:
        """Return the mesh of the recording of a body, and that of the simulation."""
        return self.mesh.meshes(phantom, any_shape=self.has_touch)

    def drawn(self, index: int) -> RandomPhantom:
        """Draw the object of a sample."""
        rng = np.random.default_rng([self.seed, 0, index // self.views])
        drawn: RandomPhantom = self.family.draw(rng)
        return drawn

    def material_of(self, index: int) -> MaterialSpec:
        """Return the material of a sample's object."""
        if self.poisson is None:
            return self.material
        rng = np.random.default_rng([self.seed, 2, index // self.views])
        return replace(self.material, poisson=float(rng.uniform(*self.poisson)))

    @property
    def shards(self) -> int:
        """Number of files."""
        return -(-self.count // self.shard)

    def indices(self, shard: int) -> range:
        """Return the samples of a file."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.count))

    def to_config(self) -> dict[str, Any]:
        """Return all that determines the samples as plain values, to compare recipes by."""
        names = ("material", "element", "inversion")  # which a dataset's settings do not have
        config = to_mapping(self) | {name: to_mapping(getattr(self, name)) for name in names}
        if not self.has_touch:
            config.pop("touch")  # as in datasets that were made before there was touch
        else:
            config["touch"]["description"] = to_mapping(self.touch.description())
        if hasattr(self.family, "content_hash"):
            config["family"]["sha256"] = self.family.content_hash()
        return config
