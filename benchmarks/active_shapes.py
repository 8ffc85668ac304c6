"""Active sampling with shapes, without inverse crime (Section V-C).

    python benchmarks/active_shapes.py [--seeds N] [--first-seed K] [--grids 6 9]
        [--rules shapes random] [--presses N] [--limit] [--workers N] [--cache FOLDER]
        [--out FOLDER]

A cube of 10 mm, 0.2 MPa, held at the bottom, with two balls of 1 MPa at unequal depths, drawn for
each seed. A round finger of 2 mm radius presses its top at one of 25 places; its pressure is 30 kPa
(1 - r^2 / R^2), and the noise is 1 % of the displacements (40 dB). The presses are solved with
quadratic elements on a fine mesh that follows the balls; the recording is on a coarse mesh that
knows of the outline alone. Settings are the defaults. No rule uses the truth. (On the hemisphere of
Fig. 12 a, the recording's mesh would have to be much finer for the outline under the finger.)

After each press shapes are fitted to all presses so far, from those before. The error is the root
mean square of log E over voxels of the body, against the analytic object. A uniform grid of n
presses (farthest points) is computed for each n. A rule needs the number of presses after which its
lowest error so far is at most that of the grid. It makes two thirds of the presses of the largest
grid by default, and needs one more than it made where these do not suffice.

The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from active_sampling import presses_needed
from machine import map_in_processes, write_results
from true_cases import OBJECTS, PRESSES, Body, Case, Contact, Presses, Truth, make_recording

from tactorch.errors import TactorchError
from tactorch.inverse import InverseProblem, Settings, find_shapes
from tactorch.inverse.errors.base import KeptRims
from tactorch.inverse.fields import BALL, ShapeField, ShapePrior
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search.model import as_judged
from tactorch.mesh import Box, Sphere
from tactorch.mesh.geometry import farthest_point_order
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.sampling.shape_design import ShapeDesign

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
SIDE_MM, BACKGROUND_MPA, LUMP_MPA = 10.0, 0.2, 1.0
SENSOR_MM, PRESSURE_MPA = 2.0, 0.03
PLACES_MM = (2.2, 3.6, 5.0, 6.4, 7.8)  # of the finger along x and y
RULES = ("shapes", "random")
KNOWN = "truth"  # rule that knows the object
AIM = 2.0 / 3.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Run every rule and grid on every object and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=10)
    parser.add_argument("--grids", type=int, nargs="+", default=(6, 9))
    parser.add_argument("--rules", nargs="+", choices=RULES, default=RULES)
    parser.add_argument("--presses", type=int, help="number of presses by a rule")
    parser.add_argument("--limit", action="store_true", help="errors expected at the truth instead")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free presses")
    parser.add_argument("--out", type=Path, help="folder for active_shapes.json and .md")
    options = parser.parse_args(arguments)
    budget = options.presses or round(AIM * max(options.grids))
    work: Callable[[int], dict[str, Any]] = partial(
        run_object, grids=options.grids, rules=options.rules, budget=budget, cache=options.cache
    )
    if options.limit:
        work = partial(limit_of, grids=options.grids, budget=budget, cache=options.cache)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    runs = list(map_in_processes(work, seeds, options.workers))
    report = {"aim": AIM, "seeds": list(seeds), "runs": runs, "grids": judge(runs)}
    lines = table(report)
    print("\n".join(lines))
    if options.out is not None:
        name = "active_shapes_limit" if options.limit else "active_shapes"
        write_results(options.out, name, lines, report, PACKAGES)
    print(json.dumps(report))


def run_object(
    seed: int, grids: Sequence[int], rules: Sequence[str], budget: int, cache: Path | None
) -> dict[str, Any]:
    """Run every grid and rule on one object."""
    session = Session.of(seed, cache)
    found: dict[str, Any] = {"grids": {}, "rules": {}}
    for size in grids:
        places = session.grid(size)
        score, _ = session.score(places, None)
        found["grids"][str(size)] = score | {"places": places}
        print(f"# seed {seed}, grid of {size}: {_text(score)}", flush=True)
    for rule in rules:
        found["rules"][rule] = run_rule(session, seed, rule, budget)
    return found


def run_rule(session: "Session", seed: int, rule: str, budget: int) -> list[dict[str, Any]]:
    """Press by one rule, from the middle; return the score after each press."""
    places, shapes, scores = [FIRST], None, []
    while True:
        score, shapes = session.score(places, shapes)
        scores.append(score | {"place": places[-1]})
        print(f"# seed {seed}, {rule}, press {len(places)}: {_text(scores[-1])}", flush=True)
        if len(places) == budget:
            return scores
        rest = [i for i in range(len(CONTACTS)) if i not in places]
        if rule == "random" or shapes is None:
            places.append(int(np.random.default_rng([seed, len(places)]).choice(rest)))
        else:
            places.append(rest[int(session.expected_errors(shapes, places, rest).argmin())])


def limit_of(seed: int, grids: Sequence[int], budget: int, cache: Path | None) -> dict[str, Any]:
    """Return the errors expected at the truth, of grids and of presses chosen one by one."""
    session = Session.of(seed, cache)
    mesh, shapes = session.recording.mesh, true_shapes(seed, session.recording)
    blocks = session.derivatives(shapes)
    design = ShapeDesign(shapes, mesh, np.zeros((1, mesh.n_tets)))

    def expected(sets: Sequence[Sequence[int]]) -> np.ndarray:
        data = [np.vstack([blocks[i] for i in places]) for places in sets]
        return np.sqrt(design.expected_errors(data))

    found: dict[str, Any] = {"grids": {}, "rules": {KNOWN: []}}
    for size in grids:
        places = session.grid(size)
        found["grids"][str(size)] = {"error": float(expected([places])[0]), "places": places}
    places, choices = [], [FIRST]
    while len(places) < budget:
        errors = expected([[*places, i] for i in choices])
        places.append(choices[int(errors.argmin())])
        found["rules"][KNOWN].append({"error": float(errors.min()), "place": places[-1]})
        choices = [i for i in range(len(CONTACTS)) if i not in places]
    print(f"# seed {seed}: places {places}", flush=True)
    return found


def true_shapes(seed: int, recording: Recording) -> ShapeReconstruction:
    """Return the balls of an object as ellipsoids, with a posterior that is the prior."""
    inclusions = make_body(seed).phantom.inclusions
    field = ShapeField(ShapePrior.of(recording.mesh, BACKGROUND_MPA), (BALL,) * len(inclusions))
    values = [np.array([np.log(BACKGROUND_MPA)])]
    for ball, youngs in inclusions:
        values.append(
            np.array([*ball.center_mm, np.log(ball.radius_mm), np.log(youngs / BACKGROUND_MPA)])
        )
    field, z = as_judged(field, field.standard(np.concatenate(values)))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), np.eye(len(z)))
    return ShapeReconstruction(field, z, posterior, 1.0, (50.0,) * len(inclusions), 50.0)


class Session:
    """All candidate presses of an object, some of which are used.

    Args:
        recording: Noisy presses at all candidates.
        truth: The object on voxels.
    """

    def __init__(self, recording: Recording, truth: Truth) -> None:
        self.recording, self._truth = recording, truth
        self._settings, self._kept = Settings(), KeptRims()
        self._problem = InverseProblem(recording, noise=self._settings.noise)

    @staticmethod
    def of(seed: int, cache: Path | None) -> "Session":
        """Make the presses of an object; those without noise are cached."""
        name = f"two_balls{seed}"
        OBJECTS[name] = lambda: make_body(seed)
        PRESSES[SCAN.name] = SCAN
        case = Case(name, SCAN.name, 40.0, seed=seed)
        return Session(make_recording(case, cache), Truth.of(case.body))

    def score(
        self, places: Sequence[int], before: ShapeReconstruction | None
    ) -> tuple[dict[str, Any], ShapeReconstruction | None]:
        """Fit shapes to the presses at some places and compare them with the object."""
        began, truth = time.perf_counter(), np.log(self._truth.youngs)
        try:
            recording = self.recording.select(places)
            shapes = find_shapes(recording, self._settings, start=before, kept=self._kept)
        except TactorchError as error:
            print(f"# {error}", flush=True)
            change = truth - np.log(BACKGROUND_MPA)
            return {"error": float(np.sqrt(np.mean(change**2))), "r": 0.0, "failed": True}, before
        log_youngs = np.log(shapes.youngs_at(self._truth.points))
        spread = float(np.std(log_youngs))
        return {
            "error": float(np.sqrt(np.mean((log_youngs - truth) ** 2))),
            "r": float(np.corrcoef(log_youngs, truth)[0, 1]) if spread > 1e-9 else 0.0,
            "lumps": len(shapes.inclusions),
            "chi2": shapes.chi2,
            "seconds": time.perf_counter() - began,
        }, shapes

    def expected_errors(
        self, shapes: ShapeReconstruction, places: Sequence[int], rest: Sequence[int]
    ) -> np.ndarray:
        """Return the error that is expected after a press at each of the other places."""
        blocks = self.derivatives(shapes)
        design = ShapeDesign(shapes, self.recording.mesh, np.vstack([blocks[i] for i in places]))
        return design.expected_errors([blocks[i] for i in rest])

    def derivatives(self, shapes: ShapeReconstruction) -> list[np.ndarray]:
        """Return the derivatives of the data of each candidate by log-moduli of elements."""
        youngs = shapes.youngs_at(self.recording.mesh.centroids)
        jacobian = self._problem.evaluate(youngs).jacobian() * youngs
        return np.split(jacobian, self._problem.data.begins[1:])

    @staticmethod
    def grid(size: int) -> list[int]:
        """Return the places of a uniform grid, the middle first."""
        centers = np.array([contact.center_mm for contact in CONTACTS])
        return [int(i) for i in farthest_point_order(centers, size, FIRST)]


def make_body(seed: int) -> Body:
    """Return the cube with two balls on different sides, one shallow and one deeper."""
    rng = np.random.default_rng([seed, 23])
    turn = rng.uniform(0.0, 2.0 * np.pi)
    turns = (turn, turn + rng.uniform(0.7, 1.3) * np.pi)
    gaps = (rng.uniform(1.0, 1.8), rng.uniform(2.0, 3.0))
    balls = []
    for angle, gap in zip(turns, gaps, strict=True):
        radius, away = rng.uniform(1.3, 1.8), rng.uniform(2.0, 2.6)
        middle = SIDE_MM / 2
        x, y = middle + away * np.cos(angle), middle + away * np.sin(angle)
        center = (float(x), float(y), float(SIDE_MM - gap - radius))
        balls.append((Sphere(center, float(radius)), LUMP_MPA))
    cube = Box((SIDE_MM / 2,) * 3, (SIDE_MM,) * 3)
    return Body(Phantom(cube, tuple(balls), BACKGROUND_MPA), (0, 1))


def judge(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Presses that each rule needs to the error of each grid, and their ratio to the grid's own."""
    found: dict[str, Any] = {}
    for size in runs[0]["grids"]:
        targets = [run["grids"][size]["error"] for run in runs]
        found[size] = {"error": float(np.mean(targets)), "rules": {}}
        for rule in runs[0]["rules"]:
            errors = [[score["error"] for score in run["rules"][rule]] for run in runs]
            needed = [presses_needed(np.array(e), t) for e, t in zip(errors, targets, strict=True)]
            mean = presses_needed(np.mean(errors, axis=0), float(np.mean(targets)))
            found[size]["rules"][rule] = {
                "presses": mean,
                "ratio": mean / int(size),
                "presses_by_seed": needed,
                "ratio_by_seed": float(np.mean(needed)) / int(size),
            }
    return found


