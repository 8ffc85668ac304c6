"""Total contact force on a gel: exact solutions, fine simulations and `GelModel`.

    python benchmarks/gel_contact.py [--quick] [--gel-mesh FOLDER] [--out FOLDER]

A rigid punch and a rigid sphere are pressed without friction on gels: one with the published
outline and material of the GelSight Mini, a thick gel, and the paper's finger. Small presses are
compared with the exact solution for a bonded layer of the same thickness, and with the half space
(Hertz) on a very thick gel; a deep press without slip has only a fine simulation. The displacement
of the face in the fine simulation is interpolated and given to `GelModel` on another, coarser mesh:
without noise, and with noise of 1 % of its largest value (ten seeds on the usual mesh of the Mini,
three elsewhere). Then the modulus of the gel is estimated from the forces of the fine simulations.
--gel-mesh names a folder with the published mesh of the GelSight Mini's gel, which is curved and
rounded: it is used in the fine simulation, and `GelModel` assumes a flat gel. The last line printed
is one JSON object.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from indentation import FineGel, Indenter, Pressed, fine_gel, published_gel
from layer_contact import Layer, flat_punch, half_space_punch_n, hertz_n, sphere
from machine import OtherWork, write_results

from tactorch.sensor.calibration import KnownLoad, calibrate_modulus
from tactorch.sensor.description import GelLayer, load_sensor
from tactorch.sensor.gel import GelModel, GelOptions

PACKAGES = ("tactorch", "numpy", "scipy", "pypardiso", "mkl")
MINI, FINGER = load_sensor("gelsight_mini").gel, load_sensor("finger").gel
DEEP = GelLayer(100.0, 0.435, 0.45, size_mm=(250.0, 250.0))  # a half space to 2.5 mm
THICK = GelLayer(20.0, 0.435, 0.45, size_mm=(60.0, 60.0))
NOISE = 0.01  # of the largest displacement
AROUND_MM = 0.7  # margin of the assumed contact region


@dataclass(frozen=True)
class Case:
    """A press.

    Attributes:
        name: Name of the gel.
        gel: The gel.
        indenter: Rigid indenter.
        depth_mm: Depth of the press.
        slips: Whether the contact is without friction.
        cells: Edge (mm) and layers of the cells of the model; None to evaluate only the simulation.
        exact: Whether the press is small enough for the exact solution.
    """

    name: str
    gel: GelLayer
    indenter: Indenter
    depth_mm: float
    slips: bool = True
    cells: tuple[float, int] | None = (1.0, 4)
    exact: bool = True

    @property
    def layer(self) -> Layer:
        """The gel as a layer without end."""
        gel = self.gel
        return Layer(float(gel.thickness_mm), float(gel.youngs_mpa), float(gel.poisson))

    @property
    def contact_mm(self) -> float:
        """Radius of the contact by the exact solution."""
        if self.indenter.punch_mm is not None:
            return self.indenter.punch_mm
        assert self.indenter.sphere_mm is not None
        return sphere(self.layer, self.indenter.sphere_mm, self.depth_mm).radius_mm

    def forces_n(self) -> tuple[float, float]:
        """Force by the half space's formula, and by the exact solution for the layer."""
        punch, ball = self.indenter.punch_mm, self.indenter.sphere_mm
        if punch is not None:
            exact = flat_punch(self.layer, punch, self.depth_mm).force_n
            return half_space_punch_n(self.layer, punch, self.depth_mm), exact
        assert ball is not None
        exact = sphere(self.layer, ball, self.depth_mm).force_n
        return hertz_n(self.layer, ball, self.depth_mm), exact


