"""Active sampling on a hemisphere with two inclusions (Section V-C, Fig. 12 a).

    python benchmarks/active_sampling.py [--seeds 6] [--grids 4 6 9 12] [--workers 1]
                                         [--worlds "same mesh" "other mesh"] [--out FOLDER]

A hemisphere of 10 mm radius, 0.1 MPa, held at its flat side, with two balls of 0.5 MPa at unequal
depths and sides, drawn for each seed. It is pressed by a round sensor of 3 mm radius, normal
to the surface, at 12 kPa; noise is 1 % of the typical displacement under the sensor. The inversion
has default settings, but stops at a relative decrease below 1 % or after 25 iterations. No rule
uses the truth.

There are two variants: presses computed on the mesh of the inversion (inverse crime, as in the
paper), and presses computed with quadratic elements on a finer mesh. In the second variant the
inversion corrects for the error of its linear elements, which exceeds the noise.

A separate uniform grid is computed for each of 4, 6, 9 and 12 presses (farthest points, evenly
distributed). The rules are random locations, the largest uncertainty (as in the paper), the largest
expected information, and the largest expected decrease of the mean squared error of log-moduli
("log error") or of moduli ("error"). All except random start at the top. The default rule was
chosen on the objects of seeds 0 to 5; the reported objects are others.

The error is the root mean square error of log E by volume; Pearson's r is by volume as well. The
target errors are those of the grids after their last press. A rule needs the number of presses
after which its lowest error so far is at most the target; a grid may need fewer than its number,
and a rule that never reaches the target counts as one press more than it made. `presses` refers to
the mean curve over seeds, `presses_by_seed` to each seed and its grid; ratios are relative to the
grid.

The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from active_objects import (
    BACKGROUND_MPA,
    RADIUS_MM,
    SENSOR_MM,
    Hemisphere,
    held,
    hemisphere,
    make_presser,
    material,
)
from machine import describe_machine, map_in_processes

from tactorch.inverse import GaussNewton, Settings
from tactorch.mesh import TetMesh
from tactorch.recording import Press
from tactorch.sampling import (
    ExpectedError,
    ExpectedInformation,
    LargestUncertainty,
    Patch,
    Presser,
    Random,
    Rule,
    Step,
    UniformGrid,
    candidate_patches,
    sample,
)
from tactorch.viz import sampling_figure, save_figure

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
RULES = ("random", "paper", "information", "log error", "error")
DEFAULT_RULES = ("random", "paper", "information", "error")
WORLDS = ("same mesh", "other mesh")
AIM = 2.0 / 3.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every rule on every object and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=10, help="0 to 5: rules were chosen on")
    parser.add_argument("--grids", type=int, nargs="+", default=(4, 6, 9, 12))
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--candidates", type=int, default=80)
    parser.add_argument("--cells", type=int, nargs=2, default=(7, 4), help="across and up")
    parser.add_argument("--finer", type=int, nargs=2, default=(10, 5), help="of the presses")
    parser.add_argument("--rules", nargs="+", choices=RULES, default=DEFAULT_RULES)
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=WORLDS)
    parser.add_argument("--out", type=Path, help="folder for active_sampling.json, .md and .png")
    options = parser.parse_args(arguments)
    mesh = hemisphere(*options.cells)
    patches = candidate_patches(mesh, held(mesh), SENSOR_MM, options.candidates)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    report: dict[str, Any] = {"elements": mesh.n_tets, "candidates": len(patches)}
    tables: list[str] = []
    for world in options.worlds:
        finer = mesh if world == "same mesh" else hemisphere(*options.finer)
        work = partial(run_rules, rules=options.rules, mesh=mesh, finer=finer, patches=patches,
                       grids=options.grids)  # fmt: skip
        runs = gather(work, seeds, options.workers)
        report[world] = judge(runs, options.grids)
        lines = [f"### {world}", "", *table(report[world]), ""]
        tables += lines
        print("\n".join(lines), flush=True)
        if options.out is not None:
            name = f"active_sampling_{world.replace(' ', '_')}.png"
            _draw(options.out / name, report[world], runs, patches, Hemisphere.draw(seeds[0]))
    if options.out is not None:
        _write(options.out, tables, report)
    print(json.dumps(report))


def gather(
    work: Callable[[int], dict[str, "Run"]], seeds: Sequence[int], workers: int
) -> dict[str, list["Run"]]:
    """Run the seeds, in parallel with more than one worker; return runs by rule."""
    found = list(map_in_processes(work, seeds, workers))
    return {rule: [runs[rule] for runs in found] for rule in found[0]}


def run_rules(
    seed: int,
    rules: Sequence[str],
    mesh: TetMesh,
    finer: TetMesh,
    patches: list[Patch],
    grids: Sequence[int],
) -> dict[str, "Run"]:
    """Run every grid and every rule on one object."""
    body = Hemisphere.draw(seed)
    presser = Remembering(make_presser(body, finer, mesh, seed))
    chosen, most = settings(same=finer is mesh), max(grids)
    made = {grid_name(size): (UniformGrid(size), size) for size in grids}
    made |= {name: (make_rule(name, seed), most) for name in rules}
    return {
        name: run(f"seed {seed}, {name}", rule, presser, mesh, patches, body, budget, chosen)
        for name, (rule, budget) in made.items()
    }


def grid_name(size: int) -> str:
    """Name of a uniform grid."""
    return f"grid of {size}"


@dataclass
class Remembering:
    """A presser that makes each press once: a patch gives every rule the same data."""

    presser: Presser
    known: dict[bytes, Press] = field(default_factory=dict)

    def plan(self, patch: Patch) -> Press:
        """See `Presser.plan`."""
        return self.presser.plan(patch)

    def press(self, patch: Patch) -> Press:
        """See `Presser.press`."""
        key = patch.center.tobytes()
        if key not in self.known:
            self.known[key] = self.presser.press(patch)
        return self.known[key]


@dataclass(frozen=True, eq=False)
class Run:
    """One rule on one object."""

    places: list[int]
    errors: np.ndarray
    pearsons: np.ndarray
    deviations: np.ndarray
    seconds: float


def make_rule(name: str, seed: int) -> Rule:
    """Return a rule by its name here."""
    rules: dict[str, Rule] = {
        "random": Random(seed),
        "paper": LargestUncertainty(),
        "information": ExpectedInformation(),
        "log error": ExpectedError("parameters"),
        "error": ExpectedError(),
    }
    return rules[name]


def settings(same: bool) -> Settings:
    """Return the default settings, but for an optimizer that stops at one part in a hundred."""
    optimizer = GaussNewton(max_iterations=25, tolerance=1e-2)
    return Settings(optimizer=optimizer, model_error="none" if same else "auto")


def run(
    title: str,
    rule: Rule,
    presser: Presser,
    mesh: TetMesh,
    patches: list[Patch],
    body: Hemisphere,
    budget: int,
    chosen: Settings,
) -> Run:
    """Sample by one rule; the truth is for the score alone."""
    truth, shares, began = body.truth(mesh), mesh.volumes / mesh.volumes.sum(), time.perf_counter()
    scores: list[tuple[float, float]] = []

    def on_press(step: Step) -> None:
        scores.append(score(np.log(step.youngs), truth, shares))
        print(
            f"# {title}, press {len(scores)} at {step.place}: error "
            f"{scores[-1][0]:.3f}, r {scores[-1][1]:.3f}, deviation {step.rms_deviation:.3f}, "
            f"{step.seconds:.0f} s",
            flush=True,
        )

    steps = sample(
        presser, mesh, patches, rule, budget,
        chosen, material=material(), start_mpa=BACKGROUND_MPA, on_press=on_press,
    )  # fmt: skip
    errors, pearsons = np.array(scores).T
    return Run(
        [step.place for step in steps],
        errors,
        pearsons,
        np.array([step.rms_deviation for step in steps]),
        time.perf_counter() - began,
    )


def score(found: np.ndarray, truth: np.ndarray, shares: np.ndarray) -> tuple[float, float]:
    """Return the root mean square error and Pearson's r, both by volume; r is 0 if undefined."""
    error = float(np.sqrt(shares @ (found - truth) ** 2))
    a, b = found - shares @ found, truth - shares @ truth
    spread = float(np.sqrt((shares @ a**2) * (shares @ b**2)))
    return error, float(shares @ (a * b)) / spread if spread > 1e-12 else 0.0


