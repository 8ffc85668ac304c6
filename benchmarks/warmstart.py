"""Gauss-Newton initialized by a surrogate, compared with a uniform initialization (Section VII).

    python benchmarks/warmstart.py [--count 50] [--weights FILE] [--published FOLDER ...]
        [--out FOLDER]

The objects are held out: those of `tactorch generate dataset=warmstart` with another seed (3003)
than that of the training data. They were not used to choose settings either: the limit of chi2 = 10
was chosen on objects of seed 1001 of an earlier, narrower recipe, and the share of 0.5 on twenty
objects of seed 1001 of this recipe. Each object is inverted three times in the same process:

- `uniform`: from the best uniform modulus, with total variation;
- `surrogate`: from the surrogate's map, with the same settings
  (`initialization=surrogate initialization.prior_mean=false`);
- `about`: from the surrogate's map, which is also the mean of half of the prior if it explains the
  presses (`initialization=surrogate` with default settings).

Only the scores use the truth. The target misfit of an object is the larger of its noise level
(chi2 = 1) and the final misfits of the runs. The table has the first iteration that reaches it (0:
the initialization itself does) and the seconds up to it, including the computation of the
initialization. The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, write_results

from tactorch.cli.compose import compose_options
from tactorch.cli.generate import make_recipe
from tactorch.generation import Sample, make_sample
from tactorch.importers import import_published
from tactorch.inverse import Reconstruction, Settings, homogeneous, invert_map
from tactorch.learning.surrogate import SurrogateStart
from tactorch.metrics import scores
from tactorch.recording import Recording

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl", "lightning")
SEED = 3003
KINDS = ("uniform", "surrogate", "about")
_TOLERANCE = 1.02  # factor on the target misfit


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all objects and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--weights", type=Path, help="checkpoint; default: the included weights")
    parser.add_argument("--published", type=Path, nargs="*", default=[])
    parser.add_argument("--out", type=Path, help="folder for warmstart.json and .md")
    options = parser.parse_args(arguments)
    meter, start, lines = OtherWork(), SurrogateStart(options.weights), [HEADER]
    print(HEADER, flush=True)
    rows = []
    for index in range(options.count):
        sample = held_out(options.seed, index)
        rows.append(compare(str(index), sample.recording, start))
        lines.append(row(rows[-1]))
        print(lines[-1], flush=True)
    published = [compare(f.name, import_published(f), start) for f in options.published]
    lines += [row(one) for one in published]
    print("\n".join(row(one) for one in published))
    result = {"objects": summary(rows), "published": {one["name"]: one for one in published}}
    lines += ["", *format_summary(result["objects"])]
    print("\n".join(["", *format_summary(result["objects"])]))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        whole = {**result, "each": rows}
        write_results(options.out, "warmstart", lines, whole, PACKAGES)
    print(json.dumps(result))


def held_out(seed: int, index: int) -> Sample:
    """Return a held-out object and its presses."""
    options = compose_options("generate", ["dataset=warmstart", f"dataset.seed={seed}"])
    return make_sample(make_recipe(options), index)


def compare(name: str, recording: Recording, start: SurrogateStart) -> dict[str, Any]:
    """Return the figures of all inversions of an object, and of the surrogate's map itself."""
    truth = recording.truth
    assert truth is not None
    predicted = scores(recording.mesh, start.predict(recording).youngs, truth)
    about = start.with_prior_mean(Settings(), recording)
    runs = {
        "uniform": (homogeneous, Settings()),
        "surrogate": (without_prediction(start), Settings()),
        "about": (without_prediction(start), about),
    }
    results = {
        kind: invert_map(recording, settings, start_mpa=first, show_progress=False)
        for kind, (first, settings) in runs.items()
    }
    target = _TOLERANCE * max(1.0, *(one.history[-1]["chi2"] for one in results.values()))
    return {
        "name": name,
        "presses": len(recording.presses),
        "predicted": {"pearson": predicted["pearson"], "ssim": predicted["ssim"]},
        "target_chi2": target,
        **{kind: figures(one, recording, target) for kind, one in results.items()},
    }


def without_prediction(start: SurrogateStart) -> SurrogateStart:
    """Return a start that has its weights read, but no prediction yet."""
    copy = replace(start)
    vars(copy)["network"] = start.network  # the cached property
    return copy


def figures(result: Reconstruction, recording: Recording, target: float) -> dict[str, float]:
    """Return the figures of one inversion."""
    assert recording.truth is not None
    quality = scores(recording.mesh, result.youngs, recording.truth)
    reached = next(entry for entry in result.history if entry["chi2"] <= target)
    return {
        "first_chi2": result.history[0]["chi2"],
        "iterations_to_misfit": reached["iteration"],
        "seconds_to_misfit": reached["seconds"],
        "iterations": result.iterations,
        "seconds": result.seconds,
        "pearson": quality["pearson"],
        "ssim": quality["ssim"],
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return means over the objects, and losses relative to the uniform initialization."""

    def mean(kind: str, key: str) -> float:
        return float(np.mean([one[kind][key] for one in rows]))

    keys = ("iterations_to_misfit", "seconds_to_misfit", "iterations", "seconds", "ssim", "pearson")
    return {
        "objects": len(rows),
        "predicted_pearson": mean("predicted", "pearson"),
        "predicted_ssim": mean("predicted", "ssim"),
        **{kind: {key: mean(kind, key) for key in keys} | _losses(rows, kind) for kind in KINDS},
    }


def _losses(rows: list[dict[str, Any]], kind: str) -> dict[str, float]:
    """Return the largest loss of SSIM relative to uniform, and the number of losses above 0.01."""
    gain = np.array([one[kind]["ssim"] - one["uniform"]["ssim"] for one in rows])
    return {
        "worst_ssim_loss": float(max(0.0, -gain.min())),
        "worse_by_more_than_0.01": int((gain < -0.01).sum()),
    }


def format_summary(means: dict[str, Any]) -> list[str]:
    """Return the summary as Markdown."""
    lines = [
        f"The surrogate alone: r {means['predicted_pearson']:.3f}, "
        f"SSIM {means['predicted_ssim']:.3f}"
        f" over {means['objects']} objects.",
        "",
        "| means over the objects | iterations to misfit | s | iterations to the end | s | SSIM |"
        " r | worse than from uniform by > 0.01 | at most by |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        one = means[kind]
        lines.append(
            f"| {kind} | {one['iterations_to_misfit']:.2f} | {one['seconds_to_misfit']:.2f}"
            f" | {one['iterations']:.1f} | {one['seconds']:.2f} | {one['ssim']:.3f}"
            f" | {one['pearson']:.3f} | {one['worse_by_more_than_0.01']}"
            f" | {one['worst_ssim_loss']:.3f} |"
        )
    return lines


HEADER = (
    "Three figures in a cell: uniform / surrogate / surrogate as mean of the prior.\n\n"
    "| object | presses | predicted r | SSIM | chi2 at first | iterations to misfit | s |"
    " iterations | SSIM | r |\n|" + "---|" * 10
)


def row(one: dict[str, Any]) -> str:
    """Return a row of the table."""

    def three(key: str, form: str) -> str:
        return " / ".join(format(one[kind][key], form) for kind in KINDS)

    cells = [
        one["name"], one["presses"], f"{one['predicted']['pearson']:.3f}",
        f"{one['predicted']['ssim']:.3f}", three("first_chi2", ".3g"),
        three("iterations_to_misfit", "d"), three("seconds_to_misfit", ".2f"),
        three("iterations", "d"), three("ssim", ".3f"), three("pearson", ".3f"),
    ]  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    main()
