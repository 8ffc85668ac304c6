"""Bias of the shape model at the true parameters of objects of `true_objects.py`.

    python benchmarks/shape_bias.py [--count 8] [--only NAME...] [--cache FOLDER] [--workers N]
        [--out FOLDER]

The model of `find_shapes` is evaluated at the true ball or ellipsoid on the recording's mesh, with
and without the correction of the discretisation. The bias is the Gauss-Newton step from there for
presses without noise, which would be zero if the model and the solution of the truth were exact; it
is given for the logarithms of modulus and radius and for the centre, beside the standard deviation
for the white noise of the case. `z` is the same step for presses with noise, over its deviation:
the error of an efficient estimator.

Cases are the first random objects, or those whose name or object is given: any with one ball or
ellipsoid in a uniform body, whose forces and places are right.

The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, map_in_processes, write_results
from true_cases import CASES, RANDOM_CASES, Case, make_recording, random_cases

from tactorch.inverse.data.observations import DataModel
from tactorch.inverse.fields import BALL, CENTER, ELLIPSOID, SIZE, ShapeField, ShapePrior
from tactorch.inverse.fit.shapes import fit_shapes
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.search.correction import Correction
from tactorch.mesh import Ellipsoid, Rotated, Sphere

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
_ELEMENT, _NO_NOISE_DB = "tet10", 250.0
_HEADER = (
    "| case | E, MPa | bias of log E: uncorrected | corrected | deviation | bias of log R: "
    "uncorrected | corrected | deviation | largest bias of the centre / deviation: uncorrected | "
    "corrected | z of log E |\n|" + "---|" * 11
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=8, help="number of cases, from the first")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="cases or objects by name")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="folder for shape_bias.json and .md")
    options = parser.parse_args(arguments)
    cases = choose_cases(options.count, options.only)
    meter, lines, results = OtherWork(), [_HEADER], {}
    print(_HEADER, flush=True)
    work = partial(run, cache=options.cache)
    for case, found in zip(cases, map_in_processes(work, cases, options.workers), strict=True):
        results[case.name] = found
        lines.append(_row(case.name, found))
        print(lines[-1], flush=True)
    result = {"cases": results, "other_work": meter.share()}
    if options.out is not None:
        write_results(options.out, "shape_bias", lines, result, PACKAGES)
    print(json.dumps(result))


def choose_cases(count: int, only: Sequence[str] | None) -> tuple[Case, ...]:
    """Return the first random cases, or those whose name or object is given."""
    if not only:
        return random_cases(count, None)
    chosen: list[Case] = []
    for name in only:
        named = [case for case in (*CASES, *RANDOM_CASES) if name in (case.name, case.object)]
        if not named:
            raise SystemExit(f"unknown case or object {name}.")
        usable = [case for case in named if _has_true_parameters(case)]
        if not usable:
            raise SystemExit(f"{name} is not one ball or ellipsoid in a uniform body.")
        chosen += usable
    return tuple(chosen)


def _has_true_parameters(case: Case) -> bool:
    """Whether some shape is the object of a case, and its presses are as stated."""
    phantom = case.body.phantom
    if case.fault or len(phantom.inclusions) != 1 or not isinstance(phantom.youngs_mpa, float):
        return False
    shape = phantom.inclusions[0][0]
    return isinstance(shape.of if isinstance(shape, Rotated) else shape, Sphere | Ellipsoid)


def run(case: Case, cache: Path | None) -> dict[str, Any]:
    """Return biases and deviations at the true parameters of one case."""
    noisy = make_recording(case, cache)
    exact = make_recording(replace(case, snr_db=_NO_NOISE_DB), cache)
    # The displacements without noise, with the stated deviation of the noise.
    pairs = zip(noisy.presses, exact.presses, strict=True)
    presses = tuple(replace(press, displacement=other.displacement) for press, other in pairs)
    clean = replace(noisy, presses=presses)
    problem = InverseProblem(clean, element=_ELEMENT)
    field, z = _truth(case, ShapePrior.of(noisy.mesh, float(case.body.phantom.youngs_mpa)))
    fit, evaluation = fit_shapes(problem, field, z, max_iterations=0)
    offsets = Correction.of(problem).offsets(fit, evaluation)
    jacobian = fit.jacobian / field.deviation
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    with_noise = InverseProblem(noisy, body=problem.body).data

    def step(data: DataModel) -> np.ndarray:
        residuals = evaluation.with_data(data).residuals
        return np.asarray(-covariance @ (jacobian.T @ residuals))

    corrections = [-offset for offset in offsets]
    steps = {
        "uncorrected": step(problem.data),
        "corrected": step(problem.data.shifted(corrections)),
        "noisy": step(with_noise.shifted(corrections)),
    }
    return {
        "youngs_mpa": float(case.body.phantom.inclusions[0][1]),
        **{name: _scores(field, values, covariance) for name, values in steps.items()},
    }


def _truth(case: Case, prior: ShapePrior) -> tuple[ShapeField, np.ndarray]:
    """Return the field and the parameters of the true ball or ellipsoid."""
    ((shape, youngs),) = case.body.phantom.inclusions
    background = float(case.body.phantom.youngs_mpa)
    turn = shape.matrix() if isinstance(shape, Rotated) else np.eye(3)
    inner = shape.of if isinstance(shape, Rotated) else shape
    center, contrast = np.array(inner.center_mm), np.log(youngs / background)
    if isinstance(inner, Sphere):
        field, own = ShapeField(prior, (BALL,)), [*center, np.log(inner.radius_mm), contrast]
    else:
        assert isinstance(inner, Ellipsoid)
        logs = turn @ np.diag(np.log(inner.radii_mm)) @ turn.T
        field, own = ShapeField(prior, (ELLIPSOID,)), ELLIPSOID.values(center, logs, contrast)
    return field, field.standard(np.array([np.log(background), *own]))


def _scores(field: ShapeField, step: np.ndarray, covariance: np.ndarray) -> dict[str, Any]:
    """Return a step in log-modulus, log-radius and centre (mm), and over its deviation."""
    unit = np.eye(len(step))
    (radius, contrast), center = field.index(0, *SIZE), field.index(0, *CENTER)
    rows = {
        # The modulus is that of the background times the contrast.
        "log_youngs": unit[[field.background.level]] + unit[[contrast]],
        "log_radius": unit[[radius]],
        "center": unit[center],
    }
    scores = {}
    for name, row in rows.items():
        change, deviation = row @ step, np.sqrt(np.diag(row @ covariance @ row.T))
        largest = int(np.abs(change / deviation).argmax())
        scores[name] = {
            "step": float(change[largest]),
            "deviation": float(deviation[largest]),
            "relative": float(change[largest] / deviation[largest]),
        }
    return scores


def _row(name: str, found: dict[str, Any]) -> str:
    before, after = found["uncorrected"], found["corrected"]
    figures = [f"{found['youngs_mpa']:.3g}"]
    for quantity in ("log_youngs", "log_radius"):
        figures += [f"{each[quantity]['step']:.3f}" for each in (before, after)]
        figures.append(f"{after[quantity]['deviation']:.3f}")
    figures += [f"{each['center']['relative']:.2f}" for each in (before, after)]
    figures.append(f"{found['noisy']['log_youngs']['relative']:.2f}")
    return f"| {' | '.join([name, *figures])} |"


if __name__ == "__main__":
    main()
