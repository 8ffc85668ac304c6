"""Maps against analytic objects whose presses were solved on other, finer meshes.

    python benchmarks/true_objects.py [--set open|held_out|forms|empty|random|all] [--only NAME...]
        [--method default|map|shapes] [--settings KEY=VALUE...] [--check] [--cache FOLDER]
        [--refined FACTOR] [--seeds N] [--out FOLDER] [--resume FOLDER] [--workers N]

Each case is an object (balls of several depths, sizes and contrasts, a cone, an ellipsoid, two
balls close together, a lump in layers, a dome and a breast with a lesion, bodies without
inclusion), its presses (whole sides, round patches, fingers), a noise level and perhaps a fault:
forces of each press wrong by 5 %, or presses misplaced by 0.3 mm. See `true_cases.py`. The
recording that a method inverts has neither truth nor provenance, and its mesh is made from the
outline alone. Settings are the same for all cases.

The map is compared with the analytic object on 36^3 voxels of the bounding box, those outside the
body excluded. Half of the cases are held out, to be run once with `--set held_out`; `--set forms`
has inclusions that are no balls or ellipsoids, `--set empty` forty bodies without inclusion, and
`--set random` 150 balls and ellipsoids, for the coverage of intervals. `--seeds` repeats each case
with other noise. `--check` refines each truth mesh once more and compares the change of the
displacements with the noise. `--refined` bisects the recording's mesh before a method gets it, down
to its mean edge length times the factor. Noise-free
recordings are cached. `--resume` keeps the scores of each case in a folder, and runs only cases
that are not there: use a new folder for each version of the code.

The last line printed is one JSON object.
"""

import argparse
import hashlib
import json
import logging
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from machine import OtherWork, map_in_processes, write_results
from scipy.ndimage import label
from scipy.spatial import cKDTree
from scipy.special import ndtri
from true_cases import CASES, EMPTY_CASES, FORM_CASES, RANDOM_CASES, Case, Truth, make_recording

from tactorch.errors import TactorchError
from tactorch.files import write_json
from tactorch.inverse import Settings, find_lumps, invert_map, make_objective
from tactorch.inverse.posterior import variational_posterior
from tactorch.inverse.search import find_shapes
from tactorch.inverse.search.model import MIN_GAIN
from tactorch.mesh import TetMesh, locate
from tactorch.recording import Recording, refine_recording

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
MAX_CHANGE = 0.1  # of the noise, by refinement of the truth mesh
EXTREME = 0.003  # fraction of the body beyond the level of a lump
MIN_LOG_CONTRAST = np.log(1.02)  # of a segmented lump
MIN_VOXELS = 10  # of a segmented lump
_SEED_STEP = 10_000  # between noise realisations of a case, beyond the seeds of all cases
FieldAt = Callable[[np.ndarray], np.ndarray]  # points (k, 3), mm -> values (k,)