def table(report: dict[str, Any]) -> list[str]:
    """One row a rule, one column a grid; and the mean errors by the number of presses."""
    grids, runs = report["grids"], report["runs"]
    heads = [f"of {size}: {one['error']:.3f}" for size, one in grids.items()]
    lines = [
        f"| presses to the error of a grid (ratio; by seed) | {' | '.join(heads)} |",
        f"|---|{'---|' * len(grids)}",
    ]
    for rule in runs[0]["rules"]:
        cells = []
        for one in grids.values():
            values = one["rules"][rule]
            cells.append(
                f"{values['presses']} ({values['ratio']:.2f}; {values['ratio_by_seed']:.2f})"
            )
        lines.append(f"| {rule} | {' | '.join(cells)} |")
    count = len(next(iter(runs[0]["rules"].values())))
    lines += ["", f"| mean error after | {' | '.join(map(str, range(1, count + 1)))} |"]
    lines.append(f"|---|{'---|' * count}")
    for rule in runs[0]["rules"]:
        errors = np.mean([[s["error"] for s in run["rules"][rule]] for run in runs], axis=0)
        lines.append(f"| {rule} | {' | '.join(f'{error:.3f}' for error in errors)} |")
    return lines


def _text(score: dict[str, Any]) -> str:
    if "failed" in score:
        return "failed"
    place = f"at {score['place']}, " if "place" in score else ""
    return (
        f"{place}error {score['error']:.3f}, r {score['r']:.3f}, {score['lumps']} lumps, "
        f"chi2 {score['chi2']:.2f}, {score['seconds']:.0f} s"
    )


CONTACTS = tuple(
    Contact("finger", "", (x, y, SIDE_MM), (0.0, 0.0, -1.0), SENSOR_MM)
    for x in PLACES_MM
    for y in PLACES_MM
)
FIRST = len(CONTACTS) // 2  # in the middle
SCAN = Presses("scan", CONTACTS, (PRESSURE_MPA,), "z-", 0.25, recorded_per_radius=0.45)

if __name__ == "__main__":
    main()
