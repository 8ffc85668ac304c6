"""Whether lumps are found where there are some, and only there, with probabilities that hold.

    python benchmarks/detection.py [--first K] [--count N] [--workers N] [--cache FOLDER]
        [--resume FOLDER] [--out FOLDER]

Two hundred cubes of 10 mm whose modulus is uniform, linear or a random field, every second with a
ball of any size, place and modulus, are pressed on three sides, with noise of 40, 30 or 20 dB. Of
a third of them the forces are wrong by 5 %, or the depth or Poisson's ratio that is stated; see
`true_cases.py`. The presses are solved on other, finer meshes, and nothing tells the inversion
which of them are wrong.

A reported inclusion is right where the object has a ball, stiff or soft as stated, and the reported
centre is in it, or within 1 mm of its centre. A ball can be found where its strength (see
`tactorch.inverse.fields.strength`) is five times its standard deviation by the Cramer-Rao bound at
the truth, for the errors that the presses have. A random field is an error of its spread then.

The last line printed is one JSON object.
"""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, map_in_processes, write_results
from true_cases import DOUBTFUL_CASES, Case, make_recording
from true_objects import PACKAGES, run_once

from tactorch.errors import TactorchError
from tactorch.inverse import Settings, invert
from tactorch.inverse.fields import FAMILIES, SIZE, ShapeField, strength
from tactorch.inverse.fields.background import Background
from tactorch.inverse.fit.shapes import ShapesOnSites
from tactorch.inverse.result.shapes import ShapeInclusion
from tactorch.inverse.search.problem import ShapeProblem
from tactorch.mesh import Sphere
from tactorch.phantoms import Gradient, RandomField
from tactorch.recording import Recording

NEAR_MM = 1.0
LEVELS = (0.0, 0.5, 0.9, 0.99, 0.999, 1.0)  # of probabilities, for the reliability
FOUND = 5.0  # standard deviations of a strength, from which on a ball can be found
# Errors of the presses with a fault.
ERRORS = {
    "forces": {"forces": 0.05},
    "depth": {"pose": 0.05, "discrepancy": 0.02},
    "poisson": {"pose": 0.05, "discrepancy": 0.01},
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge the cases, and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--first", type=int, default=0, help="number of the first object")
    parser.add_argument("--count", type=int, default=len(DOUBTFUL_CASES), help="number of objects")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--resume", type=Path, help="folder of the judgements of finished cases")
    parser.add_argument("--out", type=Path, help="folder for detection.json and .md")
    options = parser.parse_args(arguments)
    cases = DOUBTFUL_CASES[options.first :][: options.count]
    work, meter = partial(judge, cache=options.cache), OtherWork()
    if options.resume is not None:
        work = partial(run_once, work=work, folder=options.resume, setup=("detection",))
    rows: dict[str, dict[str, Any]] = {}
    lines = ["| case | background | ball | deviations | reported | right | s |", "|---" * 7 + "|"]
    for case, row in zip(cases, map_in_processes(work, cases, options.workers), strict=True):
        rows[case.name] = row
        lines.append(_line(case, row))
    summary = summarize(list(rows.values()))
    lines += ["", *_describe(summary)]
    print("\n".join(lines))
    result = {"cases": rows, **summary, "other_work": meter.share()}
    if options.out is not None:
        write_results(options.out, "detection", lines, result, PACKAGES)
    print(json.dumps(result))


def judge(case: Case, cache: Path | None) -> dict[str, Any]:
    """Return what is reported of a case, and what can be known of it."""
    print(f"{case.name} ...", file=sys.stderr, flush=True)
    recording, began = make_recording(case, cache), time.process_time()
    ball = _ball(case)
    row: dict[str, Any] = {
        "snr_db": case.snr_db,
        "fault": case.fault,
        "deviations": None if ball is None else deviations(case, recording),
    }
    try:
        result = invert(recording, Settings(method="inclusions"), show_progress=False)
    except TactorchError as error:
        return row | {"error": str(error)}
    shapes = result.shapes
    assert shapes is not None
    row |= {
        "status": str(result.status),
        "claims": [
            {"probability": i.probability, "right": is_right(case, i)} for i in shapes.inclusions
        ],
        "steps": [step._asdict() for step in shapes.steps],
        "errors": dict(shapes.errors),
        "chi2": shapes.chi2,
        "seconds": time.process_time() - began,
    }
    print(_line(case, row), file=sys.stderr, flush=True)
    return row


def _ball(case: Case) -> tuple[Sphere, float] | None:
    """Return the ball of an object and its modulus over that around it; None without any."""
    phantom = case.body.phantom
    if not phantom.inclusions:
        return None
    shape, youngs = phantom.inclusions[0]
    assert isinstance(shape, Sphere)
    background = type(phantom)(phantom.body, (), phantom.youngs_mpa)
    return shape, float(youngs) / float(background.youngs_at(np.array([shape.center_mm]))[0])


def is_right(case: Case, found: ShapeInclusion) -> bool:
    """Whether a reported inclusion is the object's ball."""
    ball = _ball(case)
    if ball is None:
        return False
    (shape, true), apart = ball, np.subtract(found.shape.center_mm, ball[0].center_mm)
    is_near = bool(np.linalg.norm(apart) < max(NEAR_MM, shape.radius_mm))
    return is_near and bool(true > 1.0) == bool(found.youngs_mpa > found.background_mpa)


def deviations(case: Case, recording: Recording) -> float:
    """Return the strength of the ball over its standard deviation by the Cramer-Rao bound."""
    found = _ball(case)
    assert found is not None
    (shape, contrast), problem = found, ShapeProblem(recording, Settings())
    background, errors = case.body.phantom.youngs_mpa, dict(ERRORS.get(case.fault, {}))
    degree = 2 if isinstance(background, Gradient) else 0
    if isinstance(background, RandomField):  # as the search knows it: its levels are a few
        errors["heterogeneity"] = background.spread
    field = ShapeField(problem.prior, (FAMILIES["ball"],), Background(degree))
    values = np.array([*shape.center_mm, np.log(shape.radius_mm), np.log(contrast)])
    start = np.zeros(field.size)
    start[: field.n_background] = field.physical(start)[: field.n_background]
    start[field.n_background :] = values
    point = ShapesOnSites(field, problem._reduced_sites).at(field.standard(start))
    evaluation = problem.linear.evaluate(point.youngs)
    problem.errors.linearise(evaluation, "linear")
    data = problem.data(problem.errors.at_least(errors))
    jacobian = point.jacobian(evaluation.with_data(data)) / field.deviation
    covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12, hermitian=True)
    size = field.index(0, *SIZE)
    slope = strength.derivative(start[size])[1]
    value = float(strength.from_logs(start[size])[1])
    return abs(value) / float(np.sqrt(slope @ covariance[np.ix_(size, size)] @ slope))