@dataclass(frozen=True)
class FoundLump:
    """A lump that a method reports.

    Attributes:
        center_mm: Centre.
        radius_mm: Radius of the ball of its volume.
        youngs_mpa: Mean modulus.
        probability: Probability that it exists; None if not stated.
        youngs_90_mpa: 90 % interval of its modulus; None if not stated.
        radius_90_mm: The same of its radius.
        center_deviation_mm: Standard deviation of its centre, by axis; None if not stated.
    """

    center_mm: tuple[float, float, float]
    radius_mm: float
    youngs_mpa: float
    probability: float | None = None
    youngs_90_mpa: tuple[float, float] | None = None
    radius_90_mm: tuple[float, float] | None = None
    center_deviation_mm: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a method for one recording.

    Attributes:
        youngs_at: Young's modulus at points of the body, MPa.
        seconds: Elapsed time.
        log_deviation_at: Standard deviation of log E at points; None if not stated.
        lumps: Reported lumps, none of them being an answer too; None if the method reports none.
        notes: Further figures for the JSON line, such as chi2.
    """

    youngs_at: FieldAt
    seconds: float
    log_deviation_at: FieldAt | None = None
    lumps: tuple[FoundLump, ...] | None = None
    notes: Mapping[str, Any] = field(default_factory=dict)


Method = Callable[[Recording, Settings], Answer]


def invert_by_default(recording: Recording, settings: Settings) -> Answer:
    """One modulus per element, its deviation by the variational posterior, and `find_lumps`.

    The time of the posterior is not counted.
    """
    return _invert(recording, settings, with_deviation=True)


def invert_without_deviation(recording: Recording, settings: Settings) -> Answer:
    """As `invert_by_default`, without the posterior."""
    return _invert(recording, settings, with_deviation=False)


def _invert(recording: Recording, settings: Settings, *, with_deviation: bool) -> Answer:
    began = time.perf_counter()
    result = invert_map(recording, settings, show_progress=False)
    seconds = time.perf_counter() - began
    mesh = recording.mesh
    lumps = tuple(
        FoundLump(
            (float(lump.center_mm[0]), float(lump.center_mm[1]), float(lump.center_mm[2])),
            lump.equivalent_radius_mm,
            lump.mean_mpa,
        )
        for lump in find_lumps(mesh, result.youngs)
    )
    last = result.history[-1]
    notes = {"chi2": last["chi2"], "stop_reason": str(result.stop_reason)}
    deviation: FieldAt | None = None
    if not with_deviation:
        return Answer(values_at(mesh, result.youngs), seconds, deviation, lumps, notes)
    print(f"    map after {seconds:.0f} s, now its posterior", file=sys.stderr, flush=True)
    try:
        objective = make_objective(recording, settings)
        point = objective.at(objective.start(result.youngs))
        posterior = variational_posterior(point, last["weight"])
        deviation = values_at(mesh, posterior.deviation())
    except TactorchError as error:
        notes["posterior"] = str(error)
    return Answer(values_at(mesh, result.youngs), seconds, deviation, lumps, notes)


class Decisions(logging.Handler):
    """Decisions of a search for which the reduced model and the full one differ, from its log.

    Attributes:
        found: A sentence on each: a proposal that seemed to have more evidence, or another one that
            had more than the most promising.
    """

    _PROPOSAL = re.compile(r"proposal: (.*), chi2 \S+, log-evidence (\S+)")
    _FITTED = re.compile(r"(.*): chi2 \S+, log-evidence (\S+)")

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._promised: dict[str, float] = {}
        self._fitted: list[tuple[str, float, float]] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a proposal, or the fit of one."""
        text = record.getMessage()
        if match := self._PROPOSAL.fullmatch(text):
            self.finish()
            self._promised[match[1]] = float(match[2])
        elif (match := self._FITTED.fullmatch(text)) and match[1] in self._promised:
            self._fitted.append((match[1], self._promised[match[1]], float(match[2])))

    def finish(self) -> None:
        """Compare the proposals to one model that were fitted, if there are any."""
        if not self._fitted:
            return
        first, best = (max(self._fitted, key=itemgetter(k)) for k in (1, 2))
        for what, promised, gain in self._fitted:
            if gain < MIN_GAIN < promised:
                self.found.append(f"refused: {what} ({promised:+.3g}, {gain:+.3g})")
        if best is not first and best[2] > MIN_GAIN:
            parts = [
                f"{what} ({promised:+.3g}, {gain:+.3g})" for what, promised, gain in (best, first)
            ]
            self.found.append(f"preferred: {parts[0]} to {parts[1]}")
        self._promised, self._fitted = {}, []


