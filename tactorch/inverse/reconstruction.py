"""The result of an inversion: a map of Young's modulus with its history, and its files."""

from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from tactorch.display import Displayed
from tactorch.errors import MeshError
from tactorch.hdf5 import (
    Hdf5Reader,
    open_hdf5,
    write_array,
    write_attributes,
    write_hdf5,
    write_json,
)
from tactorch.inverse.nuisance import NuisanceEstimate
from tactorch.mesh import TetMesh, write_mesh

if TYPE_CHECKING:
    import h5py

    from tactorch.inverse.shapes import ShapeReconstruction
    from tactorch.recording import Recording

_FORMAT, _VERSION = "tactorch-reconstruction", 1
_REMEDY = "give the reconstruction.h5 of a run folder."
_MAX_AT_BOUNDS = 0.2  # fraction of the volume at the bounds in a map that can be trusted


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Displayed):
    """A map of Young's modulus.

    On disk (HDF5): attributes `format`, `version`, `stop_reason` and `seconds`; datasets
    `mesh/points` (mm), `mesh/tets`, `youngs` (MPa), `displacements` (presses, n, 3; mm), `config`
    (JSON), `history` (JSON, a list of records), `nuisance` (JSON, by name) and `predicted`.

    Attributes:
        mesh: The object.
        youngs: Young's modulus of each element, MPa.
        displacements: Predicted displacement of each press at the map, mm; none of a palpation.
        history: One record per iteration; see `tactorch.inverse.Monitor`.
        stop_reason: Reason for the end of the optimization: a `StopReason` or its text.
        seconds: Elapsed time, including earlier runs of a resumed inversion, s.
        config: Settings, versions and provenance, as plain JSON values.
        nuisance: Estimates of the nuisance parameters by name.
        predicted: Predicted data of all presses (mm, N, N mm), those of each in the order of its
            `tactorch.inverse.data.Observation`; None in files of earlier versions.
    """

    mesh: TetMesh
    youngs: Float[np.ndarray, " m"]
    displacements: Float[np.ndarray, "presses n 3"]
    history: list[dict[str, Any]]
    stop_reason: str
    seconds: float
    config: dict[str, Any] = field(default_factory=dict)
    nuisance: dict[str, NuisanceEstimate] = field(default_factory=dict)
    predicted: Float[np.ndarray, " data"] | None = None

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return int(self.history[-1]["iteration"]) if self.history else 0

    @property
    def misfit_mm2(self) -> float:
        """Half the sum of squared displacement differences (eq. 7), mm^2."""
        return float(self.history[-1]["misfit"]) if self.history else float("nan")

    @property
    def volume_at_bounds(self) -> float:
        """Fraction of the volume within 1 % of a bound; NaN without stored bounds."""
        try:
            bounds = self.config["settings"]["bounds"]
            low, high = 1.01 * float(bounds["lower"]), 0.99 * float(bounds["upper"])
        except (KeyError, TypeError, ValueError):
            return float("nan")
        volumes = self.mesh.volumes
        return float(volumes[(self.youngs < low) | (self.youngs > high)].sum() / volumes.sum())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons not to trust the map at all, as sentences about it; usually none."""
        at_bounds = self.volume_at_bounds
        if not at_bounds > _MAX_AT_BOUNDS:
            return ()
        warning = (
            f"{at_bounds:.0%} of the map is at a bound of Young's modulus. If the bounds are "
            "right, presses or model are off by more than the noise that is stated: give noise.mm "
            "larger, or estimate what is wrong (nuisance)."
        )
        return (warning,)

    def summary(self) -> str:
        """Return a description of the result in a few lines of text."""
        low, middle, high = np.quantile(self.youngs, [0.0, 0.5, 1.0])
        chi2 = f", chi2 {self.history[-1]['chi2']:.3g}" if self.history else ""
        lines = [
            f"Young's modulus: {low:.3g} to {high:.3g} MPa, median {middle:.3g} MPa",
            f"object: {self.mesh.n_points} nodes, {self.mesh.n_tets} tetrahedra",
            f"{self.iterations} iterations in {self.seconds:.1f} s{chi2}: {self.stop_reason}",
            *(f"{name}: {estimate.text()}" for name, estimate in self.nuisance.items()),
            *(f"warning: {warning}" for warning in self.warnings),
        ]
        return "\n".join(lines)

    def report(
        self,
        path: str | Path,
        recording: "Recording | None" = None,
        *,
        shapes: "ShapeReconstruction | None" = None,
        **options: Any,
    ) -> Path:
        """Write the report of `tactorch report`, a self-contained HTML file; return its path.

        Args:
            path: Path of the file.
            recording: Presses of the inversion. Without them the report has only the map.
            shapes: Result of `find_shapes` for them.
            options: Options of `tactorch.report.write_report`.
        """
        # The report is above its objects.
        written: Path = import_module("tactorch.report").report_of(
            self, path, recording, shapes, **options
        )
        return written

    def save(self, path: str | Path) -> Path:
        """Write to HDF5 atomically."""
        write_hdf5(path, self._write)
        return Path(path)

    def _write(self, file: "h5py.File") -> None:
        write_attributes(file, format=_FORMAT, version=_VERSION)
        write_attributes(file, stop_reason=self.stop_reason, seconds=float(self.seconds))
        write_json(file, "config", self.config)
        write_json(file, "history", self.history)
        estimates = {name: estimate.plain() for name, estimate in self.nuisance.items()}
        write_json(file, "nuisance", estimates)
        write_array(file, "mesh/points", self.mesh.points)
        write_array(file, "mesh/tets", self.mesh.tets)
        if self.mesh.regions is not None:
            write_array(file, "mesh/regions", self.mesh.regions)
        write_array(file, "youngs", self.youngs)
        write_array(file, "displacements", self.displacements)
        if self.predicted is not None:
            write_array(file, "predicted", self.predicted)

    @staticmethod
    def load(path: str | Path) -> "Reconstruction":
        """Read from HDF5."""
        with open_hdf5(path, "reconstruction", _REMEDY) as file:
            reader = Hdf5Reader(file, path, "reconstruction", "Reconstruction.save")
            reader.check_format(_FORMAT, _VERSION, _REMEDY)
            points = reader.array("mesh/points", "f", (None, 3))
            tets = reader.array("mesh/tets", "i", (None, 4))
            has_regions = reader.has("mesh/regions")
            regions = reader.array("mesh/regions", "i", (len(tets),)) if has_regions else None
            try:
                mesh = TetMesh.create(points, tets, regions=regions)
            except MeshError as error:
                raise reader.error(f"has no valid mesh: {error}") from error
            moved = (None, mesh.n_points, 3)
            estimates = reader.json("nuisance") if reader.has("nuisance") else {}
            return Reconstruction(
                mesh=mesh,
                youngs=reader.array("youngs", "f", (mesh.n_tets,)),
                displacements=reader.array("displacements", "f", moved),
                history=reader.json("history", list),
                stop_reason=reader.attribute("/", "stop_reason", str),
                seconds=reader.attribute("/", "seconds", float),
                config=reader.json("config"),
                nuisance={n: NuisanceEstimate.of(plain) for n, plain in estimates.items()},
                predicted=reader.array("predicted", "f", (None,))
                if reader.has("predicted")
                else None,
            )

    def write_vtu(self, path: str | Path, truth: Float[np.ndarray, " m"] | None = None) -> Path:
        """Write the map (and the truth) for ParaView and the like."""
        cells = {"youngs_mpa": self.youngs}
        if truth is not None:
            cells["youngs_true_mpa"] = truth
        points = {f"displacement_{i}_mm": u for i, u in enumerate(self.displacements)}
        write_mesh(path, self.mesh, cell_data=cells, point_data=points)
        return Path(path)
