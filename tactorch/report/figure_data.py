"""Data of the page's figures: meshes, fields and presses as packed arrays."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Bool, Int

from tactorch.mesh import TetMesh
from tactorch.mesh.topology import LOCAL_FACES
from tactorch.recording import Press, Recording
from tactorch.report.assessment import Assessment, UncertaintySummary
from tactorch.report.content import RunReport, press_label
from tactorch.report.encode import indices, packed, quantised, rows
from tactorch.report.runs import Run
from tactorch.viz.contact import contact_patches, total_forces
from tactorch.viz.slicing import OUTLINE_LEVEL, colour_scale, departure_from_background

#: Title, unit and description of each field.
FIELDS: dict[str, tuple[str, str, str]] = {
    "youngs": ("Young's modulus", "MPa", "the reconstructed map"),
    "truth": ("Truth", "MPa", "the true modulus of the object"),
    "reference": ("Reference", "MPa", "another reconstruction from the same presses"),
    "uncertainty": (
        "Uncertainty",
        "± %",
        "relative half width of the 95 % interval; elements at a bound of the modulus have no"
        " interval and the colour of the largest value",
    ),
    "credibility": (
        "Credibility",
        "mm/MPa",
        "the largest change of any observed displacement per change of the element's modulus"
        " (eq. 15)",
    ),
    "resolution": (
        "Data resolution",
        "%",
        "diagonal of the resolution matrix: 100 % where the presses determine the modulus of an"
        " element, 0 % where the prior does",
    ),
}
#: Value of an undefined uncertainty; `core.js` has the same.
UNDEFINED = -1.0

_MODULI = ("youngs", "truth", "reference")
_COLOUR_MAPS = {"viridis": "viridis", "cividis": "cividis", "ultrasound": "gray"}
_PERCENTILE = 99.5  # upper end of the colour scales
_CALIBRATION = {
    "VariationalPosterior": "The coverage of the intervals was verified over all elements of many"
    " simulated objects; within inclusions alone they are too narrow.",
    "LaplacePosterior": "The intervals assume that the prior and its weight are exact.",
    "LowRankPosterior": "The intervals assume that the prior and its weight are exact; the low"
    " rank makes them wider, never narrower.",
}


def figure_data(reports: Sequence[RunReport], colours: str) -> dict[str, Any]:
    """Return the data of the figures of all runs as JSON values.

    Args:
        reports: Runs with their assessments.
        colours: Initial colour map of the modulus.
    """
    return {
        "runs": [_run_data(report) for report in reports],
        "fields": {
            name: dict(zip(("title", "unit", "note"), texts, strict=True))
            for name, texts in FIELDS.items()
        },
        "limits": _limits(reports),
        "colours": colours,
        "maps": {name: _colour_table(cmap) for name, cmap in _COLOUR_MAPS.items()},
    }


def _run_data(report: RunReport) -> dict[str, Any]:
    run, assessment, inclusion = report.run, report.assessment, report.inclusion
    mesh, recording, uncertainty = run.result.mesh, run.recording, assessment.uncertainty
    return {
        "name": run.name,
        "points": packed(mesh.points, "float32"),
        "tets": indices(mesh.tets, mesh.n_points),
        "surface": indices(mesh.surface.triangles, mesh.n_points),
        "bounds": mesh.bounds.tolist(),
        "center": None if inclusion is None else [float(x) for x in inclusion.center_mm],
        # Half way between the modulus of the inclusion and that of its surroundings, MPa.
        "level": None
        if inclusion is None
        else 0.5 * (inclusion.mean_mpa + inclusion.background_mpa),
        "fields": {name: quantised(values) for name, values in _fields(run, uncertainty).items()},
        "interval": None
        if uncertainty is None
        else [quantised(uncertainty.low), quantised(uncertainty.high)],
        "posterior": "" if uncertainty is None else _CALIBRATION.get(uncertainty.kind, ""),
        "inclusion": _boundary(mesh, None if inclusion is None else inclusion.elements),
        "trueInclusion": _boundary(mesh, _true_inclusion(mesh, recording)),
        "contact": [] if recording is None else _contact(mesh, recording),
        "presses": [] if recording is None else _presses(recording, assessment),
        "corrected": assessment.corrected,
        "history": [
            {
                "iteration": int(record["iteration"]),
                "seconds": float(record.get("seconds", 0.0)),
                "deviations": float(np.sqrt(record["chi2"])),
                "misfit": float(record["misfit"]),
            }
            for record in run.result.history
        ],
    }


def _fields(run: Run, uncertainty: UncertaintySummary | None) -> dict[str, np.ndarray]:
    fields = {"youngs": run.result.youngs}
    if run.recording is not None:
        for name in ("truth", "reference"):
            values = getattr(run.recording, name)
            if values is not None:
                fields[name] = values
    if uncertainty is not None:
        width = 100.0 * uncertainty.relative_half_width
        fields["uncertainty"] = np.nan_to_num(width, nan=UNDEFINED)
        fields["credibility"] = uncertainty.credibility
        fields["resolution"] = 100.0 * uncertainty.resolution
    return fields


def _true_inclusion(mesh: TetMesh, recording: Recording | None) -> Bool[np.ndarray, " m"] | None:
    if recording is None or recording.truth is None:
        return None
    departure = departure_from_background(mesh, recording.truth)
    return None if departure is None else departure > OUTLINE_LEVEL


def _boundary(mesh: TetMesh, elements: Bool[np.ndarray, " m"] | None) -> dict[str, Any] | None:
    """Return the triangles around some elements."""
    if elements is None:
        return None
    return indices(_boundary_faces(mesh.tets[elements]), mesh.n_points)


def _boundary_faces(tets: Int[np.ndarray, "k 4"]) -> Int[np.ndarray, "f 3"]:
    """Return the faces that belong to exactly one element."""
    faces = tets[:, LOCAL_FACES].reshape(-1, 3)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return faces[first[count == 1]]


def _contact(mesh: TetMesh, recording: Recording) -> list[dict[str, Any]]:
    forces = total_forces(recording.presses)
    if not forces.any():
        return []
    return [
        {
            "triangles": indices(patch.triangles, mesh.n_points),
            "direction": [float(x) for x in patch.direction],
        }
        for patch in contact_patches(mesh, forces)
    ]


def _presses(recording: Recording, assessment: Assessment) -> list[dict[str, Any]]:
    count, data = recording.mesh.n_points, []
    pairs: zip[tuple[Press, Any]] = zip(recording.presses, assessment.fits, strict=True)
    for number, (press, fit) in enumerate(pairs, start=1):
        nodes = np.flatnonzero(np.isfinite(fit.residual).any(axis=1))
        force = press.total_force
        direction = press.direction if press.direction is not None else force
        data.append(
            {
                "name": press_label(number, press),
                "force": float(np.linalg.norm(force)),
                "direction": [float(x) for x in direction],
                "nodes": indices(nodes, count),
                "observed": rows(press.displacement[nodes]),
                "residual": rows(fit.residual[nodes]),
                "deviations": rows(fit.deviations[nodes]),
                "rms_um": 1e3 * fit.rms_mm,
                "rms_deviations": fit.rms_deviations,
            }
        )
    return data


def _colour_table(cmap: str) -> dict[str, Any]:
    colours = matplotlib.colormaps[cmap](np.linspace(0.0, 1.0, 256))[:, :3]
    return packed(np.rint(255.0 * colours), "uint8")


def _limits(reports: Sequence[RunReport]) -> dict[str, list[float]]:
    """Return the ends of the colour scale of each field, the same for all runs."""
    maps = {"reconstruction": np.concatenate([one.run.result.youngs for one in reports])}
    recordings = [one.run.recording for one in reports if one.run.recording is not None]
    truths = [recording.truth for recording in recordings if recording.truth is not None]
    if truths:
        maps["truth"] = np.concatenate(truths)
    norm = colour_scale(maps, "linear", None)
    limits = {name: [float(norm.vmin or 0.0), float(norm.vmax or 1.0)] for name in _MODULI}
    known = [one.assessment.uncertainty for one in reports]
    summaries = [summary for summary in known if summary is not None]
    if summaries:
        width = np.concatenate([100.0 * one.relative_half_width for one in summaries])
        credibility = np.concatenate([one.credibility for one in summaries])
        top = _upper_limit(credibility)
        limits["uncertainty"] = [0.0, _upper_limit(width[np.isfinite(width)])]
        limits["credibility"] = [max(float(credibility.min()), 1e-4 * top), top]
        resolution = np.concatenate([100.0 * one.resolution for one in summaries])
        limits["resolution"] = [0.0, _upper_limit(resolution)]
    return limits


def _upper_limit(values: np.ndarray) -> float:
    return (float(np.percentile(values, _PERCENTILE)) if len(values) else 0.0) or 1.0