def invert_by_shapes(recording: Recording, settings: Settings) -> Answer:
    """Shapes in a smooth background, with their posterior."""
    began, decisions = time.perf_counter(), Decisions()
    log = logging.getLogger("tactorch.inverse.search")
    log.addHandler(decisions)
    log.setLevel(logging.DEBUG)
    result = find_shapes(recording, settings)
    decisions.finish()
    log.removeHandler(decisions)
    seconds = time.perf_counter() - began
    lumps = tuple(
        FoundLump(
            tuple(i.shape.centroid_mm),
            i.shape.radius_mm,
            i.youngs_mpa,
            i.probability,
            i.youngs_90_mpa,
            i.radius_90_mm,
            i.center_deviation_mm,
        )
        for i in result.inclusions
    )
    notes = {
        "chi2": result.chi2,
        "inclusions": [vars(i) | {"shape": vars(i.shape)} for i in result.inclusions],
        "force_deviation": result.force_deviation,
        "pose_deviation": result.pose_deviation,
        "rim_deviation": result.rim_deviation,
        "degree": result.field.background.degree,
        "history": result.history,
        "decisions": decisions.found,
    }
    return Answer(result.youngs_at, seconds, result.log_deviation_at, lumps, notes)


METHODS: dict[str, Method] = {
    "shapes": invert_by_shapes,
    "default": invert_by_default,
    "map": invert_without_deviation,
}


def values_at(mesh: TetMesh, values: np.ndarray) -> FieldAt:
    """Return the field of element values: the containing element's, or outside the nearest's."""

    def at(points: np.ndarray) -> np.ndarray:
        elements = locate(mesh, points)
        outside = elements < 0
        if outside.any():
            elements[outside] = cKDTree(mesh.centroids).query(points[outside])[1]
        return np.asarray(values[elements])

    return at


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases, and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--set", choices=("open", "held_out", "forms", "empty", "random", "all"), default="open"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="cases of any set by name")
    parser.add_argument("--method", choices=list(METHODS), default="default")
    parser.add_argument("--settings", nargs="+", default=[], metavar="KEY=VALUE")
    parser.add_argument(
        "--refined", type=float, metavar="FACTOR", help="edge length over the recording's"
    )
    parser.add_argument("--seeds", type=int, default=1, help="noise realisations of each case")
    parser.add_argument("--check", action="store_true", help="check the truth meshes instead")
    parser.add_argument("--list", action="store_true", help="list the cases and stop")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--out", type=Path, help="folder for true_objects[_SET].json and .md")
    parser.add_argument("--resume", type=Path, help="folder of the scores of finished cases")
    options = parser.parse_args(arguments)
    cases = with_seeds(choose_cases(options.set, options.only), options.seeds)
    if options.list:
        print("\n".join(case.name for case in cases))
        return
    if options.check:
        check(cases, options.cache, options.out)
        return
    settings = Settings.from_mapping(parse_settings(options.settings))
    method, meter, results, lines = METHODS[options.method], OtherWork(), {}, [_HEADER]
    print(_HEADER, flush=True)
    try:
        work = partial(
            run, method=method, settings=settings, cache=options.cache, refined=options.refined
        )
        if options.resume is not None:
            setup = (options.method, options.settings, options.refined)
            work = partial(run_once, work=work, folder=options.resume, setup=setup)
        for case, scores in zip(cases, map_in_processes(work, cases, options.workers), strict=True):
            results[case.name] = scores
            lines.append(_row(case.name, scores))
            print(lines[-1], flush=True)
    except (KeyboardInterrupt, BrokenProcessPool):  # the latter where a worker is killed
        print("Interrupted; the result has the cases up to here.", file=sys.stderr)
    summary = summarize(results)
    further = ["", *_describe(summary), *_decisions(results)]
    lines += further
    print("\n".join(further))
    load = meter.share()
    result = {
        "cases": results,
        **summary,
        "method": options.method,
        "settings": options.settings,
        "refined": options.refined,
        "set": options.set,
        "only": options.only,
        "seeds": options.seeds,
        "workers": options.workers,
        "other_work": load,
    }
    if options.out is not None:
        name = "true_objects" if options.set == "open" else f"true_objects_{options.set}"
        write_results(options.out, name, lines, result, PACKAGES)
    print(json.dumps(result))