def presses_needed(errors: np.ndarray, target: float) -> int:
    """Return after how many presses the lowest error so far is at most the target.

    One more than there are errors if it never is.
    """
    there = np.flatnonzero(np.minimum.accumulate(errors) <= target)
    return int(there[0]) + 1 if len(there) else len(errors) + 1


def judge(runs: dict[str, list[Run]], grids: Sequence[int]) -> dict[str, Any]:
    """Compare the rules with the uniform grids."""
    errors = {name: np.array([one.errors for one in found]) for name, found in runs.items()}
    return {
        "seeds": len(next(iter(runs.values()))),
        "aim": AIM,
        "curves": {
            name: {
                "errors": errors[name].mean(axis=0).tolist(),
                "pearsons": np.mean([one.pearsons for one in found], axis=0).tolist(),
                "deviations": np.mean([one.deviations for one in found], axis=0).tolist(),
                "errors_by_seed": errors[name].tolist(),
                "places_by_seed": [one.places for one in found],
                "seconds": sum(one.seconds for one in found),
            }
            for name, found in runs.items()
        },
        "grids": {
            str(size): against(
                errors[grid_name(size)],
                {name: e for name, e in errors.items() if not name.startswith("grid")},
            )
            for size in grids
        },
    }


def against(grid: np.ndarray, rules: dict[str, np.ndarray]) -> dict[str, Any]:
    """Presses that the rules need to the grid's last error, and their ratio to the grid's own."""
    target = float(grid.mean(axis=0)[-1])
    own = presses_needed(grid.mean(axis=0), target)
    own_by_seed = [presses_needed(one, one[-1]) for one in grid]
    found = {}
    for name, errors in rules.items():
        needed = presses_needed(errors.mean(axis=0), target)
        by_seed = [presses_needed(e, g[-1]) for e, g in zip(errors, grid, strict=True)]
        found[name] = {
            "presses": needed,
            "ratio": needed / own,
            "presses_by_seed": by_seed,
            "ratio_by_seed": float(np.mean(by_seed) / np.mean(own_by_seed)),
        }
    return {"target_error": target, "presses": own, "rules": found}


