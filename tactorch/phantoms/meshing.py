"""Meshes of a phantom's body."""

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh import (
    Box,
    Cylinder,
    Shape,
    TetMesh,
    box_mesh,
    box_surface,
    cylinder_surface,
    tetrahedralize,
)
from tactorch.mesh.values import Real, positive

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
) -> TetMesh:
    """Mesh a body; see `Phantom.mesh`."""
    if generator not in GENERATORS:
        raise ConfigError(f"generator={generator!r}: choose one of {', '.join(GENERATORS)}.")
    low, high = body.bounds()
    if edge_length_mm is None:
        relative = positive("relative_edge_length", relative_edge_length)
        length = relative * float(np.linalg.norm(high - low))
    else:
        length = positive("edge_length_mm", edge_length_mm)
    if generator == "structured" or (generator == "auto" and isinstance(body, Box)):
        return _structured(body, length)
    vertices, triangles = _surface(body)
    return tetrahedralize(vertices, triangles, length, cache=cache)


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


def _surface(body: Shape) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(body, Box):
        return box_surface(body.size_mm, body.center_mm)
    if isinstance(body, Cylinder):
        return cylinder_surface(body.radius_mm, body.height_mm, body.center_mm, body.axis)
    raise ConfigError(f"A {type(body).__name__} cannot be meshed as a body; use a Box or Cylinder.")