def choose_cases(chosen_set: str, only: Sequence[str] | None) -> list[Case]:
    """Return the cases of a set, or those named."""
    every = [*CASES, *FORM_CASES, *EMPTY_CASES, *RANDOM_CASES]
    if only:
        known = {case.name: case for case in every}
        unknown = [name for name in only if name not in known]
        if unknown:
            raise SystemExit(f"unknown case {unknown[0]}; choose from {', '.join(known)}.")
        return [known[name] for name in only]
    others = {"forms": FORM_CASES, "empty": EMPTY_CASES, "random": RANDOM_CASES}
    if chosen_set in others:
        return list(others[chosen_set])
    return [
        case for case in CASES if chosen_set == "all" or case.held_out == (chosen_set == "held_out")
    ]


def with_seeds(cases: Sequence[Case], count: int) -> list[Case]:
    """Return each case with its own seed of the noise and `count - 1` others."""
    return [replace(case, seed=case.seed + _SEED_STEP * k) for case in cases for k in range(count)]


def parse_settings(assignments: Sequence[str]) -> dict[str, Any]:
    """Return KEY=VALUE assignments (a dotted key is nested, a value JSON or text) as a table."""
    table: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise SystemExit(f"--settings {assignment}: give KEY=VALUE.")
        try:
            value: Any = json.loads(text)
        except ValueError:
            value = text
        *groups, name = key.split(".")
        inner = table
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[name] = value
    return table


def run(
    case: Case,
    method: Method,
    settings: Settings,
    cache: Path | None,
    refined: float | None = None,
) -> dict[str, Any]:
    """Invert a case's recording and score the answer; a failure is recorded as such.

    With `refined`, its mesh is bisected down to its mean edge length times this factor.
    """
    print(f"{case.name} ...", file=sys.stderr, flush=True)
    recording = make_recording(case, cache)
    if refined is not None:
        ends = recording.mesh.points[recording.mesh.edges]
        edge_mm = refined * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())
        recording = refine_recording(recording, lambda points: np.full(len(points), edge_mm))
    began = time.perf_counter()
    try:
        answer = method(recording, settings)
    except TactorchError as error:
        return {"error": str(error), "seconds": time.perf_counter() - began}
    scores = score(Truth.of(case.body), answer)
    # The table has the cases in order: a long one would hide those that have ended.
    print(_row(case.name, scores), file=sys.stderr, flush=True)
    return scores


def run_once(
    case: Case, *, work: Callable[[Case], dict[str, Any]], folder: Path, setup: tuple[Any, ...]
) -> dict[str, Any]:
    """Return the scores that an earlier run left in the folder, or run the case and leave them.

    Args:
        case: The case.
        work: Computes its scores.
        folder: Has a file for each finished case.
        setup: Method, settings and refinement; the scores of another setup are other files.
    """
    digest = hashlib.sha256(repr((case, setup)).encode()).hexdigest()[:12]
    path = folder / f"{case.name}-{digest}.json"
    if path.exists():
        print(f"{case.name}: from {path}", file=sys.stderr, flush=True)
        return dict(json.loads(path.read_text(encoding="utf-8")))
    scores = work(case)
    write_json(path, scores)
    return scores


