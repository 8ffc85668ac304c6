"""The result of an inversion: a field of Young's modulus with its lumps, and its files."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from tactorch.display import Displayed, view
from tactorch.errors import ConfigError, MeshError
from tactorch.hdf5 import (
    Hdf5Reader,
    open_hdf5,
    write_array,
    write_attributes,
    write_hdf5,
    write_json,
)
from tactorch.inverse.data.nuisance import NuisanceEstimate
from tactorch.inverse.data.plain import to_plain, with_arrays
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.result.lump import Lump
from tactorch.inverse.result.regions import build_lump, find_lumps
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.mesh import TetMesh, locate, write_mesh
from tactorch.metrics.coverage import normal_quantile

if TYPE_CHECKING:
    import h5py

    from tactorch.recording import Recording

_FORMAT, _VERSION = "tactorch-reconstruction", 2
_REMEDY = "give the reconstruction.h5 of a run folder."
#: Probability of all intervals that are reported.
LEVEL = 0.9
_Field = Float[np.ndarray, " m"]


class Status(StrEnum):
    """What an inversion says about lumps."""

    FOUND = "found"
    NOTHING = "nothing found"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Displayed):
    """The field of Young's modulus inside an object, in the description that the presses support.

    The description is inclusions in a background (`shapes`), or one modulus per element, an
    *element map*. Everything else in the result is of that description: moduli, lumps, predictions
    and residuals. Where both were computed, the other one is `other`.

    On disk (HDF5): attributes `format`, `version`, `stop_reason` and `seconds`; datasets
    `mesh/points` (mm), `mesh/tets`, `youngs` (MPa), `displacements` (presses, n, 3; mm),
    `predicted`, `residuals` and `log_deviation`; as JSON `config`, `history`, `nuisance`, `finding`
    (lumps, background, probability, reasons and warnings) and `shapes`; and the same of the other
    description in the group `other`.

    Attributes:
        mesh: The object.
        youngs: Young's modulus of each element, averaged over its volume, MPa.
        displacements: Predicted displacement of each press, mm; none of a palpation.
        history: One record per iteration or accepted model, with `iteration`, `chi2`, `seconds`
            and, of an element map, those of `tactorch.inverse.Monitor`.
        stop_reason: Reason for the end: a `StopReason` or its text.
        seconds: Elapsed time, including earlier runs of a resumed inversion, s.
        config: Settings, versions and provenance, as plain JSON values.
        nuisance: Estimates of the nuisance parameters by name.
        predicted: Predicted data of all presses (mm, N, N mm), those of each in the order of its
            `tactorch.inverse.data.observations.Observation`; None in files of earlier versions.
        residuals: Predicted less observed data, in standard deviations; None likewise.
        lumps: Lumps, the most probable or conspicuous first; none unless the status is `FOUND`.
        background_mpa: Young's modulus of the background, MPa.
        probability: Probability that there is any lump; None where it was not computed.
        reasons: Reasons for which the result is not to be trusted, as sentences; usually none.
        warnings: Errors of the recording that the presses show, and what could not be computed.
        shapes: The inclusions and their posterior; None for an element map.
        other: The other description of the same presses, where it was computed.
        log_deviation: Standard deviation of log E of each element of an element map; None where
            its posterior was not computed, and for inclusions.
    """

    mesh: TetMesh
    youngs: _Field
    displacements: Float[np.ndarray, "presses n 3"]
    history: list[dict[str, Any]]
    stop_reason: str
    seconds: float
    config: dict[str, Any] = field(default_factory=dict)
    nuisance: dict[str, NuisanceEstimate] = field(default_factory=dict)
    predicted: Float[np.ndarray, " data"] | None = None
    residuals: Float[np.ndarray, " data"] | None = None
    lumps: tuple[Lump, ...] = ()
    background_mpa: float = float("nan")
    probability: float | None = None
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    shapes: ShapeReconstruction | None = None
    other: "Reconstruction | None" = None
    log_deviation: _Field | None = None

    @property
    def name(self) -> str:
        """Name of the description."""
        return "element map" if self.shapes is None else "inclusions"

    @property
    def element_map(self) -> "Reconstruction | None":
        """The element map of the same presses: this result, the other description, or None."""
        return self if self.shapes is None else self.other

    @property
    def status(self) -> Status:
        """Whether lumps were found, nothing was found, or the presses cannot tell."""
        if self.reasons:
            return Status.UNKNOWN
        return Status.FOUND if self.lumps else Status.NOTHING

    @property
    def iterations(self) -> int:
        """Number of iterations, or of accepted models."""
        return int(self.history[-1]["iteration"]) if self.history else 0

    @property
    def chi2(self) -> float:
        """Mean squared residual, in standard deviations; 1 where the data are fitted to noise."""
        return float(self.history[-1]["chi2"]) if self.history else float("nan")

    @property
    def weight(self) -> float:
        """Weight of the prior at the end of the iteration of an element map."""
        return float(self.history[-1].get("weight", 0.0)) if self.history else 0.0

    @property
    def misfit_mm2(self) -> float:
        """Half the sum of squared displacement differences (eq. 7), mm^2."""
        return float(self.history[-1].get("misfit", np.nan)) if self.history else float("nan")

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

    def youngs_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return Young's modulus at points (mm), MPa; sharp at the boundaries of inclusions.

        Raises:
            ConfigError: a point is outside the mesh of an element map.
        """
        if self.shapes is not None:
            return self.shapes.youngs_at(points)
        return self.youngs[self._elements_at(points)]

    def log_deviation_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the standard deviation of log E at points (mm).

        Raises:
            ConfigError: the posterior of an element map was not computed, see `with_posterior`.
        """
        if self.shapes is not None:
            return self.shapes.log_deviation_at(points)
        if self.log_deviation is None:
            raise ConfigError(
                "the posterior of the element map was not computed; use "
                "result.with_posterior(recording, compute_posterior(recording, result))."
            )
        return self.log_deviation[self._elements_at(points)]

    def intervals(self) -> tuple[_Field, _Field] | None:
        """Return the ends of the central 90 % interval of each element's modulus, MPa.

        None for an element map whose posterior was not computed.
        """
        if self.shapes is not None:
            low, high = self.shapes.element_intervals(self.mesh, LEVEL)
            return low, high
        if self.log_deviation is None:
            return None
        half = np.exp(_HALF_WIDTH * self.log_deviation)
        return self.youngs / half, self.youngs * half

    def _elements_at(self, points: Float[np.ndarray, "n 3"]) -> np.ndarray:
        elements = locate(self.mesh, points)
        if (elements < 0).any():
            first = points[np.argmin(elements)]
            raise ConfigError(f"the point {np.round(first, 3).tolist()} mm is outside the object.")
        return elements

    def with_posterior(
        self, recording: "Recording", posterior: GaussianPosterior
    ) -> "Reconstruction":
        """Return an element map with the deviation of each element, and intervals of its lumps.

        Args:
            recording: The presses.
            posterior: Posterior of the map, of `tactorch.inverse.compute_posterior`.
        """
        lumps = tuple(
            build_lump(self.mesh, recording.presses, lump.inclusion, posterior)
            for lump in self.lumps
        )
        half = posterior.interval(LEVEL)
        deviation = 0.5 * np.log(half[1] / half[0]) / _HALF_WIDTH
        return replace(self, lumps=lumps, log_deviation=deviation)

    def with_warning(self, warning: str) -> "Reconstruction":
        """Return the result with a further warning, the first one."""
        return replace(self, warnings=(warning, *self.warnings))

    def plain(self) -> dict[str, Any]:
        """Return the finding as plain values: mm, MPa, mm^3."""
        return {
            "description": self.name,
            "status": str(self.status),
            "reasons": list(self.reasons),
            "warnings": list(self.warnings),
            "probability": self.probability,
            "background_mpa": self.background_mpa,
            "background_90_mpa": list(self.shapes.background_90_mpa) if self.shapes else None,
            "lumps": [lump.plain() for lump in self.lumps],
            "steps": [step._asdict() for step in self.shapes.steps] if self.shapes else [],
            "alternatives": [a.plain() for a in self.shapes.alternatives] if self.shapes else [],
        }

    def summary(self) -> str:
        """Return a description of the result in a few lines of text."""
        return view("summarize", self)

    def report(
        self, path: str | Path, recording: "Recording | None" = None, **options: Any
    ) -> Path:
        """Write the report of `tactorch report`, a self-contained HTML file; return its path.

        Args:
            path: Path of the file.
            recording: Presses of the inversion. Without them the report has only the field.
            options: Options of `tactorch.report.write_report`.
        """
        return view("report_of", self, path, recording, **options)

    def save(self, path: str | Path) -> Path:
        """Write to HDF5 atomically."""
        write_hdf5(path, self._write)
        return Path(path)

    def _write(self, file: "h5py.File") -> None:
        write_array(file, "mesh/points", self.mesh.points)
        write_array(file, "mesh/tets", self.mesh.tets)
        if self.mesh.regions is not None:
            write_array(file, "mesh/regions", self.mesh.regions)
        self._write_description(file)
        if self.other is not None:
            self.other._write_description(file.create_group("other"))

    def _write_description(self, group: "h5py.Group") -> None:
        write_attributes(group, format=_FORMAT, version=_VERSION)
        write_attributes(group, stop_reason=self.stop_reason, seconds=float(self.seconds))
        write_json(group, "config", self.config)
        write_json(group, "history", self.history)
        write_json(group, "nuisance", to_plain(self.nuisance))
        for name in ("youngs", "displacements", "predicted", "residuals", "log_deviation"):
            if (values := getattr(self, name)) is not None:
                write_array(group, name, values)
        finding = {name: getattr(self, name) for name in _FINDING}
        write_json(group, "finding", finding | {"lumps": [lump.stored() for lump in self.lumps]})
        if self.shapes is not None:
            write_json(group, "shapes", self.shapes.plain())

    @staticmethod
    def load(path: str | Path) -> "Reconstruction":
        """Read from HDF5, also files of earlier versions, whose description is an element map."""
        with open_hdf5(path, "reconstruction", _REMEDY) as file:
            reader = Hdf5Reader(file, path, "reconstruction", "Reconstruction.save")
            version = reader.check_format(_FORMAT, _VERSION, _REMEDY)
            points = reader.array("mesh/points", "f", (None, 3))
            tets = reader.array("mesh/tets", "i", (None, 4))
            has_regions = reader.has("mesh/regions")
            regions = reader.array("mesh/regions", "i", (len(tets),)) if has_regions else None
            try:
                mesh = TetMesh.create(points, tets, regions=regions)
            except MeshError as error:
                raise reader.error(f"has no valid mesh: {error}") from error
            result = _read_description(reader, mesh, version)
            if reader.has("other"):
                inner = Hdf5Reader(reader.group("other"), path, "reconstruction", "save")
                result = replace(result, other=_read_description(inner, mesh, version))
            return result

    def write_vtu(self, path: str | Path, truth: _Field | None = None) -> Path:
        """Write the field for ParaView and the like.

        Fields of the elements are `youngs_mpa`, the ends of its 90 % interval, whether the result
        is `trusted`, `youngs_element_map_mpa` where an element map was computed beside inclusions,
        and `youngs_true_mpa`.
        """
        trusted = np.full(len(self.youngs), float(not self.reasons))
        cells = {"youngs_mpa": self.youngs, "trusted": trusted}
        if (ends := self.intervals()) is not None:
            cells["youngs_90_low_mpa"], cells["youngs_90_high_mpa"] = ends
        if self.shapes is not None and self.other is not None:
            cells["youngs_element_map_mpa"] = self.other.youngs
        if truth is not None:
            cells["youngs_true_mpa"] = truth
        points = {f"displacement_{i}_mm": u for i, u in enumerate(self.displacements)}
        write_mesh(path, self.mesh, cell_data=cells, point_data=points)
        return Path(path)


_FINDING = ("background_mpa", "probability", "reasons", "warnings")
_HALF_WIDTH = normal_quantile(LEVEL)


def _read_description(reader: Hdf5Reader, mesh: TetMesh, version: int) -> Reconstruction:
    def array(name: str, count: int | None = None) -> np.ndarray | None:
        return reader.array(name, "f", (count,)) if reader.has(name) else None

    nuisance = reader.json("nuisance") if reader.has("nuisance") else {}
    with _refused(reader, "shapes"):
        shapes = ShapeReconstruction.of(reader.json("shapes")) if reader.has("shapes") else None
    result = Reconstruction(
        mesh=mesh,
        youngs=reader.array("youngs", "f", (mesh.n_tets,)),
        displacements=reader.array("displacements", "f", (None, mesh.n_points, 3)),
        history=reader.json("history", list),
        stop_reason=reader.attribute("/", "stop_reason", str),
        seconds=reader.attribute("/", "seconds", float),
        config=reader.json("config"),
        nuisance={name: NuisanceEstimate(**with_arrays(one)) for name, one in nuisance.items()},
        predicted=array("predicted"),
        residuals=array("residuals"),
        log_deviation=array("log_deviation", mesh.n_tets),
        shapes=shapes,
    )
    if version == 1:  # an element map; the depths of its lumps are unknown without the presses
        found = find_lumps(mesh, result.youngs)
        lumps = tuple(build_lump(mesh, (), inclusion) for inclusion in found)
        return replace(result, lumps=lumps, background_mpa=float(np.median(result.youngs)))
    finding = reader.json("finding")
    with _refused(reader, "lumps"):
        lumps = tuple(Lump.of_stored(lump, mesh.n_tets) for lump in finding["lumps"])
        values = {name: finding[name] for name in _FINDING}
        texts = {name: tuple(finding[name]) for name in ("reasons", "warnings")}
    return replace(result, lumps=lumps, **values | texts)


@contextmanager
def _refused(reader: Hdf5Reader, what: str) -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError) as error:
        text = f"has no valid {what} ({error!r}); invert the recording again"
        raise reader.error(text) from error
