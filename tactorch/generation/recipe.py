"""What a dataset is made of: all that decides its samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, make_material
from tactorch.generation.plans import PressDraw
from tactorch.inverse import Settings
from tactorch.inverse.settings import stored_settings
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real, positive
from tactorch.phantoms import Phantom, RandomPhantom, draw_phantom
from tactorch.plain import plain
from tactorch.recording import MaterialSpec

LINEAR = "linear"


@dataclass(frozen=True)
class MeshSizes:
    """How fine an object is meshed.

    Attributes:
        relative_edge_length: Of the recording, as a share of the bounding box's diagonal.
        fine_relative: Of the mesh that presses are solved on; None for the same mesh, an inverse
            crime.
    """

    relative_edge_length: Real = 0.1
    fine_relative: Real | None = 0.05

    def __post_init__(self) -> None:
        positive("relative_edge_length", self.relative_edge_length)
        if self.fine_relative is not None:
            positive("fine_relative", self.fine_relative)

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
class Recipe:
    """Determines every sample of a dataset, independent of process and order.

    Attributes:
        name: Of the dataset.
        count: Number of samples.
        family: Of objects, see `tactorch.phantoms.FAMILIES`.
        options: Of the family.
        seed: Of everything drawn.
        views: Recordings of each object, each with separate presses and noise.
        presses: What plans of presses are drawn from.
        mesh: How fine objects are meshed.
        material: The constitutive law but for Young's modulus.
        poisson: Range of Poisson's ratio, drawn for each object; None takes the material's.
        samples: How elements get their modulus, see `Phantom.on_mesh`.
        element: "tet4" or "tet10", of the simulation.
        snr_db: Range of the signal-to-noise ratio; None for no noise.
        inversion: How each recording is inverted; "linear" stores the linear image in place of a
            reconstruction (see `tactorch.inverse.linear_image`), None nothing.
        shard: Samples in a file.

    Raises:
        ConfigError: A value cannot be used.
    """

    name: str
    count: int
    family: str = "inclusions"
    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    views: int = 1
    presses: PressDraw = field(default_factory=PressDraw)
    mesh: MeshSizes = field(default_factory=MeshSizes)
    material: MaterialSpec = field(default_factory=lambda: MaterialSpec("neo_hookean", 0.45))
    poisson: Sequence[Real] | None = None
    samples: int = 4
    element: str = "tet4"
    snr_db: Sequence[Real] | None = (40.0, 40.0)
    inversion: Settings | str | None = None
    shard: int = 50

    def __post_init__(self) -> None:
        for name in ("count", "views", "shard", "samples"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} must be at least 1.")
        if self.seed < 0:
            raise ConfigError(f"seed={self.seed} must not be negative.")
        if self.snr_db is not None and (
            len(self.snr_db) != 2 or not self.snr_db[0] <= self.snr_db[1]
        ):
            raise ConfigError(f"snr_db={self.snr_db}: give the lower and the upper end, in dB.")
        if isinstance(self.inversion, str) and self.inversion != LINEAR:
            raise ConfigError(f"inversion={self.inversion!r}: give settings, {LINEAR!r} or None.")
        if isinstance(self.inversion, Settings) and self.inversion.max_seconds is not None:
            raise ConfigError(
                "max_seconds would make samples depend on the machine; limit max_iterations."
            )
        # Refuse what no sample could be made of.
        ELEMENTS[self.element]  # raises for an unknown name
        if self.poisson is not None and (
            len(self.poisson) != 2 or not 0.0 <= self.poisson[0] <= self.poisson[1] < 0.5
        ):
            raise ConfigError(
                f"poisson={self.poisson}: give the lower and the upper end, from 0 to below 0.5."
            )
        make_material(self.material.name, self.material.poisson, **self.material.parameters)
        self.mesh.meshes(self.drawn(0).phantom)

    def drawn(self, index: int) -> RandomPhantom:
        """Draw the object of a sample."""
        rng = np.random.default_rng([self.seed, 0, index // self.views])
        return draw_phantom(self.family, rng, **self.options)

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
        if isinstance(self.inversion, Settings):
            config["inversion"] = stored_settings(self.inversion)
        return config
