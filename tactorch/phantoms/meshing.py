"""Meshes of a phantom's body."""

from collections.abc import Sequence

import numpy as np

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

#: Bodies: each can have a flat side to be held by.
BODIES = (Box, Cylinder, Hemisphere, Hyperboloid, Lathe)
GENERATORS = ("auto", "structured", "tetwild")
#: A structured grid of more cells is taken for a mistake in the edge length.
MAX_CELLS = 1_000_000
# Mean edge of a cube cut into five tetrahedra, per side of the cube: as many sides as diagonals.
_MEAN_EDGE = (1.0 + np.sqrt(2.0)) / 2.0


def mesh_body(
    body: Shape,
    edge_length_mm: Real | None,
    relative_edge_length: Real,
    generator: str,
    cache: bool,
    inside: Sequence[Shape] = (),
) -> TetMesh:
    """Mesh a body, along the surfaces of the shapes `inside` it; see `Phantom.mesh`."""
    if generator not in GENERATORS:
        raise ConfigError(f"generator={generator!r}: choose one of {', '.join(GENERATORS)}.")
    low, high = body.bounds()
    if edge_length_mm is None:
        relative = positive("relative_edge_length", relative_edge_length)
        length = relative * float(np.linalg.norm(high - low))
    else:
        length = positive("edge_length_mm", edge_length_mm)
    if generator == "structured" and inside:
        raise ConfigError("generator='structured' cannot follow inclusions; use 'tetwild'.")
    if generator == "structured" or (generator == "auto" and isinstance(body, Box) and not inside):
        return _structured(body, length)
    inner = [shape_surface(shape) for shape in inside]
    return tetrahedralize(*shape_surface(body), length, inner=inner, cache=cache)


def _structured(body: Shape, length: float) -> TetMesh:
    if not isinstance(body, Box):
        raise ConfigError(
            f"generator='structured' meshes boxes only, not a {type(body).__name__};"
            " use 'tetwild' or 'auto'."
        )
    # Less a hair, so that rounding does not add a layer of cells.
    counts = np.ceil(np.array(body.size_mm) * _MEAN_EDGE / length - 1e-9).clip(1).astype(int)
    if np.prod(counts.astype(float)) > MAX_CELLS:
        raise ConfigError(
            f"An edge length of {length:.4g} mm would take {np.prod(counts.astype(float)):.2g}"
            f" cells (limit {MAX_CELLS:.0e}); choose a larger one, and check the units."
        )
    return box_mesh(body.size_mm, counts, center_mm=body.center_mm, tets_per_cell=5)
