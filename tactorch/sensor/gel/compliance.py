"""Compliance of a gel's outer face at rest, computed once for a mesh and stored on disk.

It is proportional to the reciprocal of Young's modulus; the stored one is that of 1 MPa.
"""

import logging
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import FileError
from tactorch.files import cache_folder, read_arrays, write_arrays
from tactorch.sensor.gel.model import GelModel

_log = logging.getLogger(__name__)
_MAX_NODES = 2500  # of the face; the compliance of more has over 450 MB
_NODES_AT_ONCE = 20
_VERSION = "1"  # changes with the definition of the stored compliance

Report = Callable[[int, int], object]
Compliance = Float[np.ndarray, "k3 k3"]


def face_compliance(
    model: GelModel, report: Report = lambda done, total: None
) -> Compliance | None:
    """Return the displacements (mm) of the nodes of the face by unit forces (N) on them, at rest.

    It is read from the cache (`tactorch.files.cache_folder`) if a gel of the same mesh and material
    was used before. `report` receives the nodes done and their number while it is computed.

    Returns:
        Symmetric matrix, (3k, 3k), mm/N; None if the face has too many nodes to store it.
    """
    count = len(model.points)
    if count > _MAX_NODES:
        return None
    path = cache_folder() / "gels" / f"{_key(model)}.npz"
    youngs_mpa = float(model.gel.youngs_mpa)
    if (stored := _read(path, 3 * count)) is not None:
        return stored / youngs_mpa
    _log.info("The compliance of the gel's face is computed once for this mesh (%d nodes).", count)
    compliance = np.empty((3 * count, 3 * count))
    for begin in range(0, count, _NODES_AT_ONCE):
        end = min(begin + _NODES_AT_ONCE, count)
        selected: Bool[np.ndarray, " k"] = np.zeros(count, dtype=bool)
        selected[begin:end] = True
        compliance[:, 3 * begin : 3 * end] = model.rest_compliance(selected)
        report(end, count)
    unit = 0.5 * youngs_mpa * (compliance + compliance.T)
    try:
        write_arrays(path, {"compliance": unit})
    except FileError as error:
        _log.warning("The compliance could not be stored: %s", error)
    return unit / youngs_mpa


def _key(model: GelModel) -> str:
    """Hash of what the compliance depends on."""
    mesh, gel = model.gel_mesh, model.gel
    element = type(model.body.discretisation.element).__name__
    element += f" {model.body.discretisation.nodes.shape[1]}"
    digest = sha256(f"{_VERSION} {gel.material} {float(gel.poisson)!r} {element}".encode())
    for array in (mesh.mesh.points, mesh.mesh.tets, mesh.face, mesh.window):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _read(path: Path, size: int) -> Compliance | None:
    """Read a stored compliance; None if there is none, or it is damaged."""
    if not path.is_file():
        return None
    try:
        compliance = read_arrays(path, "Stored compliance", "it is computed again.")["compliance"]
    except (FileError, KeyError) as error:
        _log.warning("Ignoring the damaged compliance '%s': %s", path, error)
        return None
    valid = compliance.shape == (size, size) and bool(np.isfinite(compliance).all())
    return compliance if valid else None
