"""Validation of the fields that metrics compare."""

import numpy as np
from jaxtyping import Float

from tactorch.errors import MeshError
from tactorch.mesh import TetMesh


def check_field(name: str, values: Float[np.ndarray, " m"]) -> None:
    """Raise MeshError unless `values` are finite, above zero, and at least one."""
    if values.ndim != 1 or not len(values):
        raise MeshError(f"{name} has shape {values.shape}; give one modulus per element")
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if len(bad):
        raise MeshError(
            f"{name} is {values[bad[0]]} at element {bad[0]} ({len(bad)} such elements); "
            "give finite moduli above 0 MPa"
        )


def check_pair(youngs: Float[np.ndarray, " m"], truth: Float[np.ndarray, " m"]) -> None:
    """Raise MeshError unless the two fields are valid and of equal length."""
    check_field("youngs", youngs)
    check_field("truth", truth)
    if len(youngs) != len(truth):
        raise MeshError(
            f"youngs has {len(youngs)} values and truth {len(truth)}; compare fields of one mesh"
        )


def check_on_mesh(mesh: TetMesh, name: str, values: Float[np.ndarray, " m"]) -> None:
    """Raise MeshError unless `values` is a valid field over the elements of `mesh`."""
    check_field(name, values)
    if len(values) != mesh.n_tets:
        raise MeshError(
            f"{name} has {len(values)} values but the mesh {mesh.n_tets} elements; "
            "use the mesh that the field belongs to"
        )