def score(truth: Truth, answer: Answer) -> dict[str, Any]:
    """Return the scores of an answer; None where a score does not apply.

    - `r`: Pearson correlation of the moduli over the voxels.
    - `rmse_log`: root mean square error of the natural logarithm of the modulus.
    - `contrast`: mean modulus inside the lumps less the median outside, over the same of the truth.
    - `modulus_inside_mpa`: mean estimate inside the true lumps; `true_modulus_inside_mpa`.
    - `dice`: overlap of the segmented voxels with the true lumps, 2 |A n B| / (|A| + |B|). The
      segmentation (`segment`) uses no truth.
    - `position_mm`: distance of each true lump's centroid to that of the nearest segmented part;
      mean over the lumps.
    - `size_ratio`: cube root of the volume of those parts over that of the true lumps.
    - `covered_50_inside`, `covered_90_outside`, ...: fraction of the voxels whose true log-modulus
      is within the stated central interval of 50 or 90 %, inside and outside the lumps.
    - `segmented_contrast`: level of the segmented lump over the background, in the map.
    - `lumps_reported`: number of lumps in the answer; `reported_position_mm`: as `position_mm`, of
      the reported centres.
    - `modulus_covered`, `size_covered`, `position_covered`: fraction of the true lumps whose
      modulus and radius are within the 90 % intervals of the nearest reported lump, and of the
      coordinates of their centres that are within its 90 % intervals.
    - `seconds`, and the method's own notes.
    """
    youngs = np.asarray(answer.youngs_at(truth.points), dtype=float)
    log_error = np.log(youngs) - np.log(truth.youngs)
    inside = truth.lumps > 0
    mask, segmented_contrast = segment(youngs)
    scores: dict[str, Any] = {
        "r": _pearson(youngs, truth.youngs),
        "rmse_log": float(np.sqrt(np.mean(log_error**2))),
        "contrast": None,
        "modulus_inside_mpa": None,
        "true_modulus_inside_mpa": None,
        "dice": None,
        "position_mm": None,
        "size_ratio": None,
        "segmented_contrast": segmented_contrast,
        "seconds": float(answer.seconds),
        "lumps_reported": None if answer.lumps is None else len(answer.lumps),
        "reported_position_mm": None,
        "modulus_covered": None,
        "size_covered": None,
        "position_covered": None,
        **_coverage(truth, answer, log_error, inside),
        **answer.notes,
    }
    if not inside.any():
        return scores
    centers = np.array([truth.points[truth.lumps == k].mean(axis=0)
                        for k in range(1, truth.lumps.max() + 1)])  # fmt: skip
    differences = [
        float(values[inside].mean() - np.median(values[~inside]))
        for values in (youngs, truth.youngs)
    ]
    scores["contrast"] = differences[0] / differences[1]
    scores["modulus_inside_mpa"] = float(youngs[inside].mean())
    scores["true_modulus_inside_mpa"] = float(truth.youngs[inside].mean())
    scores["dice"] = float(2 * (mask & inside).sum() / (mask.sum() + inside.sum()))
    parts = _parts(truth, mask)
    if parts:
        part_centers = np.array([truth.points[part].mean(axis=0) for part in parts])
        distances, nearest = cKDTree(part_centers).query(centers)
        volume = sum(int(parts[k].sum()) for k in set(nearest.tolist()))
        scores["position_mm"] = float(distances.mean())
        scores["size_ratio"] = float(np.cbrt(volume / inside.sum()))
    if answer.lumps:
        reported = cKDTree(np.array([lump.center_mm for lump in answer.lumps]))
        distances, nearest = reported.query(centers)
        scores["reported_position_mm"] = float(distances.mean())
        scores |= _interval_coverage(truth, centers, [answer.lumps[k] for k in nearest])
    return scores


def _interval_coverage(
    truth: Truth, centers: np.ndarray, reported: Sequence[FoundLump]
) -> dict[str, float]:
    """Fractions of lumps, or of coordinates of their centres, within the stated intervals."""
    covered: dict[str, list[bool]] = {"modulus": [], "size": [], "position": []}
    for k, lump in enumerate(reported):
        for name, interval, value in (
            ("modulus", lump.youngs_90_mpa, truth.lump_moduli_mpa[k]),
            ("size", lump.radius_90_mm, truth.lump_radii_mm[k]),
        ):
            if interval is not None:
                covered[name].append(bool(interval[0] <= value <= interval[1]))
        if lump.center_deviation_mm is not None:
            error = np.abs(centers[k] - lump.center_mm)
            covered["position"] += list(error <= ndtri(0.95) * np.array(lump.center_deviation_mm))
    return {f"{name}_covered": float(np.mean(values)) for name, values in covered.items() if values}


