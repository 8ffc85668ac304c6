"""Active sampling (Section V-C, Fig. 12): choice of the next press and map after each press.

A hemisphere and a toy figure, each with two hard balls and fixed at the flat side, are pressed by
a round sensor with a noise of 1 % of the typical displacement. `paper` presses at the largest
uncertainty, `ours` where the expected error decreases most. As in the paper the mesh of the
simulation is that of the inversion (inverse crime). The truth determines the pressure and the
noise level and is used for the scores; maps start at 0.2 MPa.
"""

from pathlib import Path

import numpy as np

from tactorch.inverse import GaussNewton, Settings
from tactorch.mesh import TetMesh
from tactorch.metrics import dice, pearson
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.paper import MATERIAL, make_presser, sensor_patches
from tactorch.sampling import ExpectedError, LargestUncertainty, Rule, Step, sample
from tactorch.viz.paper import Panel, panels_figure

OBJECTS = {"hemisphere": "hemisphere_two_spheres", "toy": "toy_two_spheres"}
RULES = ("paper", "ours")
_SCORES = ("pearson", "dice", "log_error", "deviation")
_NOISE = 0.01
_PANELS = 5  # maps of each object in the figure


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return one case per object and rule."""
    return {
        f"{name}-{rule}": {"phantom": phantom, "rule": rule, **options}
        for name, phantom in OBJECTS.items()
        for rule in RULES
    }


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Select presses by a rule and score the map after each."""
    phantom = make_phantom(settings["phantom"])
    mesh = phantom.mesh(relative_edge_length=settings["relative_edge_length"])
    truth = phantom.on_mesh(mesh)
    background = float(np.median(truth))
    patches = sensor_patches(mesh, settings["sensor_mm"], settings["candidates"])
    pressure = settings["load"] * background
    first = make_presser(mesh, truth, pressure).press(patches[0])
    typical = float(np.sqrt(np.nanmean(first.displacement[first.observed] ** 2)))
    presser = make_presser(mesh, truth, pressure, _NOISE * typical)
    rule: Rule = LargestUncertainty() if settings["rule"] == "paper" else ExpectedError()
    optimizer = GaussNewton(max_iterations=25, tolerance=1e-2)
    inversion = Settings(optimizer=optimizer, model_error="none")
    count = settings["presses"]
    steps = sample(presser, mesh, patches, rule, count, inversion, material=MATERIAL)
    figures = {"steps": [_score(mesh, s, truth) for s in steps], "background_mpa": background}
    youngs = np.array([step.youngs for step in steps])
    centers = np.array([patches[step.place].center for step in steps])
    return CaseResult.on_mesh(mesh, figures, truth=truth, youngs=youngs, centers=centers)


def _score(mesh: TetMesh, step: Step, truth: np.ndarray) -> dict[str, float]:
    logs = np.log(step.youngs / truth)
    return {
        "pearson": pearson(step.youngs, truth),
        "dice": dice(mesh, step.youngs, truth),
        "log_error": float(np.sqrt(mesh.volumes @ logs**2 / mesh.volumes.sum())),
        "deviation": step.rms_deviation,
    }


def fig12(results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 12: maps after increasing numbers of presses, with numbered positions."""
    table = Table(
        {"object": None, "rule": None, "presses": None, "r": 3, "Dice": 3, "error of log E": 3,
         "stated deviation": 3}
    )  # fmt: skip
    rows: dict[str, list[Panel]] = {}
    for case, result in results.items():
        name, rule = case.split("-")
        steps, mesh, arrays = result.figures["steps"], result.mesh, result.arrays
        for count, step in enumerate(steps, start=1):
            table.add(name, rule, count, *(step[key] for key in _SCORES))
        limits = (float(arrays["truth"].min()), float(arrays["truth"].max()))
        panels = rows[f"{name}: {rule}"] = [Panel(mesh, arrays["truth"], limits, title="truth")]
        counts = {max(1, round(len(steps) * (i + 1) / _PANELS)) for i in range(_PANELS)}
        for count in sorted(counts):
            title = f"{count} press{'es' if count > 1 else ''}"
            caption = f"r {steps[count - 1]['pearson']:.2f}"
            youngs, marks = arrays["youngs"][count - 1], arrays["centers"][:count]
            panels.append(Panel(mesh, youngs, limits, 1, title, caption, marks))
    figure = panels_figure(rows)
    return Exhibit([table.markdown()], table, figure, "Maps after increasing numbers of presses")


EXHIBITS = {"fig12": fig12}
