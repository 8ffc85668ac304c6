"""What a dataset is made of: all that decides its samples."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from tactorch.config import Options, option, to_mapping
from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, make_material
from tactorch.generation.plans import PressDraw
from tactorch.inverse import Settings
from tactorch.inverse.settings import stored_settings
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom, RandomPhantom
from tactorch.phantoms.families import FAMILIES
from tactorch.plain import plain
from tactorch.recording import MaterialSpec

LINEAR = "linear"


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

    def meshes(self, phantom: Phantom) -> tuple[TetMesh, TetMesh | None]:
        """Return the recording's mesh and the finer one; structured: the same every time.

        Raises:
            ConfigError: The body is no box.
        """
        own = phantom.mesh(relative_edge_length=self.relative_edge_length, generator="structured")
        if self.fine_relative is None:
            return own, None
        fine = phantom.mesh(relative_edge_length=self.fine_relative, generator="structured")
        return own, fine


@dataclass(frozen=True)
class Recipe(Options):
    """Settings that determine the samples of a dataset, in any order of their computation.

    Attributes:
        name: Name of the dataset.
        count: Number of samples.
        family: Family of objects, of `tactorch.phantoms.FAMILIES`.
        seed: Seed of all random draws.
        views: Recordings of each object, with their own presses and noise.
        presses: Distribution of the plans of presses.
        mesh: Sizes of the elements.
        poisson: Range of Poisson's ratio, drawn for each object; None takes the material's.
        samples: Samples per edge that average the modulus, see `Phantom.on_mesh`.
        snr_db: Range of the signal-to-noise ratio, dB; None for no noise.
        shard: Samples in a file.
        material: Material, without Young's modulus.
        element: Element type of the simulation, "tet4" or "tet10".
        inversion: Settings of the inversion of each recording; "linear" stores the linear image in
            place of a reconstruction (see `tactorch.inverse.linear_image`), None nothing.

    Raises:
        ConfigError: a value cannot be used.
    """

    section: ClassVar[str] = "dataset"
    name: str = option(help="Name of the dataset")
    count: int = option(help="Number of samples", ge=1)
    family: Any = option("inclusions", "Family of objects", section="family")
    seed: int = option(0, "Seed of all random draws", ge=0)
    views: int = option(1, "Recordings of each object, with their own presses and noise", ge=1)
    presses: PressDraw = option(factory=PressDraw, help="Distribution of the presses")
    mesh: MeshSizes = option(factory=MeshSizes, help="Sizes of the elements")
    poisson: tuple[float, float] | None = option(
        None, "Range of Poisson's ratio; null: that of the material", ge=0, lt=0.5
    )
    samples: int = option(4, "Samples per edge that average the modulus over cut elements", ge=1)
    snr_db: tuple[float, float] | None = option(
        (40.0, 40.0), "Range of the signal-to-noise ratio; null: no noise", unit="dB"
    )
    shard: int = option(50, "Samples in a file", ge=1)
    material: MaterialSpec = field(default_factory=lambda: MaterialSpec("neo_hookean", 0.45))
    element: str = "tet4"
    inversion: Settings | str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("snr_db", "poisson"):
            pair = getattr(self, name)
            if pair is not None and pair[0] > pair[1]:
                raise ConfigError(f"dataset.{name}={list(pair)}: give the lower end first.")
        if isinstance(self.inversion, str) and self.inversion != LINEAR:
            raise ConfigError(f"inversion={self.inversion!r}: give settings, {LINEAR!r} or None.")
        if isinstance(self.inversion, Settings) and self.inversion.max_seconds is not None:
            raise ConfigError(
                "max_seconds would make samples depend on the machine; limit max_iterations."
            )
        # Refuse what no sample could be made of.
        if self.element not in ELEMENTS:
            raise ConfigError(f"element={self.element!r}: choose one of {', '.join(ELEMENTS)}.")
        make_material(self.material.name, self.material.poisson, **self.material.parameters)
        self.mesh.meshes(self.drawn(0).phantom)

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
        low, high = map(float, self.poisson)
        return replace(self.material, poisson=float(rng.uniform(low, high)))

    @property
    def shards(self) -> int:
        """Number of files."""
        return -(-self.count // self.shard)

    def indices(self, shard: int) -> range:
        """Return the samples of a file."""
        return range(shard * self.shard, min((shard + 1) * self.shard, self.count))

    def to_config(self) -> dict[str, Any]:
        """Return all that decides the samples as plain values, to compare recipes by."""
        config = plain(self)
        assert isinstance(config, dict)
        config["family"] = {"name": FAMILIES.name_of(type(self.family)), **to_mapping(self.family)}
        if isinstance(self.inversion, Settings):
            config["inversion"] = stored_settings(self.inversion)
        return config