def segment(youngs: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the voxels of the lumps of a map, and the lumps' level over the background.

    In log E, the background is the median, and a lump's level the value that 0.3 % of the voxels
    exceed, on the side where it is farther from the background. The lumps are the voxels past half
    way; none where the level is within 2 % of the background.
    """
    values = np.log(youngs)
    background = float(np.median(values))
    low, high = np.quantile(values, [EXTREME, 1.0 - EXTREME])
    stiff = high - background >= background - low
    level = float(high if stiff else low)
    contrast = float(np.exp(level - background))
    if abs(level - background) < MIN_LOG_CONTRAST:
        return np.zeros(len(values), dtype=bool), contrast
    half_way = (background + level) / 2
    return (values > half_way) if stiff else (values < half_way), contrast


def _parts(truth: Truth, mask: np.ndarray) -> list[np.ndarray]:
    """Masks of the face-connected parts, without those of few voxels."""
    grid = np.zeros((truth.count,) * 3, dtype=bool)
    grid[tuple(truth.index[mask].T)] = True
    labels, count = label(grid)
    own = labels[tuple(truth.index.T)]
    parts = [own == k for k in range(1, count + 1)]
    return [part for part in parts if part.sum() >= MIN_VOXELS]


def _coverage(
    truth: Truth, answer: Answer, log_error: np.ndarray, inside: np.ndarray
) -> dict[str, float | None]:
    """Fractions of the voxels whose truth is within the stated intervals."""
    names = [(level, where) for level in (50, 90) for where in ("inside", "outside")]
    if answer.log_deviation_at is None:
        return {f"covered_{level}_{where}": None for level, where in names}
    deviation = np.asarray(answer.log_deviation_at(truth.points))
    covered = {}
    for level, where in names:
        within = np.abs(log_error) <= ndtri(0.5 + level / 200.0) * deviation
        chosen = within[inside if where == "inside" else ~inside]
        covered[f"covered_{level}_{where}"] = float(chosen.mean()) if len(chosen) else None
    return covered


def _pearson(first: np.ndarray, second: np.ndarray) -> float | None:
    """Correlation; None where one of the fields is uniform."""
    if min(np.ptp(first) / np.abs(first).max(), np.ptp(second) / np.abs(second).max()) < 1e-9:
        return None
    return float(np.corrcoef(first, second)[0, 1])


_SUMMARIZED = (
    "r",
    "rmse_log",
    "contrast",
    "dice",
    "position_mm",
    "size_ratio",
    "covered_50_inside",
    "covered_90_inside",
    "covered_50_outside",
    "covered_90_outside",
    "seconds",
)
_FREQUENCIES = ("modulus_covered", "size_covered", "position_covered")  # fmt: skip


def summarize(results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return medians over the cases with lumps, by noise level too, and the false lumps.

    A score that is missing in a case (nothing segmented) is left out of its median; `missed` counts
    the cases in which nothing was segmented, and `failed` those without an answer.
    """
    answered = {name: scores for name, scores in results.items() if "error" not in scores}
    lumpy = {n: s for n, s in answered.items() if s["true_modulus_inside_mpa"] is not None}
    empty = [s for n, s in answered.items() if n not in lumpy]
    levels = sorted({_level(name) for name in lumpy})
    return {
        "median": _medians(lumpy.values()),
        "median_by_noise": {
            level: _medians([s for n, s in lumpy.items() if _level(n) == level]) for level in levels
        },
        "covered_at_90": _frequencies(lumpy.values()),
        "missed": sum(scores["position_mm"] is None for scores in lumpy.values()),
        "empty_bodies": len(empty),
        "empty_bodies_with_lump": sum(bool(scores["lumps_reported"]) for scores in empty),
        "failed": len(results) - len(answered),
    }


def _level(name: str) -> str:
    return next(part for part in name.split("-") if part.endswith("db"))


def _medians(scores: Any) -> dict[str, float | None]:
    rows, medians = list(scores), {}
    for key in _SUMMARIZED:
        values = [row[key] for row in rows if row[key] is not None]
        medians[key] = float(np.median(values)) if values else None
    return medians


def _frequencies(rows: Any) -> dict[str, float | None]:
    """Means over the cases of the frequencies with which intervals cover the truth."""
    found = list(rows)
    means = {}
    for key in _FREQUENCIES:
        values = [row[key] for row in found if row[key] is not None]
        means[key] = float(np.mean(values)) if values else None
    return means


_COLUMNS = {
    "r": "r",
    "rmse_log": "RMSE log E",
    "contrast": "contrast",
    "modulus_inside_mpa": "E inside",
    "true_modulus_inside_mpa": "true",
    "dice": "Dice",
    "position_mm": "position mm",
    "size_ratio": "size",
    "covered_50_inside": "50 % in",
    "covered_90_inside": "90 % in",
    "covered_50_outside": "50 % out",
    "covered_90_outside": "90 % out",
    "modulus_covered": "E 90 %",
    "size_covered": "size 90 %",
    "position_covered": "place 90 %",
    "lumps_reported": "lumps",
    "chi2": "chi2",
    "seconds": "s",
}
_HEADER = f"| case | {' | '.join(_COLUMNS.values())} |\n|{'---|' * (len(_COLUMNS) + 1)}"


def _row(name: str, scores: Mapping[str, Any]) -> str:
    if "error" in scores:
        return f"| {name} | failed: {scores['error']} |"
    cells = [_format(scores.get(key)) for key in _COLUMNS]
    return f"| {name} | {' | '.join(cells)} |"


def _format(value: Any) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3g}"


