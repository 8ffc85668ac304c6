"""Phantom: a body with inclusions of other Young's moduli."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.display import Displayed
from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import BodyFile, Box, Cylinder, Hemisphere, Hyperboloid, Lathe, Shape, TetMesh
from tactorch.mesh.geometry import bounding_diagonal
from tactorch.mesh.meshing import mesh_shape
from tactorch.mesh.quadrature import element_means, quadrature_means
from tactorch.mesh.values import Real, positive
from tactorch.phantoms.background import Background
from tactorch.phantoms.config import as_mapping, from_config, to_config
from tactorch.phantoms.object_mesh import follow_inclusions
from tactorch.phantoms.overlap import protrusion

#: Bodies: each can have a flat side for supports.
BODIES = (Box, Cylinder, Hemisphere, Hyperboloid, Lathe, BodyFile)
#: Young's modulus of a hole: the lower bound of the paper's inversions (Section IV-A), MPa.
HOLE_MPA = 1e-3
#: Maximum difference of a mesh's bounding box from the body's, as a fraction of its diagonal.
MAX_BOUNDS_DIFFERENCE = 5e-3


class Inclusion(NamedTuple):
    """Part of other stiffness: its shape and Young's modulus, MPa."""

    shape: Shape
    youngs_mpa: float


@dataclass(frozen=True, repr=False)
class Phantom(Displayed):
    """Soft body with inclusions.

    Attributes:
        body: Outer shape, one of `BODIES`: box, cylinder, hemisphere, hyperboloid, lathe
            or file; mm.
        inclusions: Pairs of a shape and its Young's modulus, MPa. Where inclusions overlap, the
            last one applies. They may touch the body's surface but not protrude from it.
        youngs_mpa: Young's modulus elsewhere, MPa; a number or a `Background`. A hole is an
            inclusion of negligible modulus, such as `HOLE_MPA`.
    """

    body: Shape
    inclusions: Sequence[tuple[Shape, Real]] = ()
    youngs_mpa: Real | Background = 0.2

    def __post_init__(self) -> None:
        if not isinstance(self.body, BODIES):
            names = ", ".join(cls.__name__ for cls in BODIES)
            raise ConfigError(
                f"body is a {type(self.body).__name__}; use one of {names}, which can be meshed"
                " and have flat sides."
            )
        if not isinstance(self.youngs_mpa, Background):
            object.__setattr__(self, "youngs_mpa", positive("youngs_mpa", self.youngs_mpa))
        inclusions = tuple(self._inclusion(i, *pair) for i, pair in enumerate(self.inclusions))
        object.__setattr__(self, "inclusions", inclusions)

    def summary(self) -> str:
        """Return a description of the phantom in a few lines of text."""
        youngs = self.youngs_mpa
        inside = _describe(youngs) if isinstance(youngs, Background) else f"{youngs:g} MPa"
        inclusions = (f"inclusion: {_describe(s)}, {value:g} MPa" for s, value in self.inclusions)
        return "\n".join([f"body: {_describe(self.body)}, Young's modulus {inside}", *inclusions])

    def youngs_at(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return Young's modulus at points (mm), MPa; outside the body, that of the background.

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
            mesh: Mesh of the body.
            samples: Number of sampling points along an edge of an element. With 1, elements have
                the modulus at their centroid; with more, the mean over a lattice (see
                `tactorch.mesh.quadrature.lattice`), so that elements cut by the surface of an
                inclusion have the volume average.
        """
        self._check_bounds(mesh)
        return element_means(mesh, self.youngs_at, samples)

    def at_quadrature(
        self, mesh: TetMesh, rule: Float[np.ndarray, "q 4"]
    ) -> Float[np.ndarray, "m q"]:
        """Return Young's modulus at the quadrature points of each element, MPa.

        It is the geometric mean over the part of the element nearest to the point, which represents
        boundaries that cross elements better than an arithmetic mean: that is too stiff.

        Args:
            mesh: Mesh of the body.
            rule: Barycentric coordinates of the quadrature points.
        """
        self._check_bounds(mesh)
        means = quadrature_means(mesh, lambda points: np.log(self.youngs_at(points)), rule)
        return np.asarray(np.exp(means))

    def _check_bounds(self, mesh: TetMesh) -> None:
        boxes = mesh.bounds, self.body.bounds()
        if np.abs(boxes[0] - boxes[1]).max() > MAX_BOUNDS_DIFFERENCE * bounding_diagonal(boxes[1]):
            span, wanted = (
                " to ".join(f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in box) for box in boxes
            )
            raise MeshError(
                f"The mesh spans {span} mm but the phantom's body {wanted} mm; mesh the"
                " phantom itself, or check position and units."
            )

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
            edge_length_mm: Upper limit (structured) or target (tetwild) of the mean edge length.
            relative_edge_length: The same as a fraction of the bounding box's diagonal, where
                `edge_length_mm` is not given; default: the paper's 10 %.
            generator: "structured" (boxes only; five tetrahedra per cell; reproducible),
                "tetwild" (`tetrahedralize`; any body), or "auto": structured where possible.
            conforming: Whether element faces conform to the surfaces of the inclusions; with
                tetwild only. An inversion on such a mesh has prior knowledge of the truth.
            cache: Whether `tetrahedralize` looks up and stores its result.
        """
        inner = [shape for shape, _ in self.inclusions] if conforming else []
        return mesh_shape(self.body, edge_length_mm, relative_edge_length, generator, inner, cache)

    def to_config(self) -> dict[str, Any]:
        """Return a dictionary of plain values, from which `from_config` makes an equal phantom."""
        youngs = self.youngs_mpa
        return {
            "body": to_config(self.body),
            "youngs_mpa": to_config(youngs) if isinstance(youngs, Background) else youngs,
            "inclusions": [{**to_config(s), "youngs_mpa": e} for s, e in self.inclusions],
        }

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> "Phantom":
        """Make a phantom from a dictionary such as `to_config` returns.

        Args:
            config: `body` (key `shape` and the fields of that shape), `youngs_mpa` (a number, or
                a background: key `field` and its fields), and `inclusions` (shapes, each with a
                `youngs_mpa`). Only `body` and the `youngs_mpa` of inclusions are required. See
                `tactorch.phantoms.config.CLASSES` for the names.
        """
        values = as_mapping(config, "phantom", {"body", "youngs_mpa", "inclusions"})
        if "body" not in values:
            raise ConfigError("phantom: body is missing; give its shape and size.")
        body = from_config("shape", values["body"], "phantom.body")
        youngs, where = values.get("youngs_mpa", cls.youngs_mpa), "phantom.youngs_mpa"
        is_field = isinstance(youngs, Mapping)
        youngs = from_config("field", youngs, where) if is_field else _number(youngs, where)
        entries = values.get("inclusions") or ()
        if isinstance(entries, Mapping | str) or not isinstance(entries, Sequence):
            raise ConfigError(f"phantom.inclusions is {entries!r}; give a list of shapes.")
        return cls(body, [_entry(entry, i) for i, entry in enumerate(entries)], youngs)

    def _inclusion(self, index: int, shape: Shape, youngs: Real) -> Inclusion:
        modulus = positive(f"inclusions[{index}].youngs_mpa", youngs)
        outside = protrusion(shape, self.body)
        if outside > 1e-9 * bounding_diagonal(self.body.bounds()):  # rounding of flush surfaces
            raise ConfigError(
                f"inclusions[{index}] ({shape}) protrudes {outside:.4g} mm out of the body"
                f" ({self.body}); move or shrink it."
            )
        return Inclusion(shape, modulus)


@dataclass(frozen=True)
class MeshSize(Options):
    """Edge lengths of the recording's mesh and of the mesh that presses are solved on."""

    section = "mesh"
    edge_length_mm: float | None = option(
        None, "Edge length of the recording's mesh; null: relative_edge_length", unit="mm", gt=0
    )
    relative_edge_length: float = option(
        0.1, "Edge length as a fraction of the bounding box's diagonal", gt=0
    )
    fine_edge_length_mm: float | None = option(
        None, "Edge length of the simulation's mesh; null: fine_relative", unit="mm", gt=0
    )
    fine_relative: float | None = option(
        0.06, "Edge length of the simulation's mesh as a fraction of the diagonal; null: the"
        " recording's mesh (an inverse crime)", gt=0,
    )  # fmt: skip
    fine_conforming: bool = option(
        True,
        "Whether faces of the simulation's mesh follow the surfaces of the inclusions, with"
        " shorter edges where these are small",
    )
    generator: Literal["auto", "structured", "tetwild"] = option(
        "auto", "Mesh generator; auto: structured for boxes, tetwild for other bodies"
    )

    def build(self, phantom: Phantom) -> tuple[TetMesh, TetMesh | None]:
        """Return the recording's mesh, and the mesh to solve on; None where it is the same."""
        mesh = partial(phantom.mesh, generator=self.generator)
        coarse = mesh(self.edge_length_mm, relative_edge_length=self.relative_edge_length)
        if self.fine_edge_length_mm is None and self.fine_relative is None:
            return coarse, None
        fine = mesh(self.fine_edge_length_mm, relative_edge_length=self.fine_relative or 0.1)
        shapes = [shape for shape, _ in phantom.inclusions] if self.fine_conforming else []
        return coarse, follow_inclusions(fine, shapes)


def _entry(entry: Any, index: int) -> tuple[Shape, float]:
    where = f"phantom.inclusions[{index}]"
    values = as_mapping(entry, where)
    if "youngs_mpa" not in values:
        raise ConfigError(f"{where}: youngs_mpa is missing; give the inclusion's modulus in MPa.")
    youngs = _number(values.pop("youngs_mpa"), f"{where}.youngs_mpa")
    return from_config("shape", values, where), youngs


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ConfigError(f"{where} is {value!r}; give a number in MPa.")
    return float(value)


def _describe(part: Shape | Background) -> str:
    """Return the type and the parameters of a part of a phantom."""
    return " ".join(_word(*item) for item in to_config(part).items())


def _word(key: str, value: Any) -> str:
    """Return a parameter of a part; the value alone of the type."""
    if isinstance(value, list) and all(isinstance(item, float) for item in value):
        value = f"({', '.join(f'{item:g}' for item in value)})"
    elif isinstance(value, float):
        value = f"{value:g}"
    return str(value) if key in ("shape", "field") else f"{key}={value}"
