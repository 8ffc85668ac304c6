"""Wrong sizes of the object (Section IV-C2, Fig. 9): 80 to 120 % along all axes or one.

Presses from three sides on a cube of 10 mm with a ball are simulated on a mesh twice as fine as
that of the inversion, which then assumes another size. There are three methods:

- `positions`: displacements are differences between measured positions and the wrong rest shape,
  as the text of the paper suggests. They contain the difference of the shapes, which at 20 % is
  far larger than the effect of the presses.
- `contact`: displacements are relative to first contact, as those of a sensor on a robot; only the
  mesh is wrong.
- `estimated`: as `positions`, with the size along each axis estimated together with the map, which
  the paper does not do.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from tactorch.inverse import NuisancePrior, Settings, find_lumps
from tactorch.metrics import pearson
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.paper import SIDES, invert_blindly, press_finely
from tactorch.simulation import PressPlan, perturb_recording
from tactorch.viz.paper import Panel, panels_figure

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
_SIZE_DEVIATION = 0.2  # prior standard deviation of an estimated size
_METHODS = ("positions", "contact", "estimated")


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return one case per size and method."""
    return {
        _name(size, method): {"size": list(factors), "method": method, **options}
        for size, factors in SIZES.items()
        for method in _METHODS
    }


def _name(size: str, method: str) -> str:
    return f"{size.replace(' ', '').replace('%', '')}-{method}"


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Simulate presses and invert them with a wrong size."""
    phantom = make_phantom("cube_sphere", depth=0.4)
    edge, method = settings["relative_edge_length"], settings["method"]
    plan = PressPlan(p_max_mpa=0.02, steps=settings["steps"], faces=SIDES)
    exact = press_finely(phantom, plan, edge, snr_db=settings["snr_db"], seed=0)
    truth = exact.truth
    assert truth is not None
    wrong = perturb_recording(replace(exact, truth=None), size=settings["size"])
    if method == "contact":
        pairs = zip(wrong.presses, exact.presses, strict=True)
        presses = tuple(replace(w, displacement=e.displacement) for w, e in pairs)
        wrong = replace(wrong, presses=presses)
    estimated = NuisancePrior(rest_scale=_SIZE_DEVIATION)
    nuisance = estimated if method == "estimated" else NuisancePrior()
    reconstruction = invert_blindly(wrong, Settings(nuisance=nuisance))
    lumps = find_lumps(wrong.mesh, reconstruction.youngs, max_lumps=1)
    center = lumps[0].center_mm / settings["size"] if lumps else np.full(3, np.nan)
    true = find_lumps(exact.mesh, truth, max_lumps=1)[0].center_mm
    estimate = reconstruction.nuisance.get("rest_scale")
    figures = {
        "median_mpa": float(np.median(reconstruction.youngs)),
        "pearson": pearson(reconstruction.youngs, truth),
        "off_mm": float(np.linalg.norm(center - true)) if lumps else None,
        "size": None if estimate is None else [float(v) for v in estimate.value],
    }
    return CaseResult.on_mesh(wrong.mesh, figures, youngs=reconstruction.youngs)


def fig9(results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 9, maps by assumed size, and whether larger sizes give softer maps."""
    table = Table(
        {"assumed": None, "method": None, "median, MPa": 3, "r with the truth": 3,
         "position error, mm": 2, "estimate": None}
    )  # fmt: skip
    rows: dict[str, list[Panel]] = {method: [] for method in _METHODS}
    medians: dict[tuple[str, str], str] = {}
    for size, method in product(SIZES, _METHODS):
        if (result := results.get(_name(size, method))) is None:
            continue
        figures = result.figures
        median, correlation = figures["median_mpa"], figures["pearson"]
        medians[size, method] = f"{median:.3f}"
        estimate = figures["size"] and ", ".join(f"{v:.2f}" for v in figures["size"])
        table.add(size, method, median, correlation, figures["off_mm"], estimate)
        caption = f"r {correlation:.2f}, median {median:.2f} MPa"
        youngs = result.arrays["youngs"]
        rows[method].append(Panel(result.mesh, youngs, _LIMITS, title=size, caption=caption))
    told = [
        f"{method} {medians.get(('80 %', method), '?')} MPa at 80 %,"
        f" {medians.get(('120 %', method), '?')} MPa at 120 %"
        for method in _METHODS
    ]
    text = (
        "In the paper an object that is assumed too large seems softer, and stiffer if assumed too"
        f" small. Median moduli here (true: 0.2 MPa): {'; '.join(told)}."
    )
    return Exhibit([table.markdown(), text], table, panels_figure(rows), "Maps by assumed size")


EXHIBITS = {"fig9": fig9}
