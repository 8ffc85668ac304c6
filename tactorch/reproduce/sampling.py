"""Active sampling (Section V-C, Fig. 12): where to press next, and what is known after each press.

A hemisphere and a toy figure, each with two hard balls, on their flat side, pressed by a round
sensor; noise is 1 % of the typical displacement. `paper` presses where the uncertainty is largest,
`ours` where the expected error falls most. Same mesh, as in the paper: an inverse crime. The truth
tells how hard to press and how large the noise is, and serves the scores; maps start at 0.2 MPa.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import GaussNewton, Settings
from tactorch.mesh import TetMesh
from tactorch.metrics import dice, pearson
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import MATERIAL, places, sensor_on, stored_mesh
from tactorch.reproduce.table import Table
from tactorch.sampling import ExpectedError, LargestUncertainty, Rule, Step, sample
from tactorch.viz.paper import Panel, plot_panels

OBJECTS = {"hemisphere": "hemisphere_two_spheres", "toy": "toy_two_spheres"}
RULES = ("paper", "ours")
_NOISE = 0.01
_SHOWN = 5  # steps of each object in the figure


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One an object and rule."""
    return [
        Case("sampling", f"{name}-{rule}", {"phantom": phantom, "rule": rule, **options})
        for name, phantom in OBJECTS.items()
        for rule in RULES
    ]


def work(case: Case, scratch: Path) -> Outcome:
    """Press by a rule; score the map after each press."""
    settings = case.settings
    phantom = make_phantom(settings["phantom"])
    mesh = phantom.mesh(relative_edge_length=settings["relative_edge_length"])
    truth = phantom.on_mesh(mesh)
    background = float(np.median(truth))
    patches = places(mesh, settings["sensor_mm"], settings["candidates"])
    pressure = settings["load"] * background
    first = sensor_on(mesh, truth, pressure).press(patches[0])
    typical = float(np.sqrt(np.nanmean(first.displacement[first.observed] ** 2)))
    presser = sensor_on(mesh, truth, pressure, _NOISE * typical)
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
    return Outcome(
        {"steps": [_scored(mesh, step, truth) for step in steps], "background_mpa": background},
        {
            "points": mesh.points,
            "tets": mesh.tets,
            "truth": truth,
            "youngs": np.array([step.youngs for step in steps]),
            "centers": np.array([patches[step.place].center for step in steps]),
        },
    )


def _scored(mesh: TetMesh, step: Step, truth: np.ndarray) -> dict[str, float]:
    logs = np.log(step.youngs / truth)
    return {
        "pearson": pearson(step.youngs, truth),
        "dice": dice(mesh, step.youngs, truth),
        "log_error": float(np.sqrt(mesh.volumes @ logs**2 / mesh.volumes.sum())),
        "deviation": step.rms_deviation,
    }


def fig12(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 12: maps as the presses go on, the pressed places numbered."""
    table = Table(
        ["object", "rule", "presses", "r", "Dice", "error of log E", "stated deviation"],
        [None, None, None, 3, 3, 3, 3],
    )
    rows: list[list[Panel]] = []
    names: list[str] = []
    for case in outcomes:
        outcome = outcomes[case]
        name, rule = case.split("-")
        for count, step in enumerate(outcome.figures["steps"], start=1):
            marks = (step["pearson"], step["dice"], step["log_error"], step["deviation"])
            table.add(name, rule, count, *marks)
        rows.append(_panels(outcome))
        names.append(f"{name}: {rule}")
    table.write_csv(out / "fig12.csv")
    plot_panels(rows, names, out / "fig12.png")
    return f"{table.markdown()}\n\n![Maps as the presses go on](fig12.png)"


def _panels(outcome: Outcome) -> list[Panel]:
    arrays, mesh = outcome.arrays, stored_mesh(outcome.arrays)
    limits = (float(arrays["truth"].min()), float(arrays["truth"].max()))
    found = [Panel(mesh, arrays["truth"], limits, title="truth")]
    total = len(arrays["youngs"])
    for count in sorted({max(1, round(total * (i + 1) / _SHOWN)) for i in range(_SHOWN)}):
        similar = outcome.figures["steps"][count - 1]["pearson"]
        found.append(
            Panel(
                mesh,
                arrays["youngs"][count - 1],
                limits,
                title=f"{count} press{'es' if count > 1 else ''}",
                caption=f"r {similar:.2f}",
                marks_mm=arrays["centers"][:count],
            )
        )
    return found


EXHIBITS = {"fig12": fig12}
