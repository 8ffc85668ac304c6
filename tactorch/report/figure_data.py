"""Data of the page's figures: meshes, fields and presses as compactly encoded arrays."""

import base64
import json
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from tactorch.mesh import TetMesh
from tactorch.mesh.topology import LOCAL_FACES
from tactorch.recording import Press
from tactorch.report.content import PressFit, RunReport, UncertaintySummary, press_label
from tactorch.report.runs import Run
from tactorch.viz.contact import contact_patches, total_forces
from tactorch.viz.lump_surfaces import Surface, lump_surfaces
from tactorch.viz.slicing import OUTLINE_LEVEL, colour_scale, departure_from_background

#: Title, unit and description of each field.
FIELDS: dict[str, tuple[str, str, str]] = {
    "youngs": ("Young's modulus", "MPa", "the result, averaged over each element"),
    "other": (
        "Other description",
        "MPa",
        "the description of the same presses that predicts them less",
    ),
    "truth": ("Truth", "MPa", "the true modulus of the object"),
    "reference": ("Reference", "MPa", "another reconstruction from the same presses"),
    "uncertainty": (
        "Uncertainty",
        "± %",
        "relative half width of the 90 % interval; elements at a bound of the modulus have no"
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

_STEPS = 65_535  # of the values with two bytes
_MODULI = ("youngs", "other", "truth", "reference")
#: Matplotlib's name of each colour map of the modulus.
COLOURS = {"viridis": "viridis", "cividis": "cividis", "ultrasound": "gray"}
_PERCENTILE = 99.5  # upper end of the colour scales
_CALIBRATION = {
    "VariationalPosterior": "The coverage of the intervals was verified over all elements of many"
    " simulated objects; within inclusions alone they are too narrow.",
    "LaplacePosterior": "The intervals assume that the prior and its weight are exact.",
    "LowRankPosterior": "The intervals assume that the prior and its weight are exact; the low"
    " rank makes them wider, never narrower.",
}


def figure_data(reports: Sequence[RunReport], colours: str) -> dict[str, Any]:
    """Return the data of the figures of all runs as JSON values; `colours` are shown first."""
    return {
        "runs": [_run_data(report) for report in reports],
        "fields": {
            name: dict(zip(("title", "unit", "note"), texts, strict=True))
            for name, texts in FIELDS.items()
        },
        "limits": _limits(reports),
        "colours": colours,
        "maps": {name: _colour_table(cmap) for name, cmap in COLOURS.items()},
    }


def _run_data(report: RunReport) -> dict[str, Any]:
    run, uncertainty = report.run, report.uncertainty
    mesh, recording = run.result.mesh, run.recording
    data = dict.fromkeys(("center", "level", "interval", "trueInclusion")) | {
        "name": run.name,
        "description": run.result.name,
        "points": packed(mesh.points, "float32"),
        "tets": indices(mesh.tets, mesh.n_points),
        "surface": indices(mesh.surface.triangles, mesh.n_points),
        "bounds": mesh.bounds.tolist(),
        "fields": {name: quantised(values) for name, values in _fields(run, uncertainty).items()},
        "posterior": "",
        "lumps": _lumps(report),
        "contact": [],
        "presses": [],
        "history": [
            {
                "iteration": int(record["iteration"]),
                "seconds": float(record.get("seconds", 0.0)),
                "deviations": float(np.sqrt(record["chi2"])),
            }
            for record in run.result.history
        ],
    }
    if report.lump is not None:
        inclusion = report.lump.inclusion
        data["center"] = inclusion.center_mm.tolist()
        # Half way between the modulus of the lump and that of its surroundings, MPa.
        data["level"] = 0.5 * (inclusion.mean_mpa + inclusion.background_mpa)
    if uncertainty is not None:
        data["interval"] = [quantised(uncertainty.low), quantised(uncertainty.high)]
        data["posterior"] = _CALIBRATION.get(uncertainty.kind, "")
    if recording is not None:
        truth = recording.truth
        departure = None if truth is None else departure_from_background(mesh, truth)
        if departure is not None:
            boundary = _boundary(mesh, departure > OUTLINE_LEVEL)
            data["trueInclusion"] = indices(boundary, mesh.n_points)
        forces = total_forces(recording.presses)
        data["contact"] = [
            {"triangles": indices(p.triangles, mesh.n_points), "direction": p.direction.tolist()}
            for p in (contact_patches(mesh, forces) if forces.any() else [])
        ]
        data["presses"] = [
            _press_data(k + 1, recording.presses[k], report.fits[k]) for k in report.drawn
        ]
    return data


def _lumps(report: RunReport) -> list[dict[str, Any]]:
    """Return the surfaces of each lump, those of an element map along faces of elements.

    Inclusions also have the surfaces of what is inside them with probabilities of 95 % and 5 %.
    """
    result, mesh = report.result, report.result.mesh
    if result.shapes is None:
        inclusions = [lump.inclusion for lump in result.lumps]
        surfaces = [Surface(mesh.points, _boundary(mesh, i.elements)) for i in inclusions]
        return [
            {"youngs": inclusion.mean_mpa, "best": _surface(surface)}
            for inclusion, surface in zip(inclusions, surfaces, strict=True)
        ]
    return [
        {
            "youngs": lump.youngs_mpa,
            **{name: _surface(getattr(lump, name)) for name in ("best", "inner", "outer")},
        }
        for lump in lump_surfaces(result.shapes)[: len(result.lumps)]
    ]


def _surface(surface: Surface | None) -> dict[str, Any] | None:
    if surface is None:
        return None
    triangles = indices(surface.triangles, len(surface.points))
    return {"points": packed(surface.points, "float32"), "triangles": triangles}


def _fields(run: Run, uncertainty: UncertaintySummary | None) -> dict[str, np.ndarray]:
    fields, recording = {"youngs": run.result.youngs}, run.recording
    if run.result.other is not None:
        fields["other"] = run.result.other.youngs
    if recording is not None:
        known = {"truth": recording.truth, "reference": recording.reference}
        fields |= {name: values for name, values in known.items() if values is not None}
    if uncertainty is not None:
        width = 100.0 * uncertainty.relative_half_width
        fields["uncertainty"] = np.nan_to_num(width, nan=UNDEFINED)
        if uncertainty.credibility is not None:
            fields["credibility"] = uncertainty.credibility
        if uncertainty.resolution is not None:
            fields["resolution"] = 100.0 * uncertainty.resolution
    return fields


def _boundary(mesh: TetMesh, elements: Bool[np.ndarray, " m"]) -> Int[np.ndarray, "t 3"]:
    """Return the triangles around some elements: the faces of exactly one of them."""
    faces = mesh.tets[elements][:, LOCAL_FACES].reshape(-1, 3)
    nodes = np.sort(faces, axis=1)
    _, first, count = np.unique(nodes, axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def _press_data(number: int, press: Press, fit: PressFit) -> dict[str, Any]:
    nodes = np.flatnonzero(np.isfinite(fit.residual).any(axis=1))
    direction = press.total_force if press.direction is None else press.direction
    return {
        "name": press_label(number, press),
        "force": float(np.linalg.norm(press.total_force)),
        "direction": direction.tolist(),
        "nodes": indices(nodes, len(press.forces)),
        "observed": rows(press.displacement[nodes]),
        "residual": rows(fit.residual[nodes]),
        "deviations": rows(fit.deviations[nodes]),
        "rms_um": _known(1e3 * fit.rms_mm),
        "rms_deviations": _known(fit.rms_deviations),
    }


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _colour_table(cmap: str) -> dict[str, Any]:
    colours = matplotlib.colormaps[cmap](np.linspace(0.0, 1.0, 256))[:, :3]
    return packed(np.rint(255.0 * colours), "uint8")


def _limits(reports: Sequence[RunReport]) -> dict[str, list[float]]:
    """Return the ends of the colour scale of each field, the same for all runs."""
    runs = [report.run for report in reports]
    if not runs:
        return {}
    moduli = [run.result.youngs for run in runs]
    lumps = [lump.inclusion.mean_mpa for run in runs for lump in run.result.lumps]
    maps = {"reconstruction": np.concatenate([*moduli, np.array(lumps)])}
    recordings = [run.recording for run in runs if run.recording is not None]
    truths = [recording.truth for recording in recordings if recording.truth is not None]
    if truths:
        maps["truth"] = np.concatenate(truths)
    norm = colour_scale(maps, "linear", None)
    limits = {name: [float(norm.vmin or 0.0), float(norm.vmax or 1.0)] for name in _MODULI}
    uncertainties = [report.uncertainty for report in reports]
    known = [summary for summary in uncertainties if summary is not None]
    if known:
        width = np.concatenate([100.0 * summary.relative_half_width for summary in known])
        limits["uncertainty"] = [0.0, _upper_limit(width[np.isfinite(width)])]
        metric = _joined([summary.credibility for summary in known])
        top = _upper_limit(metric)
        limits["credibility"] = [max(float(metric.min(initial=top)), 1e-4 * top), top]
        resolution = _joined([summary.resolution for summary in known])
        limits["resolution"] = [0.0, _upper_limit(100.0 * resolution)]
    return limits


def _joined(fields: Sequence[np.ndarray | None]) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(field for field in fields if field is not None)])


def _upper_limit(values: np.ndarray) -> float:
    return (float(np.percentile(values, _PERCENTILE)) if len(values) else 0.0) or 1.0


def packed(array: Shaped[np.ndarray, "..."], dtype: str) -> dict[str, Any]:
    """Return the little-endian bytes of an array, within the range of `dtype`, in base64."""
    data = np.ascontiguousarray(array, dtype=np.dtype(dtype).newbyteorder("<")).tobytes()
    return {"dtype": dtype, "data": base64.b64encode(data).decode("ascii")}


def indices(array: Int[np.ndarray, "..."], count: int) -> dict[str, Any]:
    """Return indices below `count`, with two bytes each if possible."""
    return packed(array, "uint16" if count <= _STEPS + 1 else "uint32")


def quantised(values: Float[np.ndarray, " m"]) -> dict[str, Any]:
    """Return a field with two bytes per value, on a logarithmic scale if all are positive.

    There are 65,535 steps between minimum and maximum: 0.02 % for moduli of 0.001 to 100 MPa.
    """
    ratio = bool(values.min() > 0)
    scaled = np.log(values) if ratio else values
    low, high = float(scaled.min()), float(scaled.max())
    width = high - low
    steps = np.rint((scaled - low) / width * _STEPS) if width > 0 else np.zeros(len(values))
    return packed(steps, "uint16") | {"ratio": ratio, "low": low, "high": high}


def rows(values: Float[np.ndarray, "k 3"]) -> dict[str, Any]:
    """Return vectors with two bytes per component, relative to the largest; NaN is kept."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    step = largest / (_STEPS // 2) if largest > 0 else 1.0
    whole = np.where(np.isnan(values), -(_STEPS // 2) - 1, np.rint(values / step))
    return packed(whole, "int16") | {"step": step}


def script_json(value: Any) -> str:
    """Return JSON that cannot close the script element that contains it."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
