"""Active sampling (Section V-C, Fig. 12): choice of the next press and map after each press.

A hemisphere and a toy figure, each with two hard balls and fixed at the flat side, are pressed by
a round sensor with a noise of 1 % of the typical displacement. `paper` presses at the largest
uncertainty, `ours` where the expected error decreases most. As in the paper the mesh of the
simulation is that of the inversion (inverse crime). The truth determines the pressure and the
noise level and is used for the scores; maps start at 0.2 MPa.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import GaussNewton, Settings
from tactorch.mesh import TetMesh
from tactorch.metrics import dice, pearson
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.objects import (
    MATERIAL,
    make_presser,
    mesh_arrays,
    sensor_patches,
    stored_mesh,
)
from tactorch.reproduce.table import Table
from tactorch.sampling import ExpectedError, LargestUncertainty, Rule, Step, sample
from tactorch.viz.paper import Panel, plot_panels

OBJECTS = {"hemisphere": "hemisphere_two_spheres", "toy": "toy_two_spheres"}
RULES = ("paper", "ours")
_NOISE = 0.01
_PANELS = 5  # maps of each object in the figure


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return one case per object and rule."""
    return [
        Case("sampling", f"{name}-{rule}", {"phantom": phantom, "rule": rule, **options})
        for name, phantom in OBJECTS.items()
        for rule in RULES
    ]


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Select presses by a rule and score the map after each."""
    settings = case.settings
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
    steps = sample(
        presser,
        mesh,
        patches,
        rule,
        settings["presses"],
        Settings(optimizer=GaussNewton(max_iterations=25, tolerance=1e-2), model_error="none"),
        material=MATERIAL,
    )
    return CaseResult(
        {"steps": [_score(mesh, step, truth) for step in steps], "background_mpa": background},
        mesh_arrays(
            mesh,
            truth=truth,
            youngs=np.array([step.youngs for step in steps]),
            centers=np.array([patches[step.place].center for step in steps]),
        ),
    )


def _score(mesh: TetMesh, step: Step, truth: np.ndarray) -> dict[str, float]:
    logs = np.log(step.youngs / truth)
    return {
        "pearson": pearson(step.youngs, truth),
        "dice": dice(mesh, step.youngs, truth),
        "log_error": float(np.sqrt(mesh.volumes @ logs**2 / mesh.volumes.sum())),
        "deviation": step.rms_deviation,
    }


def fig12(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 12: maps after increasing numbers of presses, with numbered positions."""
    table = Table(
        ["object", "rule", "presses", "r", "Dice", "error of log E", "stated deviation"],
        [None, None, None, 3, 3, 3, 3],
    )
    rows: list[list[Panel]] = []
    names: list[str] = []
    for case in results:
        result = results[case]
        name, rule = case.split("-")
        for count, step in enumerate(result.figures["steps"], start=1):
            values = (step["pearson"], step["dice"], step["log_error"], step["deviation"])
            table.add(name, rule, count, *values)
        rows.append(_panels(result))
        names.append(f"{name}: {rule}")
    table.write_csv(out / "fig12.csv")
    plot_panels(rows, names, out / "fig12.png")
    return f"{table.markdown()}\n\n![Maps after increasing numbers of presses](fig12.png)"


def _panels(result: CaseResult) -> list[Panel]:
    arrays, mesh = result.arrays, stored_mesh(result.arrays)
    limits = (float(arrays["truth"].min()), float(arrays["truth"].max()))
    panels = [Panel(mesh, arrays["truth"], limits, title="truth")]
    total = len(arrays["youngs"])
    for count in sorted({max(1, round(total * (i + 1) / _PANELS)) for i in range(_PANELS)}):
        correlation = result.figures["steps"][count - 1]["pearson"]
        panels.append(
            Panel(
                mesh,
                arrays["youngs"][count - 1],
                limits,
                title=f"{count} press{'es' if count > 1 else ''}",
                caption=f"r {correlation:.2f}",
                marks_mm=arrays["centers"][:count],
            )
        )
    return panels


EXHIBITS = {"fig12": fig12}
