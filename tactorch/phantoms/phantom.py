"""A phantom: a body of one Young's modulus with inclusions of others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import Shape, TetMesh
from tactorch.mesh.values import Real, positive
from tactorch.phantoms.background import (
    Background,
    background_from_config,
    background_to_config,
)
from tactorch.phantoms.config import (
    as_mapping,
    refuse_unknown,
    shape_from_config,
    shape_to_config,
)
from tactorch.phantoms.extent import protrusion
from tactorch.phantoms.meshing import BODIES, mesh_body
from tactorch.phantoms.sampling import element_means

#: The modulus of a hole: the lower bound of the paper's inversions (Section IV-A), MPa.
HOLE_MPA = 1e-3
#: How far a mesh's bounding box or an inclusion may leave the body, as a share of its diagonal.
TOLERANCE = 5e-3


class Inclusion(NamedTuple):
    """A part of other stiffness: where it is, and its Young's modulus, MPa."""

    shape: Shape
    youngs_mpa: float


@dataclass(frozen=True)
class Phantom:
    """A soft body with inclusions.

    Attributes:
        body: The outer shape, one of `BODIES`: a box, cylinder, hemisphere or hyperboloid; mm.
        inclusions: Pairs of a shape and its Young's modulus, MPa. Where two overlap the later one
            counts. They may touch the body's surface but not reach out of it.
        youngs_mpa: Young's modulus of all the rest, MPa; one number or a `Background`. A hole is
            an inclusion of a modulus that bears nothing, such as `HOLE_MPA`.

    Raises:
        ConfigError: A modulus is not positive, an inclusion reaches out of the body, or the body
            cannot be meshed; the message names it.
    """

    body: Shape
    inclusions: Sequence[tuple[Shape, Real]] = ()
    youngs_mpa: Real | Background = 0.2

    def __post_init__(self) -> None:
        if not isinstance(self.body, BODIES):
            kinds = ", ".join(kind.__name__ for kind in BODIES)
            raise ConfigError(
                f"body is a {type(self.body).__name__}; use one of {kinds}, which can be meshed"
                " and have flat sides."
            )
        if not isinstance(self.youngs_mpa, Background):
            object.__setattr__(self, "youngs_mpa", positive("youngs_mpa", self.youngs_mpa))
        checked = tuple(self._inclusion(i, pair) for i, pair in enumerate(self.inclusions))
        object.__setattr__(self, "inclusions", checked)

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the body's bounding box, mm."""
        low, high = self.body.bounds()
        return float(np.linalg.norm(high - low))

    def youngs_at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points, MPa; points outside get that of the body.

        A point on the surface of an inclusion belongs to it.
        """
        if isinstance(self.youngs_mpa, Background):
            values = self.youngs_mpa.at(points).copy()
        else:
            values = np.full(len(points), float(self.youngs_mpa))
        for shape, youngs in self.inclusions:
            values[shape.contains(points)] = youngs
        return values

    def on_mesh(self, mesh: TetMesh, samples: int = 1) -> Float[np.ndarray, " m"]:
        """Return Young's modulus of each element, MPa.

        Args:
            mesh: A mesh of the body.
            samples: 1 takes the value at the centroid, so that every element has the modulus of
                one part. More take the mean over that many points along an edge, evenly spread
                in the element (see `sampling.lattice`): elements that an inclusion cuts get the
                volume average.

        Raises:
            MeshError: The mesh is not of this body.
            ConfigError: `samples` is below 1.
        """
        self.check_mesh(mesh)
        return element_means(mesh, self.youngs_at, samples)

    def mesh(
        self,
        edge_length_mm: Real | None = None,
        *,
        relative_edge_length: Real = 0.1,
        generator: str = "auto",
        conforming: bool = False,
        cache: bool = True,
    ) -> TetMesh:
        """Mesh the body.

        Args:
            edge_length_mm: Mean edge length to stay below (structured) or aim at (tetwild).
            relative_edge_length: The same as a share of the bounding box's diagonal, where
                `edge_length_mm` is not given; the paper's 10 % by default.
            generator: "structured" (boxes only; five tetrahedra per cell; the same every time),
                "tetwild" (`tetrahedralize`; any body), or "auto": structured where possible.
            conforming: Whether elements follow the surfaces of the inclusions, so that none is of
                two moduli; by tetwild. To invert on such a mesh leaks the truth.
            cache: Whether `tetrahedralize` looks up and stores its result.

        Raises:
            ConfigError: A setting cannot be used, or pytetwild is not installed.
            MeshError: Meshing failed.
        """
        inside = [shape for shape, _ in self.inclusions] if conforming else []
        return mesh_body(self.body, edge_length_mm, relative_edge_length, generator, cache, inside)

    def check_mesh(self, mesh: TetMesh) -> None:
        """Refuse a mesh whose bounding box is not that of the body.

        Raises:
            MeshError: It is not; the message gives both.
        """
        bounds = self.body.bounds()
        off = float(np.abs(mesh.bounds - bounds).max())
        if off > TOLERANCE * self.diagonal:
            raise MeshError(
                f"The mesh spans {_corners(mesh.bounds)} mm but the phantom's body"
                f" {_corners(bounds)} mm; mesh the phantom itself, or check position and units."
            )

    def to_config(self) -> dict[str, Any]:
        """Return a dictionary of plain values, from which `from_config` makes an equal phantom.

        Raises:
            ConfigError: A shape is of no kind that has a configuration.
        """
        inclusions = [
            {**shape_to_config(shape), "youngs_mpa": youngs} for shape, youngs in self.inclusions
        ]
        return {
            "body": shape_to_config(self.body),
            "youngs_mpa": background_to_config(self.youngs_mpa)
            if isinstance(self.youngs_mpa, Background)
            else self.youngs_mpa,
            "inclusions": inclusions,
        }

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> "Phantom":
        """Make a phantom from a dictionary such as `to_config` returns.

        Args:
            config: `body` (a shape: `shape` is one of `config.SHAPES`, beside its fields),
                `youngs_mpa` (a number, or a background: `field` is one of
                `background.BACKGROUNDS`, beside its fields), and `inclusions` (shapes, each with
                a `youngs_mpa`). Whatever is left out takes its default; `body` and an inclusion's
                `youngs_mpa` must be there.

        Raises:
            ConfigError: A key is missing or unknown, or a value cannot be used.
        """
        values = as_mapping(config, "phantom")
        refuse_unknown(values, {"body", "youngs_mpa", "inclusions"}, "phantom")
        if "body" not in values:
            raise ConfigError("phantom: body is missing; give its shape and size.")
        body = shape_from_config(values["body"], "phantom.body")
        given = values.get("youngs_mpa", cls.youngs_mpa)
        youngs: Real | Background
        if isinstance(given, Mapping):
            youngs = background_from_config(given, "phantom.youngs_mpa")
        else:
            youngs = _number(given, "phantom.youngs_mpa")
        entries = values.get("inclusions") or ()
        if isinstance(entries, Mapping | str) or not isinstance(entries, Sequence):
            raise ConfigError(f"phantom.inclusions is {entries!r}; give a list of shapes.")
        return cls(body, [_entry(entry, i) for i, entry in enumerate(entries)], youngs)

    def _inclusion(self, index: int, pair: tuple[Shape, Real]) -> Inclusion:
        shape, youngs = pair
        modulus = positive(f"inclusions[{index}].youngs_mpa", youngs)
        out = protrusion(shape, self.body)
        # Flush is fine: rounding must not refuse it.
        if out > 1e-9 * self.diagonal:
            raise ConfigError(
                f"inclusions[{index}] ({shape}) reaches {out:.4g} mm out of the body"
                f" ({self.body}); move or shrink it."
            )
        return Inclusion(shape, modulus)


def _entry(entry: Any, index: int) -> tuple[Shape, float]:
    where = f"phantom.inclusions[{index}]"
    values = as_mapping(entry, where)
    if "youngs_mpa" not in values:
        raise ConfigError(f"{where}: youngs_mpa is missing; give the inclusion's modulus in MPa.")
    youngs = _number(values.pop("youngs_mpa"), f"{where}.youngs_mpa")
    return shape_from_config(values, where), youngs


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigError(f"{where} is {value!r}; give a number in MPa.")
    return float(value)


def _corners(bounds: Float[np.ndarray, "2 3"]) -> str:
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in bounds)
    return f"({low}) to ({high})"
