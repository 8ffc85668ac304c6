"""Coverage of the stated intervals of Young's modulus.

    python benchmarks/calibration.py [--objects 60] [--divisions 4] [--seed N] [--out FOLDER]

Objects of three kinds are simulated, inverted without their truth, and compared with it:

- `gaussian`: log-moduli drawn from a normal prior with spatial correlation and inverted with the
  same prior. The Laplace posterior is then correct, so this verifies its implementation;
- `same mesh`: cubes of 10 mm of unknown modulus (0.1 to 0.4 MPa) with none, one or two balls or
  boxes of a third to six times that, pressed on one to three sides in three steps, with white
  noise of 25 to 50 dB; inverted by `tactorch.inverse.invert` with its default settings, from the
  best uniform modulus, on the mesh of the simulation;
- `other mesh`: the same, but simulated on a mesh twice as fine, without inverse crime. The truth of
  an element is its mean modulus. This is the decisive figure.

Two posteriors are evaluated: `laplace` (curvature of total variation at the map, with the final
weight of the inversion) and `variational` (`tactorch.inverse.posterior.variational_posterior`,
whose weight and jumps are estimated from the data). Neither has a fitted factor.

The last line printed is one JSON object; its first figures are those of `other mesh` and
`variational`.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from calibration_objects import KINDS, Outcome
from machine import OtherWork, describe_machine

from tactorch.metrics.coverage import calibration_curve, calibration_error, coverage
from tactorch.viz import calibration_figure, save_figure

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
LEVEL = 0.9
MAIN = ("other mesh", "variational")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all objects and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--objects", type=int, default=60, help="of each kind")
    parser.add_argument("--divisions", type=int, default=4, help="cells along the cube's side")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--out", type=Path, help="folder for calibration.json, .md and .png")
    options = parser.parse_args(arguments)
    meter, results, lines, curves = OtherWork(), {}, [_HEADER], {}
    print(_HEADER, flush=True)
    for kind in options.only:
        outcomes = _judge_all(kind, options.objects, options.divisions, options.seed)
        results[kind] = {name: summary(outcomes, name) for name in outcomes[0].posteriors}
        for name, figures in results[kind].items():
            lines.append(_row(kind, name, figures))
            print(lines[-1], flush=True)
            curves[f"{kind}, {name}"] = calibration_curve(_judged(outcomes, name))
    share = meter.share()
    if share is not None:
        print(f"\nOther processes took {share:.0%} of the cores meanwhile.")
    kind, name = MAIN
    head = results.get(kind, {}).get(name, {})
    report = {**head, "seed": options.seed, "divisions": options.divisions, "kinds": results}
    if options.out is not None:
        _write(options.out, lines, report, curves)
    print(json.dumps(report))


def _judge_all(kind: str, objects: int, divisions: int, seed: int) -> list[Outcome]:
    outcomes = []
    for index in range(objects):
        outcomes.append(KINDS[kind](divisions, seed, index))
        if (index + 1) % 10 == 0:
            spent = sum(outcome.seconds for outcome in outcomes)
            print(f"    {kind}: {index + 1} of {objects} objects, {spent:.0f} s", flush=True)
    return outcomes


def _judged(outcomes: list[Outcome], name: str) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    return [(outcome.truth, *outcome.posteriors[name]) for outcome in outcomes]


def summary(outcomes: list[Outcome], name: str) -> dict[str, Any]:
    """Return the coverage of the intervals of one posterior, in total and by group."""
    judged = _judged(outcomes, name)
    found = coverage(judged, LEVEL)
    by_count = {}
    for count in sorted({outcome.inclusions for outcome in outcomes}):
        alike = [o for o in outcomes if o.inclusions == count]
        by_count[str(count)] = coverage(_judged(alike, name), LEVEL).fraction
    figures: dict[str, Any] = {
        "objects": len(outcomes),
        "elements": sum(len(outcome.truth) for outcome in outcomes),
        "coverage_90": found.fraction,
        "coverage_90_error": float(found.per_object.std() / np.sqrt(len(outcomes))),
        "coverage_90_volume": coverage(judged, LEVEL, [o.volumes for o in outcomes]).fraction,
        "coverage_50": coverage(judged, 0.5).fraction,
        "coverage_90_worst_tenth": float(np.quantile(found.per_object, 0.1)),
        "coverage_90_by_inclusions": by_count,
        "calibration_error": calibration_error(judged),
        "mean_deviation": float(np.mean([d.mean() for _, _, d in judged])),
        "mean_rms_error": float(np.mean([np.sqrt(np.mean((t - m) ** 2)) for t, m, _ in judged])),
        "seconds": sum(outcome.seconds for outcome in outcomes),
    }
    with_inside = [o for o in outcomes if o.inside.any()]
    if with_inside:
        weights = [o.inside.astype(float) for o in with_inside]
        inner = coverage(_judged(with_inside, name), LEVEL, weights)
        figures["coverage_90_inside_inclusions"] = inner.fraction
    return figures


_COLUMNS = {
    "coverage_90": "covered at 90 %",
    "coverage_90_error": "+-",
    "coverage_90_volume": "by volume",
    "coverage_90_inside_inclusions": "in inclusions",
    "coverage_90_worst_tenth": "worst tenth of objects",
    "coverage_50": "covered at 50 %",
    "mean_deviation": "mean deviation (log)",
    "mean_rms_error": "rms error (log)",
}
_HEADER = (
    f"| objects | posterior | number | {' | '.join(_COLUMNS.values())} |\n"
    f"|{'---|' * (len(_COLUMNS) + 3)}"
)


def _row(kind: str, name: str, figures: dict[str, Any]) -> str:
    cells = [f"{figures[key]:.3f}" if key in figures else "" for key in _COLUMNS]
    return f"| {' | '.join([kind, name, str(figures['objects']), *cells])} |"


def _write(
    folder: Path, lines: list[str], report: dict[str, Any], curves: dict[str, np.ndarray]
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), **report}, indent=2)
    (folder / "calibration.json").write_text(text + "\n")
    (folder / "calibration.md").write_text("\n".join(lines) + "\n")
    save_figure(calibration_figure(curves), folder / "calibration.png")


if __name__ == "__main__":
    main()
