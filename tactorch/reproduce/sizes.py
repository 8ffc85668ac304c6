"""Wrong sizes of the object (Section IV-C2, Fig. 9): 80 to 120 %, along all axes or some.

Presses on a cube of 10 mm with a ball, from three sides, on a mesh twice as fine as that of the
inversion; its size is then believed to be another. Three ways:

- `positions`: displacements are what the wrong rest shape lacks to the measured positions, as the
  paper's text has it. They then hold the difference of the shapes, which at 20 % is far larger than
  what the presses do.
- `contact`: displacements are counted from first contact, as a sensor that moves with the robot
  does; only the mesh is wrong.
- `estimated`: as `positions`, with the size along each axis estimated beside the map, which the
  paper does not do.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.findings import find_lumps
from tactorch.inverse import NuisancePrior, Settings, invert
from tactorch.metrics import pearson
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import MATERIAL, SIDES, START_MPA, stored_mesh
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, perturb_recording, simulate
from tactorch.viz.paper import Panel, plot_panels

SIZES = {
    "80 %": (0.8, 0.8, 0.8),
    "x 80 %": (0.8, 1.0, 1.0),
    "z 80 %": (1.0, 1.0, 0.8),
    "100 %": (1.0, 1.0, 1.0),
    "x 120 %": (1.2, 1.0, 1.0),
    "z 120 %": (1.0, 1.0, 1.2),
    "120 %": (1.2, 1.2, 1.2),
}
_LIMITS = (0.0, 1.0)
_OFF = 0.2  # how far the size is said to be uncertain where it is estimated
_METHODS = ("positions", "contact", "estimated")


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One a size and method."""
    return [
        Case("sizes", _name(size, how), {"size": list(factors), "how": how, **options})
        for size, factors in SIZES.items()
        for how in _METHODS
    ]


def _name(size: str, how: str) -> str:
    return f"{size.replace(' ', '').replace('%', '')}-{how}"


def work(case: Case, scratch: Path) -> Outcome:
    """Simulate, believe another size, invert."""
    settings = case.settings
    phantom = make_phantom("cube_sphere", depth=0.4)
    edge = settings["relative_edge_length"]
    right = simulate(
        phantom,
        PressPlan(p_max_mpa=0.02, steps=settings["steps"], faces=SIDES),
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=edge),
        fine_mesh=phantom.mesh(relative_edge_length=edge / 2),
        snr_db=settings["snr_db"],
        seed=0,
    )
    truth = right.truth
    assert truth is not None
    wrong = perturb_recording(replace(right, truth=None), size=settings["size"])
    if settings["how"] == "contact":
        pairs = zip(wrong.presses, right.presses, strict=True)
        wrong = replace(
            wrong, presses=tuple(replace(w, displacement=r.displacement) for w, r in pairs)
        )
    unknowns = NuisancePrior(rest_scale=_OFF) if settings["how"] == "estimated" else NuisancePrior()
    found = invert(wrong, Settings(nuisance=unknowns), start_mpa=START_MPA, show_progress=False)
    lumps = find_lumps(wrong.mesh, found.youngs, most=1)
    center = lumps[0].center_mm / settings["size"] if lumps else np.full(3, np.nan)
    true = find_lumps(right.mesh, truth, most=1)[0].center_mm
    estimate = found.nuisance.get("rest_scale")
    return Outcome(
        {
            "median_mpa": float(np.median(found.youngs)),
            "pearson": pearson(found.youngs, truth),
            "off_mm": float(np.linalg.norm(center - true)) if lumps else None,
            "size": None if estimate is None else [float(v) for v in estimate.value],
        },
        {"points": wrong.mesh.points, "tets": wrong.mesh.tets, "youngs": found.youngs},
    )


def fig9(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 9: maps by believed size, and whether larger ones seem softer."""
    table = Table(
        ["believed", "method", "median, MPa", "r with the truth", "centre off, mm", "told"],
        [None, None, 3, 3, 2, None],
    )
    rows: list[list[Panel]] = [[] for _ in _METHODS]
    for size in SIZES:
        for line, how in zip(rows, _METHODS, strict=True):
            outcome = outcomes.get(_name(size, how))
            if outcome is None:
                continue
            found = outcome.figures
            told = found["size"] and ", ".join(f"{v:.2f}" for v in found["size"])
            table.add(size, how, found["median_mpa"], found["pearson"], found["off_mm"], told)
            caption = f"r {found['pearson']:.2f}, median {found['median_mpa']:.2f} MPa"
            mesh = stored_mesh(outcome.arrays)
            line.append(Panel(mesh, outcome.arrays["youngs"], _LIMITS, title=size, caption=caption))
    table.write_csv(out / "fig9.csv")
    plot_panels(rows, list(_METHODS), out / "fig9.png")
    told = [
        f"{how} {_median(outcomes, '80 %', how)} MPa at 80 %,"
        f" {_median(outcomes, '120 %', how)} MPa at 120 %"
        for how in _METHODS
    ]
    return (
        f"{table.markdown()}\n\nThe paper: an object believed larger seems softer, and stiffer"
        f" where believed smaller. Median moduli here (true: 0.2 MPa): {'; '.join(told)}.\n\n"
        "![Maps by believed size](fig9.png)"
    )


def _median(outcomes: Mapping[str, Outcome], size: str, how: str) -> str:
    outcome = outcomes.get(_name(size, how))
    return "?" if outcome is None else f"{outcome.figures['median_mpa']:.3f}"


EXHIBITS = {"fig9": fig9}
