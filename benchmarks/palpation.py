"""Palpation by a robot: forces at places that were left out, by the map and by Gaussian processes.

    python benchmarks/palpation.py FILE.csv... [--sparse] [--out FOLDER]

Each FILE is a palpation (`tactorch import format=palpation`). Every fifth probe is left out; with
--sparse only every fifth is kept. The map is that of `tactorch invert` with default settings for
the probes that are kept, on a block below their contacts. Its prediction for a probe that is left
out takes the robot's contact point and the depths from there: the ball is as deep at the first
sample as gives the mean first force of the other probes.

The usual way is a Gaussian process of stiffness over the surface (scikit-learn, a Matern kernel and
noise, hyperparameters by maximum likelihood), by which the force at a depth is that of a spring or
of a ball in a half-space; or one process of the force at each step. The best of the three, by the
same errors, is what the map is compared with. "map, residuals" is the map's prediction times such a
process of its relative errors. The last line printed is one JSON object.
"""

import argparse
import csv
import json
import tempfile
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactorch.fem import Supports
from tactorch.fem.contact.pressures import ball_force
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.importers import import_palpation
from tactorch.inverse import Settings, invert_map
from tactorch.inverse.fit.starts import homogeneous
from tactorch.inverse.forward.palpation import PALPATION_ELEMENT
from tactorch.inverse.forward.problem import make_body
from tactorch.mesh.closest import closest_points
from tactorch.recording import Recording

_FOLD = 5
_FIRST_DEPTHS = np.linspace(0.0, 3.0, 301)  # of a ball at the first sample, mm
_MIN_SAMPLES = 4


@dataclass(frozen=True)
class Probe:
    """One probe: contact, normal, and forces along the normal at depths from the contact."""

    contact: np.ndarray
    normal: np.ndarray
    depths: np.ndarray
    forces: np.ndarray
    steps: np.ndarray