def _describe(summary: Mapping[str, Any]) -> list[str]:
    """Lines of the summary, one for each of its entries."""
    lines = []
    for key, value in summary.items():
        if key == "median_by_noise":
            cells = [f"{noise}: " + _list(medians) for noise, medians in value.items()]
            lines.append("Medians by noise: " + "; ".join(cells))
        else:
            text = _list(value) if isinstance(value, dict) else str(value)
            lines.append(f"{key.replace('_', ' ').capitalize()}: {text}")
    return lines


def _decisions(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a table of decisions of the full model that differ from those of the reduced one."""
    rows = [
        f"| {name} | {text} |"
        for name, scores in results.items()
        for text in scores.get("decisions", ())
    ]
    if not rows:
        return []
    head = "| case | decision otherwise (gain of log-evidence by the reduced and the full model) |"
    return ["", head, "|---|---|", *rows]


def _list(medians: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_format(value)}" for key, value in medians.items())


def check(cases: Sequence[Case], cache: Path | None, out: Path | None) -> None:
    """Refine the truth mesh of each case once more; print the change relative to the noise."""
    columns = ("case", "elements", "refined", "change / signal", "change / noise", "")
    lines = [f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}"]
    print(lines[0])
    changes: dict[Any, dict[str, Any]] = {}
    report: dict[str, Any] = {}
    try:
        for case in cases:
            if case.solution not in changes:
                changes[case.solution] = case.solution.check(cache)
            change = changes[case.solution]
            ratio = change["change"] * 10.0 ** (case.snr_db / 20.0)
            report[case.name] = {**change, "over_noise": ratio, "fine": ratio < MAX_CHANGE}
            verdict = "" if ratio < MAX_CHANGE else "above a tenth"
            lines.append(
                f"| {case.name} | {change['elements']} | {change['refined_elements']} |"
                f" {change['change']:.2e} | {ratio:.3f} | {verdict} |"
            )
            print(lines[-1], flush=True)
    except (KeyboardInterrupt, BrokenProcessPool):  # the latter where a worker is killed
        print("Interrupted; the result has the cases up to here.", file=sys.stderr)
    if out is not None:
        write_results(out, "true_objects_check", lines, {"cases": report}, PACKAGES)
    print(json.dumps({"cases": report}))


if __name__ == "__main__":
    main()
