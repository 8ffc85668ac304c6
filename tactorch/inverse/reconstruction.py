"""The result of an inversion: a map of Young's modulus, how it was reached, and its files."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import FileError, MeshError
from tactorch.files import atomic_path, require_file
from tactorch.inverse.nuisance_estimate import NuisanceEstimate
from tactorch.mesh import TetMesh, write_mesh

_FORMAT, _VERSION = "tactorch-reconstruction", 1


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A map of Young's modulus.

    On disk (HDF5): attributes `format`, `version`, `stop_reason` and `seconds`; datasets
    `mesh/points` (mm), `mesh/tets`, `youngs` (MPa), `displacements` (presses, n, 3; mm), `config`
    (JSON), `history` (JSON, a list of records) and `nuisance` (JSON, by name).

    Attributes:
        mesh: The object.
        youngs: Young's modulus of each element, MPa.
        displacements: Predicted displacement of each press at the map, mm.
        history: One record an iteration; see `tactorch.inverse.Monitor`.
        stop_reason: Why the optimizer stopped.
        seconds: Time it took, resumed runs included.
        config: Settings, versions and provenance, as plain JSON values.
        nuisance: Estimates of the nuisance parameters that were free, by name.
    """

    mesh: TetMesh
    youngs: Float[np.ndarray, " m"]
    displacements: Float[np.ndarray, "presses n 3"]
    history: list[dict[str, Any]]
    stop_reason: str
    seconds: float
    config: dict[str, Any] = field(default_factory=dict)
    nuisance: dict[str, NuisanceEstimate] = field(default_factory=dict)

    @property
    def iterations(self) -> int:
        """Iterations that the optimizer made."""
        return int(self.history[-1]["iteration"]) if self.history else 0

    @property
    def misfit_mm2(self) -> float:
        """Half the sum of squared displacement differences (eq. 7), mm^2."""
        return float(self.history[-1]["misfit"]) if self.history else float("nan")

    def save(self, path: str | Path) -> Path:
        """Write to HDF5, whole or not at all."""
        import h5py

        with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
            file.attrs["format"], file.attrs["version"] = _FORMAT, _VERSION
            file.attrs["stop_reason"], file.attrs["seconds"] = self.stop_reason, self.seconds
            file.create_dataset("config", data=json.dumps(self.config))
            file.create_dataset("history", data=json.dumps(self.history))
            free = {name: estimate.plain() for name, estimate in self.nuisance.items()}
            file.create_dataset("nuisance", data=json.dumps(free))
            for name, values in self._datasets().items():
                file.create_dataset(name, data=values, compression="gzip", shuffle=True)
        return Path(path)

    def _datasets(self) -> dict[str, np.ndarray]:
        return {
            "mesh/points": self.mesh.points,
            "mesh/tets": self.mesh.tets,
            "youngs": self.youngs,
            "displacements": self.displacements,
        }

    @staticmethod
    def load(path: str | Path) -> "Reconstruction":
        """Read from HDF5.

        Raises:
            FileError: the file is missing, truncated, or not a reconstruction.
        """
        import h5py

        source = require_file(path, "reconstruction")
        try:
            with h5py.File(source, "r") as file:
                _check_format(dict(file.attrs), source)
                found = Reconstruction(
                    mesh=TetMesh.create(file["mesh/points"][()], file["mesh/tets"][()]),
                    youngs=file["youngs"][()],
                    displacements=file["displacements"][()],
                    history=json.loads(file["history"][()]),
                    stop_reason=str(file.attrs["stop_reason"]),
                    seconds=float(file.attrs["seconds"]),
                    config=json.loads(file["config"][()]),
                    nuisance=_nuisance(file["nuisance"][()] if "nuisance" in file else "{}"),
                )
            found._check_shapes()
        except (OSError, KeyError, ValueError, TypeError, RuntimeError, MeshError) as error:
            raise FileError(
                f"reconstruction '{source}' cannot be read ({error}); it is truncated or of "
                "another kind. Run the inversion again."
            ) from error
        return found

    def _check_shapes(self) -> None:
        n, m, moved = self.mesh.n_points, self.mesh.n_tets, self.displacements.shape
        if self.youngs.shape != (m,) or len(moved) != 3 or moved[1:] != (n, 3):
            raise ValueError(
                f"youngs {self.youngs.shape} and displacements {moved} do not fit a mesh of {n} "
                f"points and {m} tetrahedra"
            )

    def write_vtu(self, path: str | Path, truth: Float[np.ndarray, " m"] | None = None) -> Path:
        """Write the map (and the truth) for ParaView and the like."""
        cells = {"youngs_mpa": self.youngs}
        if truth is not None:
            cells["youngs_true_mpa"] = truth
        points = {f"displacement_{i}_mm": u for i, u in enumerate(self.displacements)}
        write_mesh(path, self.mesh, cell_data=cells, point_data=points)
        return Path(path)


def _nuisance(text: str | bytes) -> dict[str, NuisanceEstimate]:
    """Files of earlier versions have none."""
    return {name: NuisanceEstimate.of(plain) for name, plain in json.loads(text).items()}


def _check_format(attributes: dict[str, Any], source: Path) -> None:
    found, version = attributes.get("format"), attributes.get("version", 0)
    found = found.decode() if isinstance(found, bytes) else found
    if found != _FORMAT:
        raise FileError(
            f"'{source}' is not a reconstruction but {found or 'some other HDF5 file'}; give the "
            "reconstruction.h5 of a run folder."
        )
    if version > _VERSION:
        raise FileError(
            f"reconstruction '{source}' has version {version}; this tactorch reads up to "
            f"{_VERSION}. Upgrade tactorch."
        )