def table(report: dict[str, Any]) -> list[str]:
    """One row a rule, two columns a grid."""
    grids = report["grids"]
    head = ["presses to the error of a grid (ratio; by seed)"]
    head += [f"of {size}: {one['target_error']:.3f}" for size, one in grids.items()]
    lines = [f"| {' | '.join(head)} |", f"|---|{'---|' * len(grids)}"]
    lines.append(f"| the grid | {' | '.join(str(one['presses']) for one in grids.values())} |")
    for name in next(iter(grids.values()))["rules"]:
        made = len(report["curves"][name]["errors"])
        cells = [name]
        for one in grids.values():
            rule = one["rules"][name]
            ratios = f"{rule['ratio']:.2f}; {rule['ratio_by_seed']:.2f}"
            cells.append(f"{_count(rule['presses'], made)} ({ratios})")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _count(presses: int, made: int) -> str:
    return str(presses) if presses <= made else f"> {made}"


def _write(folder: Path, lines: list[str], report: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), **report}, indent=2)
    (folder / "active_sampling.json").write_text(text + "\n")
    (folder / "active_sampling.md").write_text("\n".join(lines))


def _draw(
    path: Path,
    report: dict[str, Any],
    runs: dict[str, list[Run]],
    patches: list[Patch],
    body: Hemisphere,
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    centers = np.array([patch.center for patch in patches])
    largest = max(report["grids"], key=int)
    drawn = {n: f for n, f in runs.items() if not n.startswith("grid") or n == grid_name(largest)}
    figure = sampling_figure(
        {name: _curves(name, found) for name, found in runs.items()},
        {name: centers[found[0].places] for name, found in drawn.items()},
        balls=body.balls,
        radius_mm=SENSOR_MM,
        outline_mm=RADIUS_MM,
    )
    save_figure(figure, path)


def _curves(name: str, found: list[Run]) -> np.ndarray:
    """All runs of a rule, but the mean alone of a grid: so many bands would hide one another."""
    errors = np.array([one.errors for one in found])
    return errors.mean(axis=0)[None] if name.startswith("grid") else errors


if __name__ == "__main__":
    main()