CASES = (
    Case("half space", DEEP, Indenter(punch_mm=2.5), 0.05, cells=None),
    Case("half space", DEEP, Indenter(sphere_mm=30.0), 0.2, cells=None),
    Case("thick", THICK, Indenter(punch_mm=6.0), 0.1, cells=(3.0, 4)),
    Case("thick", THICK, Indenter(sphere_mm=80.0), 0.5, cells=(3.0, 4)),
    Case("mini", MINI, Indenter(punch_mm=3.0), 0.06),
    Case("mini", MINI, Indenter(sphere_mm=15.0), 0.25),
    Case("finger", FINGER, Indenter(sphere_mm=15.0), 0.3, cells=(1.5, 3)),
    Case("mini", MINI, Indenter(sphere_mm=10.0), 0.6, slips=False, exact=False),
)
QUICK = (
    Case("mini", MINI, Indenter(punch_mm=3.0), 0.06, cells=(1.5, 2)),
    Case("mini", MINI, Indenter(sphere_mm=15.0), 0.25, cells=(1.5, 2)),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two cases on coarse meshes")
    parser.add_argument("--gel-mesh", type=Path, help="folder of the published gel's mesh")
    parser.add_argument("--out", type=Path, help="folder for gel_contact.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    few = range(3)
    models: dict[Any, GelModel] = {}
    rows, loads = [], []
    for case in QUICK if options.quick else CASES:
        pressed = simulated(case, 0.6 if options.quick else 0.75 if case.gel is DEEP else 1.0)
        usual = case.gel is MINI and case.exact and not options.quick
        rows.append(judged(case, pressed, models, range(10) if usual else few))
        print(f"{case.name}, {rows[-1]['indenter']}: done", file=sys.stderr, flush=True)
        if case.gel is MINI and case.exact:
            loads.append((case, pressed))
    if options.gel_mesh is not None:
        case = replace(CASES[5], name="mini, curved", exact=False)
        gel = published_gel(options.gel_mesh, float(MINI.youngs_mpa), float(MINI.poisson))
        rows.append(judged(case, pressed_on(gel, case), models, few))
    result = {"cases": rows, "modulus": calibrated(loads, models)}
    lines = format_tables(result)
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write_results(options.out, "gel_contact", lines, result, PACKAGES)
    print(json.dumps(result))


def simulated(case: Case, fineness: float) -> Pressed:
    """Press on a fine mesh."""
    sharp = case.indenter.punch_mm is not None or not case.slips
    return pressed_on(fine_gel(case.gel, case.contact_mm, fineness, sharp=sharp), case)


def pressed_on(gel: FineGel, case: Case) -> Pressed:
    """Press on a given mesh."""
    return gel.press(case.indenter, case.depth_mm, slips=case.slips)


def judged(
    case: Case, pressed: Pressed, models: dict[Any, GelModel], seeds: range
) -> dict[str, Any]:
    """Hold simulation and model against the exact solution and each other."""
    half_space, exact = case.forces_n()
    fine = -float(pressed.force_n[2])
    row: dict[str, Any] = {
        "gel": case.name,
        "indenter": "punch" if case.indenter.punch_mm is not None else "sphere",
        "size_mm": case.indenter.punch_mm or case.indenter.sphere_mm,
        "depth_mm": case.depth_mm,
        "slips": case.slips,
        "contact_mm": pressed.edge_mm,
        "half_space_n": half_space if case.exact else None,
        "exact_n": exact if case.exact else None,
        "fine_n": fine,
        "fine_off": fine / exact - 1.0 if case.exact else None,
    }
    if case.cells is None:
        return row
    model = model_of(case, models)
    moved, touched = pressed.at(model.points[:, :2]), touching(model, pressed)
    noise = NOISE * float(np.abs(moved).max())
    direct = model.forces(moved, noise)
    clean = model.smooth_forces(moved, 0.01 * noise, touched)
    noisy, scores = [], []
    for seed in seeds:
        errors = np.random.default_rng(seed).normal(0.0, noise, moved.shape)
        found = model.smooth_forces(moved + errors, noise, touched)
        assert found.covariance is not None
        noisy.append(-found.total[2])
        scores.append(float(-found.total[2] + clean.total[2]) / found.covariance[2, 2] ** 0.5)
    other = model.forces(moved + errors)
    assert direct.covariance is not None
    return row | {
        "noise_mm": noise,
        "direct_off": -float(direct.total[2]) / fine - 1.0,
        "direct_noisy_off": -float(other.total[2]) / fine - 1.0,
        "direct_deviation": float(direct.covariance[2, 2]) ** 0.5 / fine,
        "smooth_off": -float(clean.total[2]) / fine - 1.0,
        "noisy_mean_off": float(np.mean(noisy)) / fine - 1.0,
        "noisy_worst_off": float(max(abs(np.array(noisy) / fine - 1.0))),
        "noisy_deviation": float(np.std(noisy)) / fine,
        "noisy_score": float(np.sqrt(np.mean(np.square(scores)))),
    }


def model_of(case: Case, models: dict[Any, GelModel]) -> GelModel:
    """The model of a case's gel, made once."""
    assert case.cells is not None
    key = (case.gel, case.cells)
    if key not in models:
        models[key] = GelModel(case.gel, GelOptions(*case.cells))
    return models[key]


def touching(model: GelModel, pressed: Pressed) -> np.ndarray:
    """Nodes of a model that a sensor would take for touched."""
    reach = pressed.edge_mm + max(AROUND_MM, 0.5 * _spacing(model))
    return np.linalg.norm(model.points[:, :2], axis=1) < reach


def _spacing(model: GelModel) -> float:
    return float(np.sqrt(model.gel_mesh.face_areas.max()))


def calibrated(
    loads: list[tuple[Case, Pressed]], models: dict[Any, GelModel], load_noise: float = 0.01
) -> dict[str, Any]:
    """Find the modulus from the simulations' forces with errors, with a wrong one stated."""
    rng = np.random.default_rng(7)
    known = []
    for case, pressed in loads:
        model = model_of(case, models)
        moved = pressed.at(model.points[:, :2])
        moved = moved + rng.normal(0.0, NOISE * np.abs(moved).max(), moved.shape)
        deviation = load_noise * float(-pressed.force_n[2])
        load = float(pressed.force_n[2]) + rng.normal(0.0, deviation)
        known.append(
            (KnownLoad(moved, load, deviation, touching(model, pressed)), np.abs(moved).max())
        )
    cells = loads[0][0].cells
    assert cells is not None
    stated = GelModel(replace(MINI, youngs_mpa=0.2), GelOptions(*cells))
    noise = NOISE * float(np.mean([size for _, size in known]))
    each = [calibrate_modulus(stated, [k], NOISE * float(size)) for k, size in known]
    both = calibrate_modulus(stated, [k for k, _ in known], noise)
    return {
        "true_mpa": float(MINI.youngs_mpa),
        "stated_mpa": 0.2,
        "each_mpa": [one.youngs_mpa for one in each],
        "youngs_mpa": both.youngs_mpa,
        "deviation_mpa": both.deviation_mpa,
        "random_mpa": both.random_mpa,
        "chi2": both.chi2,
        "freedom": both.freedom,
    }


def format_tables(result: dict[str, Any]) -> list[str]:
    """The tables."""
    lines = [
        "| gel | indenter | half space | exact | fine simulation | model, direct | with noise |"
        " model, smooth | with noise: mean, worst |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in result["cases"]:
        shape = f"{r['indenter']} {r['size_mm']:g} mm, {r['depth_mm']:g} mm deep"
        shape += "" if r["slips"] else ", no slip"
        formulas = "- | -"
        fine = f"{r['fine_n']:.4f} N"
        if r["exact_n"] is not None:
            formulas = f"{r['half_space_n']:.4f} N | {r['exact_n']:.4f} N"
            fine += f" ({r['fine_off']:+.1%})"
        model = "| - " * 4
        if "smooth_off" in r:
            model = (
                f"| {r['direct_off']:+.1%} | {r['direct_noisy_off']:+.1%} |"
                f" {r['smooth_off']:+.1%} | {r['noisy_mean_off']:+.1%}, {r['noisy_worst_off']:.1%} "
            )
        lines.append(f"| {r['gel']} | {shape} | {formulas} | {fine} {model}|")
    m = result["modulus"]
    each = ", ".join(f"{e:.4f}" for e in m["each_mpa"])
    return [
        *lines,
        "",
        "Percentages of the fine simulation are against the exact solution, those of the model"
        " against the fine simulation.",
        f"Modulus from the mini's presses ({m['true_mpa']:g} MPa, stated {m['stated_mpa']:g}):"
        f" {m['youngs_mpa']:.4f} +- {m['deviation_mpa']:.4f} MPa (each: {each}), chi2"
        f" {m['chi2']:.2f} of {m['freedom']}.",
    ]


if __name__ == "__main__":
    main()