def summarize(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return specificity, sensitivity and reliability."""
    known = [row for row in rows if "error" not in row]
    empty = [row for row in known if row["deviations"] is None]
    visible = [row for row in known if (row["deviations"] or 0.0) >= FOUND]
    claims = [claim for row in known for claim in row["claims"]]
    probabilities = np.array([claim["probability"] for claim in claims])
    right = np.array([claim["right"] for claim in claims], dtype=float)
    bins = np.clip(np.searchsorted(LEVELS, probabilities, side="right") - 1, 0, len(LEVELS) - 2)
    reliability = [
        {
            "from": LEVELS[k],
            "count": int((bins == k).sum()),
            "stated": float(probabilities[bins == k].mean()),
            "right": float(right[bins == k].mean()),
        }
        for k in np.unique(bins)
    ]
    error = sum(b["count"] * abs(b["stated"] - b["right"]) for b in reliability)
    faults = sorted({row["fault"] for row in rows})
    return {
        "specificity": _share(not _reported(row) for row in empty),
        "sensitivity": _share(_is_found(row) for row in visible),
        "by_noise": {
            f"{level:g} dB": {
                "specificity": _share(not _reported(r) for r in empty if r["snr_db"] == level),
                "sensitivity": _share(_is_found(r) for r in visible if r["snr_db"] == level),
            }
            for level in sorted({row["snr_db"] for row in rows})
        },
        "false_by_fault": {
            fault or "none": _share(
                any(not c["right"] for c in _reported(r)) for r in known if r["fault"] == fault
            )
            for fault in faults
        },
        "below_bound_found": _share(
            _is_found(row) for row in known if 0.0 < (row["deviations"] or 0.0) < FOUND
        ),
        "reported_right": _share(c["right"] for row in known for c in _reported(row)),
        "reliability": reliability,
        "expected_calibration_error": error / len(claims) if claims else None,
        "cannot_tell": sum(row["status"] == "cannot tell" for row in known),
        "failed": len(rows) - len(known),
    }


def _reported(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the inclusions that a user sees."""
    if "error" in row or row["status"] == "cannot tell":
        return []
    return [claim for claim in row["claims"] if claim["probability"] >= 0.9]


def _is_found(row: Mapping[str, Any]) -> bool:
    return any(claim["right"] for claim in _reported(row))


def _share(values: Any) -> str:
    found = list(values)
    return f"{sum(found)} of {len(found)}"


def _line(case: Case, row: Mapping[str, Any]) -> str:
    ball, background = _ball(case), type(case.body.phantom.youngs_mpa).__name__
    what = "-" if ball is None else f"{ball[0].radius_mm:.2f} mm, {ball[1]:.2g} times"
    if "error" in row:
        return f"| {case.name} | {background} | {what} | failed: {row['error']} |"
    known = "-" if row["deviations"] is None else f"{row['deviations']:.1f}"
    cells = [background.replace("float", "uniform"), what, known, str(len(_reported(row)))]
    right = sum(claim["right"] for claim in _reported(row))
    return f"| {case.name} | {' | '.join(cells)} | {right} | {row['seconds']:.0f} |"


def _describe(summary: Mapping[str, Any]) -> list[str]:
    return [f"{key.replace('_', ' ').capitalize()}: {value}" for key, value in summary.items()]


if __name__ == "__main__":
    main()
