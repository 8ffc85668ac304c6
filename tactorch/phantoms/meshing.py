"""Meshes of a phantom's body."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh import (
    Box,
    Cylinder,
    Hemisphere,
    Hyperboloid,
    Lathe,
    Shape,
    TetMesh,
    box_mesh,
    shape_surface,
    tetrahedralize,
)
from tactorch.mesh.values import Real, positive

if TYPE_CHECKING:
    from tactorch.phantoms.phantom import Phantom

#: Bodies: each can have a flat side for supports.
BODIES = (Box, Cylinder, Hemisphere, Hyperboloid, Lathe)
GENERATORS = ("auto", "structured", "tetwild")
#: A larger number of cells of a structured mesh indicates a mistake in the edge length.
MAX_CELLS = 1_000_000
# Mean edge of a cube divided into five tetrahedra, per side: as many sides as diagonals.
_MEAN_EDGE = (1.0 + np.sqrt(2.0)) / 2.0


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
        0.05,
        "Edge length of the simulation's mesh as a fraction of the diagonal; null: the recording's "
        "mesh (an inverse crime)",
        gt=0,
    )
    generator: Literal["auto", "structured", "tetwild"] = option(
        "auto", "Mesh generator; auto: structured for boxes, tetwild for other bodies"
    )

    def build(self, phantom: "Phantom") -> tuple[TetMesh, TetMesh | None]:
        """Mesh a phantom.

        Returns:
            The recording's mesh, and the mesh to solve on; None where it is the same.

        Raises:
            ConfigError: The generator cannot mesh the body, or pytetwild is not installed.
            MeshError: Meshing failed.
        """

        def mesh(edge_mm: float | None, relative: float) -> TetMesh:
            return phantom.mesh(edge_mm, relative_edge_length=relative, generator=self.generator)

        coarse = mesh(self.edge_length_mm, self.relative_edge_length)
        if self.fine_edge_length_mm is None and self.fine_relative is None:
            return coarse, None
        return coarse, mesh(self.fine_edge_length_mm, self.fine_relative or 0.1)


def mesh_body(
    body: Shape,
    edge_length_mm: Real | None,
    relative_edge_length: Real,
    generator: str,
    cache: bool,
    inner: Sequence[Shape] = (),
) -> TetMesh:
    """Mesh a body, conforming to the surfaces of `inner` shapes; see `Phantom.mesh`."""
    if generator not in GENERATORS:
        raise ConfigError(f"generator={generator!r}: choose one of {', '.join(GENERATORS)}.")
    if edge_length_mm is None:
        low, high = body.bounds()
        relative = positive("relative_edge_length", relative_edge_length)
        length = relative * float(np.linalg.norm(high - low))
    else:
        length = positive("edge_length_mm", edge_length_mm)
    if generator == "structured" and inner:
        raise ConfigError("generator='structured' cannot follow inclusions; use 'tetwild'.")
    if generator == "structured" or (generator == "auto" and isinstance(body, Box) and not inner):
        return _structured(body, length)
    surfaces = [shape_surface(shape) for shape in inner]
    return tetrahedralize(*shape_surface(body), length, inner=surfaces, cache=cache)


def _structured(body: Shape, length: float) -> TetMesh:
    if not isinstance(body, Box):
        raise ConfigError(
            f"generator='structured' meshes boxes only, not a {type(body).__name__};"
            " use 'tetwild' or 'auto'."
        )
    # The subtraction keeps rounding from adding a layer of cells.
    counts = np.ceil(np.array(body.size_mm) * _MEAN_EDGE / length - 1e-9).clip(1).astype(int)
    cells = float(np.prod(counts.astype(float)))
    if cells > MAX_CELLS:
        raise ConfigError(
            f"An edge length of {length:.4g} mm would take {cells:.2g} cells"
            f" (limit {MAX_CELLS:.0e}); choose a larger one, and check the units."
        )
    return box_mesh(body.size_mm, counts, center_mm=body.center_mm, tets_per_cell=5)