def read_probes(path: Path, radius: float) -> dict[int, Probe]:
    """Read the probes of a file that have a normal and enough samples."""
    rows: dict[int, list[dict[str, float]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            values = {name: float(value) for name, value in row.items()}
            rows.setdefault(int(values["probe"]), []).append(values)
    probes = {}
    for number, samples in rows.items():
        contact = np.array([samples[0][f"contact_{axis}_mm"] for axis in "xyz"])
        normal = np.array([samples[0][f"normal_{axis}"] for axis in "xyz"])
        centres = np.array([[s[f"{axis}_mm"] for axis in "xyz"] for s in samples])
        forces = np.array([[s[f"f{axis}_n"] for axis in "xyz"] for s in samples])
        length = np.linalg.norm(normal)
        if len(samples) < _MIN_SAMPLES or length < 0.8 or np.ptp(centres, axis=0).max() < 0.2:
            continue
        normal = normal / length
        depths = radius - (centres - contact) @ normal
        steps = np.array([s["step"] for s in samples]).astype(int)
        probes[number] = Probe(contact, normal, depths, forces @ normal, steps)
    return probes


def write_subset(path: Path, kept: set[int], out: Path) -> Path:
    """Write the rows of some probes."""
    lines = path.read_text().splitlines()
    rows = [line for line in lines[1:] if int(float(line.split(",")[0])) in kept]
    out.write_text("\n".join([lines[0], *rows]) + "\n")
    return out


def by_map(recording: Recording, youngs: np.ndarray, probes: Sequence[Probe], first_n: float):
    """Predict the forces of probes by a map."""
    body = make_body(recording, PALPATION_ELEMENT, "auto", None)
    press = recording.presses[0]
    mesh, ball = recording.mesh, recording.provenance["ball_radius_mm"]
    contacts = np.array([probe.contact for probe in probes])
    closest = closest_points(mesh.points, mesh.surface.triangles, contacts)
    places = [
        BallPlace(point, probe.normal, ball, float(probe.depths.max()) + 0.5)
        for point, probe in zip(closest.points, probes, strict=True)
    ]
    supports = Supports(press.fixed, press.prescribed, press.springs)
    indented = Indentation(body, supports, places).at(youngs)
    count = len(_FIRST_DEPTHS)
    curve = indented.press(
        np.repeat(np.arange(len(places)), count), np.tile(_FIRST_DEPTHS, len(places))
    ).force_n.reshape(-1, count)
    predictions = []
    for i, probe in enumerate(probes):
        start = float(np.interp(first_n, np.maximum.accumulate(curve[i]), _FIRST_DEPTHS))
        depths = start + probe.depths - probe.depths[0]
        here = np.full(len(depths), i)
        predictions.append(indented.press(here, depths).force_n)
    return predictions


def process(where: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Predict by a Gaussian process over the surface."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    kernel = ConstantKernel(1.0) * Matern([5.0, 5.0], (1.0, 100.0), nu=2.5) + WhiteKernel(0.1)
    model = GaussianProcessRegressor(
        kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0
    )
    with warnings.catch_warnings():  # of lengths at their limits, where values hardly vary
        warnings.simplefilter("ignore", ConvergenceWarning)
        return model.fit(where, values).predict(wanted)


def with_residuals(
    predicted: Sequence[np.ndarray], train: Sequence[Probe], test: Sequence[Probe]
) -> list[np.ndarray]:
    """Predict by the map, times a Gaussian process of its relative errors (regression kriging).

    `predicted` are the forces that the map predicts, of the probes that are kept and of the others.
    """
    factors = [float(p.forces @ s) / float(s @ s) for p, s in zip(train, predicted, strict=False)]
    where = np.array([probe.contact[:2] for probe in train])
    wanted = np.array([probe.contact[:2] for probe in test])
    changes = np.exp(process(where, np.log(np.maximum(factors, 1e-2)), wanted))
    return [c * s for c, s in zip(changes, predicted[len(train) :], strict=True)]


def by_processes(train: Sequence[Probe], test: Sequence[Probe], radius: float, first_n: float):
    """Predict the forces of probes by Gaussian processes: name -> forces of each probe."""
    where = np.array([probe.contact[:2] for probe in train])
    wanted = np.array([probe.contact[:2] for probe in test])

    def slope(shape) -> np.ndarray:
        return np.array([
            float(s @ (p.forces - first_n * (shape is spring))) / float(s @ s)
            for p in train
            for s in [shape(p)]
        ])  # fmt: skip

    def spring(probe: Probe) -> np.ndarray:
        return probe.depths - probe.depths[0]

    stiffness = process(where, np.log(np.maximum(slope(spring), 1e-3)), wanted)
    springs = [first_n + np.exp(k) * spring(p) for k, p in zip(stiffness, test, strict=True)]

    # The ball is as deep at the first sample as fits the probes best on the whole.
    def error(start: float) -> float:
        total = 0.0
        for p in train:
            b = ball_force(start + p.depths - p.depths[0], radius)
            total += float(p.forces @ p.forces - (b @ p.forces) ** 2 / (b @ b))
        return total

    start = min(np.linspace(0.05, 1.5, 30), key=error)

    def hertz(probe: Probe) -> np.ndarray:
        return ball_force(start + probe.depths - probe.depths[0], radius)

    moduli = process(where, np.log(np.maximum(slope(hertz), 1e-4)), wanted)
    balls = [np.exp(k) * hertz(p) for k, p in zip(moduli, test, strict=True)]

    steps = sorted({int(s) for p in test for s in p.steps})
    each = [np.full(len(p.steps), np.nan) for p in test]
    for step in steps:
        have = [(p, p.forces[p.steps == step]) for p in train if (p.steps == step).any()]
        at = np.array([p.contact[:2] for p, _ in have])
        values = np.array([float(f[0]) for _, f in have])
        predicted = process(at, values, wanted)
        for forces, probe, value in zip(each, test, predicted, strict=True):
            forces[probe.steps == step] = value
    return {"spring": springs, "half-space": balls, "force at each step": each}


def errors(test: Sequence[Probe], predicted: Sequence[np.ndarray]) -> dict[str, object]:
    """Errors of forces: root mean square and mean size, over all and at each step."""
    steps = np.concatenate([p.steps for p in test])
    wrong = np.concatenate(predicted) - np.concatenate([p.forces for p in test])
    by_step = {int(s): float(np.sqrt(np.mean(wrong[steps == s] ** 2))) for s in np.unique(steps)}
    return {
        "rms_n": float(np.sqrt(np.mean(wrong**2))),
        "mean_n": float(np.mean(np.abs(wrong))),
        "median_n": float(np.median(np.abs(wrong))),
        "by_step_n": by_step,
    }


def run(path: Path, *, sparse: bool, max_seconds: float | None) -> dict[str, object]:
    """Return the errors of the map and of the processes for one file."""
    numbers = sorted(read_probes(path, 1.0))
    chosen = set(numbers[::_FOLD])
    kept = chosen if sparse else set(numbers) - chosen
    with tempfile.TemporaryDirectory() as folder:
        recording = import_palpation(write_subset(path, kept, Path(folder) / path.name))
    radius = recording.provenance["ball_radius_mm"]
    probes = read_probes(path, radius)
    train = [probes[n] for n in numbers if n in kept]
    test = [probes[n] for n in numbers if n not in kept]
    first = float(np.mean([p.forces[0] for p in train]))
    began = time.perf_counter()
    result = invert_map(recording, Settings(max_seconds=max_seconds), start_mpa=homogeneous)
    seconds = time.perf_counter() - began
    predicted = by_map(recording, result.youngs, [*train, *test], first)
    methods = {
        "map": predicted[len(train) :],
        "map, residuals": with_residuals(predicted, train, test),
    }
    methods |= by_processes(train, test, radius, first)
    scores = {name: errors(test, predicted) for name, predicted in methods.items()}
    best = min(scores.keys() - {"map", "map, residuals"}, key=lambda name: scores[name]["rms_n"])
    return {
        "kept": len(train), "left_out": len(test), "seconds": seconds,
        "chi2": result.history[-1]["chi2"], "best_process": best, "errors": scores,
    }  # fmt: skip


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--sparse", action="store_true", help="keep every fifth probe only")
    parser.add_argument("--max-seconds", type=float, default=None)
    parser.add_argument("--out", type=Path, help="folder for palpation.json and .md")
    arguments = parser.parse_args()
    results, lines = {}, []
    header = "| file | probes kept, left out | method | rms, N | mean, N | median, N |"
    lines = [header, "|---|---|---|---|---|---|"]
    print("\n".join(lines))
    for path in arguments.files:
        name = f"{path.stem}, sparse" if arguments.sparse else path.stem
        found = run(path, sparse=arguments.sparse, max_seconds=arguments.max_seconds)
        results[name] = found
        for method, score in found["errors"].items():
            line = (
                f"| {name} | {found['kept']}, {found['left_out']} | {method} "
                f"| {score['rms_n']:.4f} | {score['mean_n']:.4f} | {score['median_n']:.4f} |"
            )
            lines.append(line)
            print(line, flush=True)
    text = json.dumps(results)
    if arguments.out is not None:
        suffix = "_sparse" if arguments.sparse else ""
        (arguments.out / f"palpation{suffix}.md").write_text("\n".join(lines) + "\n")
        (arguments.out / f"palpation{suffix}.json").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
