"""What the page's figures are drawn from: meshes, fields and presses as packed arrays."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from tactorch.mesh import TetMesh
from tactorch.mesh.topology import LOCAL_FACES
from tactorch.recording import Recording
from tactorch.report.belief import Judgement, UncertaintySummary
from tactorch.report.encode import indices, packed, quantised, rows
from tactorch.report.finding import Finding
from tactorch.report.runs import Run
from tactorch.viz.contact import contact_patches, total_forces
from tactorch.viz.outline import Outline

#: Of each field that a page can show: title, unit, and what its colours tell.
FIELDS: dict[str, tuple[str, str, str]] = {
    "youngs": ("Young's modulus", "MPa", "the map that was reconstructed"),
    "truth": ("Truth", "MPa", "the modulus that was pressed"),
    "reference": ("Reference", "MPa", "somebody else's reconstruction of the same presses"),
    "spread": (
        "Uncertainty",
        "± %",
        "half the width of the 95 % interval, as a share of the modulus; at the top of the scale"
        " too where the map lies at a bound, and there is none",
    ),
    "credibility": (
        "Credibility",
        "mm/MPa",
        "the largest change of any observed displacement by the element's modulus (eq. 15)",
    ),
    "resolution": (
        "Share of the data",
        "%",
        "how far the presses decide on each element by itself; the prior does the rest",
    ),
}

#: Stands for an uncertainty that there is none of, in the page too.
NOT_TOLD = -1.0

# What is known of the intervals of each kind of posterior.
_POSTERIORS = {
    "VariationalPosterior": "Intervals were checked over all elements of many simulated objects;"
    " within inclusions by themselves they are too narrow.",
    "LaplacePosterior": "Intervals take the prior and its weight as certain.",
    "LowRankPosterior": "Intervals take the prior and its weight as certain; they are never too"
    " narrow by what their low rank leaves out.",
}


def run_data(run: Run, judged: Judgement, found: Finding) -> dict[str, Any]:
    """Return everything of a run that its figures need, as JSON values."""
    mesh, recording = run.found.mesh, run.recording
    center = None if found.inclusion is None else [float(x) for x in found.inclusion.center_mm]
    return {
        "name": run.name,
        "points": packed(mesh.points, "float32"),
        "tets": indices(mesh.tets, mesh.n_points),
        "surface": indices(mesh.surface.triangles, mesh.n_points),
        "bounds": mesh.bounds.tolist(),
        "center": center,
        "level": _level(found),
        "fields": _fields(run, judged.belief),
        "interval": _interval(judged.belief),
        "posterior": "" if judged.belief is None else _POSTERIORS.get(judged.belief.kind, ""),
        "found": _region(mesh, None if found.inclusion is None else found.inclusion.elements),
        "true": _region(mesh, _true_region(mesh, recording)),
        "contact": [] if recording is None else _contact(mesh, recording),
        "presses": [] if recording is None else _presses(recording, judged),
        "corrected": judged.corrected,
        "history": [
            {
                "iteration": int(record["iteration"]),
                "seconds": float(record.get("seconds", 0.0)),
                "deviations": float(np.sqrt(record["chi2"])),
                "misfit": float(record["misfit"]),
            }
            for record in run.found.history
        ],
    }


def _level(found: Finding) -> float | None:
    """The modulus half way from an inclusion's surroundings to its mean, MPa."""
    inclusion = found.inclusion
    return None if inclusion is None else 0.5 * (inclusion.mean_mpa + inclusion.background_mpa)


def _fields(run: Run, belief: UncertaintySummary | None) -> dict[str, Any]:
    fields = {"youngs": run.found.youngs}
    if run.recording is not None:
        for name in ("truth", "reference"):
            values = getattr(run.recording, name)
            if values is not None:
                fields[name] = values
    if belief is not None:
        fields["spread"] = np.nan_to_num(100.0 * belief.spread, nan=NOT_TOLD)
        fields["credibility"] = belief.credibility
        fields["resolution"] = 100.0 * belief.resolution
    return {name: quantised(values) for name, values in fields.items()}


def _interval(belief: UncertaintySummary | None) -> list[dict[str, Any]] | None:
    return None if belief is None else [quantised(belief.low), quantised(belief.high)]


def _true_region(mesh: TetMesh, recording: Recording | None) -> Bool[np.ndarray, " m"] | None:
    if recording is None or recording.truth is None:
        return None
    outline = Outline.of(mesh, recording.truth)
    return None if outline is None else outline.inside


def _region(mesh: TetMesh, elements: Bool[np.ndarray, " m"] | None) -> dict[str, Any] | None:
    """Return the triangles around some elements."""
    if elements is None:
        return None
    return indices(_skin(mesh.tets[elements]), mesh.n_points)


def _skin(tets: Int[np.ndarray, "k 4"]) -> Int[np.ndarray, "f 3"]:
    """Return the faces that belong to one of the elements only."""
    faces = tets[:, LOCAL_FACES].reshape(-1, 3)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return faces[first[count == 1]]


def _contact(mesh: TetMesh, recording: Recording) -> list[dict[str, Any]]:
    pushed = total_forces(recording.presses)
    if not pushed.any():
        return []
    return [
        {
            "triangles": indices(patch.triangles, mesh.n_points),
            "direction": [float(x) for x in patch.direction],
        }
        for patch in contact_patches(mesh, pushed)
    ]


def _presses(recording: Recording, judged: Judgement) -> list[dict[str, Any]]:
    mesh, told = recording.mesh, []
    for number, (press, fit) in enumerate(
        zip(recording.presses, judged.fits, strict=True), start=1
    ):
        seen = np.flatnonzero(np.isfinite(fit.residual).any(axis=1))
        force = press.total_force
        direction = press.direction if press.direction is not None else force
        told.append(
            {
                "name": f"{number}"
                if press.name in ("", str(number))
                else f"{number}: {press.name}",
                "force": float(np.linalg.norm(force)),
                "direction": [float(x) for x in direction],
                "nodes": indices(seen, mesh.n_points),
                "observed": rows(press.displacement[seen]),
                "residual": rows(fit.residual[seen]),
                "deviations": rows(fit.deviations[seen]),
                "rms_um": 1e3 * fit.rms_mm,
                "rms_deviations": fit.rms_deviations,
            }
        )
    return told
