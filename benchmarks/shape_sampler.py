"""Intervals of `find_shapes` against samples of the exact posterior, on random objects.

    python benchmarks/shape_sampler.py [--count 6] [--only OBJECT...] [--draws 200]
        [--cache FOLDER] [--workers N] [--out FOLDER]

Each object of `true_objects.py` is searched by `find_shapes`, whose posterior is normal in squared
radius and strength or about a ridge ("fast"), and then sampled by `sample_shapes`, with the
equilibria of every draw ("sampled"). Central 90 % intervals of the modulus, the radius and the
centre of the inclusion are compared: the width of the fast one over that of the sampled one, with
its standard error by bootstrap of the draws; and the fast median less the sampled one in sampled
deviations, each the width of the interval over 3.29. "In" says which of the intervals has the true
value.

The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, map_in_processes, write_results
from true_cases import Case, make_recording, random_cases

from tactorch.inverse import ShapeSamples, find_shapes, sample_shapes
from tactorch.inverse.posterior.importance import weighted_quantile
from tactorch.inverse.result.shapes import InclusionValues
from tactorch.mesh import Ellipsoid, Rotated, Sphere

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
QUANTITIES = {"E": "MPa", "R": "mm", "x": "mm", "y": "mm", "z": "mm"}
_LEVELS = (0.05, 0.5, 0.95)
_DEVIATIONS = 3.29  # width of a central 90 % interval of a normal distribution
_BOOTSTRAPS = 200
_HEADER = (
    "| case | quantity | true | fast 90 % | sampled 90 % | fast width / sampled | fast median - "
    "sampled, deviations | in | effective size | k | failed | seconds: search | sampling |\n|"
    + "---|"
    * 13
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=6, help="number of cases, from the first")
    parser.add_argument("--only", nargs="+", metavar="OBJECT", help="objects by name")
    parser.add_argument("--draws", type=int, default=200, help="draws of each posterior")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="folder for shape_sampler.json and .md")
    options = parser.parse_args(arguments)
    cases = random_cases(options.count, options.only)
    meter, lines, results = OtherWork(), [_HEADER], {}
    print(_HEADER, flush=True)
    work = partial(run, draws=options.draws, cache=options.cache)
    for case, found in zip(cases, map_in_processes(work, cases, options.workers), strict=True):
        results[case.name] = found
        rows = _rows(case.name, found)
        lines += rows
        print("\n".join(rows), flush=True)
    summary = _summary([found for found in results.values() if found["found"]])
    lines += ["", *_describe(summary)]
    print("\n".join(lines[-len(summary) - 1 :]))
    result = {
        "draws": options.draws,
        "cases": results,
        "summary": summary,
        "other_work": meter.share(),
    }
    if options.out is not None:
        write_results(options.out, "shape_sampler", lines, result, PACKAGES)
    print(json.dumps(result))


def run(case: Case, draws: int, cache: Path | None) -> dict[str, Any]:
    """Search and sample one case; return the intervals of the inclusion nearest to the true one."""
    recording, began = make_recording(case, cache), time.perf_counter()
    result = find_shapes(recording)
    searched = time.perf_counter()
    if not result.inclusions:
        return {"found": False, "search_s": searched - began}
    samples = sample_shapes(recording, result, draws=draws, seed=case.seed, show_progress=False)
    sampled, true = time.perf_counter(), _truth(case)
    centers = np.array([inclusion.shape.center_mm for inclusion in result.inclusions])
    nearest = int(np.linalg.norm(centers - [true["x"], true["y"], true["z"]], axis=1).argmin())
    posterior, number = result.posterior, result.order[nearest]
    fast = _quantities(InclusionValues.of(posterior.field, result.samples, number))
    exact = _quantities(samples.inclusion(nearest))
    return {
        "found": True,
        "inclusions": len(result.inclusions),
        "effective_size": samples.effective_size,
        "k_hat": samples.k_hat,
        "reliable": samples.reliable,
        "failed": samples.failed,
        "search_s": searched - began,
        "sampling_s": sampled - searched,
        "quantities": {
            name: _compare(true[name], fast[name], exact[name], samples) for name in QUANTITIES
        },
    }


def _truth(case: Case) -> dict[str, float]:
    """Return modulus, radius and centre of the true ball or ellipsoid."""
    ((shape, youngs),) = case.body.phantom.inclusions
    inner = shape.of if isinstance(shape, Rotated) else shape
    assert isinstance(inner, Sphere | Ellipsoid)
    sphere = isinstance(inner, Sphere)
    radius = inner.radius_mm if sphere else float(np.cbrt(np.prod(inner.radii_mm)))
    return {
        "E": float(youngs),
        "R": float(radius),
        **dict(zip("xyz", map(float, inner.center_mm), strict=True)),
    }


def _quantities(values: InclusionValues) -> dict[str, np.ndarray]:
    """Return the quantities of the table for each draw, each (draws,)."""
    x, y, z = values.center_mm.T
    return {"E": values.youngs_mpa, "R": values.radius_mm, "x": x, "y": y, "z": z}


def _compare(
    true: float, fast: np.ndarray, exact: np.ndarray, samples: ShapeSamples
) -> dict[str, Any]:
    """Return both intervals of a quantity, of fast (n,) and weighted (draws,) samples."""
    approximate = np.quantile(fast, _LEVELS)
    sampled = samples.quantile(exact, _LEVELS)
    low, median, high = sampled
    ratio = float(np.ptp(approximate) / (high - low))
    return {
        "true": true,
        "fast": approximate.tolist(),
        "sampled": sampled.tolist(),
        "width_ratio": ratio,
        "width_ratio_error": ratio * _relative_error(exact, samples.weights),
        "shift": float((approximate[1] - median) * _DEVIATIONS / (high - low)),
        "in_fast": bool(approximate[0] <= true <= approximate[2]),
        "in_sampled": bool(low <= true <= high),
    }


def _relative_error(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the standard error of the width of the weighted interval, over the width."""
    rng, logs = np.random.default_rng(0), []
    for _ in range(_BOOTSTRAPS):
        chosen = rng.integers(len(values), size=len(values))
        low, _, high = weighted_quantile(values[chosen], weights[chosen], _LEVELS)
        logs.append(np.log(high - low))
    return float(np.std(logs))


def _rows(name: str, found: dict[str, Any]) -> list[str]:
    if not found["found"]:
        return [f"| {name} | no inclusion found |" + " |" * 9 + f" {found['search_s']:.0f} | |"]
    rows = []
    for quantity, unit in QUANTITIES.items():
        each = found["quantities"][quantity]
        figures = [name, f"{quantity}, {unit}", f"{each['true']:.4g}"]
        figures += [f"{each[key][0]:.4g} to {each[key][2]:.4g}" for key in ("fast", "sampled")]
        figures.append(f"{each['width_ratio']:.2f} ± {each['width_ratio_error']:.2f}")
        figures.append(f"{each['shift']:+.2f}")
        figures.append(_WHERE[each["in_fast"], each["in_sampled"]])
        if quantity == "E":
            figures += [f"{found['effective_size']:.0f}", f"{found['k_hat']:.2f}"]
            figures += [f"{found['failed']}", f"{found['search_s']:.0f}"]
            figures.append(f"{found['sampling_s']:.0f}")
        else:
            figures += [""] * 5
        rows.append(f"| {' | '.join(figures)} |")
    return rows


_WHERE = {
    (True, True): "both",
    (True, False): "fast",
    (False, True): "sampled",
    (False, False): "none",
}


def _summary(cases: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return for each quantity the mean of the logarithm of the ratio, and that of the shift."""
    summary = {}
    for quantity in QUANTITIES if cases else ():
        each = [found["quantities"][quantity] for found in cases]
        logs, shifts = (np.array([e[key] for e in each]) for key in ("width_ratio", "shift"))
        summary[quantity] = {
            "width_ratio": float(np.exp(np.log(logs).mean())),
            "shift": float(shifts.mean()),
            "rms_shift": float(np.sqrt(np.mean(shifts**2))),
            "in_fast": float(np.mean([e["in_fast"] for e in each])),
            "in_sampled": float(np.mean([e["in_sampled"] for e in each])),
        }
    return summary


def _describe(summary: dict[str, dict[str, float]]) -> list[str]:
    return [
        f"{quantity}: geometric mean of the ratios {s['width_ratio']:.2f}, shift {s['shift']:+.2f} "
        f"(root mean square {s['rms_shift']:.2f}), true values in {s['in_fast']:.0%} of fast and "
        f"{s['in_sampled']:.0%} of sampled intervals."
        for quantity, s in summary.items()
    ]


if __name__ == "__main__":
    main()
