"""Depth of a hard ball (Section V-A, Fig. 10): seven depths, random lateral positions.

A cube of 10 mm and 4 MPa contains a ball of 30 MPa and 2 mm radius. Its centre is 2 to 8 mm below
the top, at a random lateral position within the cube. Noisy presses from three sides are simulated
on a mesh twice as fine as that of the inversion, and inverted with default settings from the best
uniform modulus. The ball is detected by `find_lumps`; its class is the one of the seven depths
that is nearest to the depth of its centroid. No parameter was fitted to these objects.

The paper defines neither the presses nor the noise, nor the reference of its relative error: both
`of the side` and `of the depth` are given.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.findings import find_lumps
from tactorch.inverse import Settings, homogeneous, invert
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.objects import MATERIAL, mesh_arrays
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.viz.paper import plot_boxes

DEPTHS_MM = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
SIDE_MM, RADIUS_MM = 10.0, 2.0


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return one case per object."""
    shared = {k: v for k, v in options.items() if k not in ("places", "seed")}
    return [
        Case("depths", f"{depth:g}mm-{place:02d}", {**shared, **_object(depth, place, options)})
        for depth in DEPTHS_MM
        for place in range(options["places"])
    ]


def _object(depth: float, place: int, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the position of the ball, which does not depend on the size of the study."""
    rng = np.random.default_rng([options["seed"], int(depth), place])
    margin = 0.5 - RADIUS_MM / SIDE_MM
    return {
        "depth_mm": depth,
        "offset": [float(x) for x in rng.uniform(-margin, margin, 2)],
        "noise_seed": int(rng.integers(2**31)),
    }


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Simulate and invert presses, and detect the ball."""
    settings = case.settings
    phantom = make_phantom(
        "depth_cube", depth=settings["depth_mm"] / SIDE_MM, offset=tuple(settings["offset"])
    )
    edge = settings["relative_edge_length"]
    recording = simulate(
        phantom,
        PressPlan(
            p_max_mpa=settings["p_max_mpa"],
            steps=settings["steps"],
            faces=settings["faces"],
            support=settings["support"],
        ),
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=edge),
        fine_mesh=phantom.mesh(relative_edge_length=edge / 2),
        snr_db=settings["snr_db"],
        seed=settings["noise_seed"],
    )
    blind = replace(recording, truth=None)
    reconstruction = invert(blind, Settings(), start_mpa=homogeneous, show_progress=False)
    lumps = find_lumps(recording.mesh, reconstruction.youngs, max_lumps=1, side="stiff")
    (ball, _), *_ = phantom.inclusions
    true = np.array(ball.bounds()).mean(axis=0)
    center = lumps[0].center_mm if lumps else None
    return CaseResult(
        {
            "depth_mm": None if center is None else float(SIDE_MM - center[2]),
            "off_mm": None if center is None else float(np.linalg.norm(center - true)),
            "radius_mm": lumps[0].equivalent_radius_mm if lumps else None,
            "seconds": reconstruction.seconds,
        },
        mesh_arrays(recording.mesh, youngs=reconstruction.youngs, center=true),
    )


def classify_depth(depth_mm: float) -> float:
    """Return the one of the seven depths that is nearest to an estimate, mm."""
    return min(DEPTHS_MM, key=lambda known: abs(known - depth_mm))


def fig10(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 10, estimated against true depths, and compare accuracy and error to the paper."""
    detected = _collect(results, options["places"], out)
    estimates = {depth: [e for e in one if e is not None] for depth, one in detected.items()}
    correct = [
        e is not None and classify_depth(e) == depth for depth, one in detected.items() for e in one
    ]
    errors = [(depth, abs(e - depth)) for depth, one in estimates.items() for e in one]
    depths, error = np.array(errors).reshape(-1, 2).T
    known = paper()["depth"]
    summary = Table(["", "paper", "here"], [None, 4, 4])
    summary.add("objects", None, len(correct))
    summary.add("accuracy of the depth class, of seven", known["accuracy"], float(np.mean(correct)))
    summary.add("mean error relative to the side", known["mean_error"], _mean(error / SIDE_MM))
    summary.add("mean error relative to the depth", known["mean_error"], _mean(error / depths))
    summary.add("no inclusion detected", None, len(correct) - len(error))
    title = f"accuracy {float(np.mean(correct)):.1%} (paper: {known['accuracy']:.0%})"
    parts = [summary.markdown(), _by_depth(estimates).markdown()]
    drawn = {depth: one for depth, one in estimates.items() if one}
    if drawn:
        plot_boxes(drawn, out / "fig10.png", reference=title)
        parts.append("![Estimated against true depths](fig10.png)")
    return "\n\n".join(parts)


def _collect(
    results: Mapping[str, CaseResult], places: int, out: Path
) -> dict[float, list[float | None]]:
    """Return estimates by true depth, mm, with None if not detected; write them to a CSV file."""
    objects = Table(
        ["true depth, mm", "place", "estimate, mm", "class, mm", "position error, mm"],
        [0, None, 3, 0, 3],
    )
    detected: dict[float, list[float | None]] = {}
    for depth in DEPTHS_MM:
        for place in range(places):
            result = results.get(f"{depth:g}mm-{place:02d}")
            if result is None:
                continue
            estimate = result.figures["depth_mm"]
            label = None if estimate is None else classify_depth(estimate)
            objects.add(depth, place, estimate, label, result.figures["off_mm"])
            detected.setdefault(depth, []).append(estimate)
    objects.write_csv(out / "fig10.csv")
    return detected


def _by_depth(estimates: Mapping[float, list[float]]) -> Table:
    """Return the errors of each true depth."""
    table = Table(
        ["true depth, mm", "objects", "mean error, mm", "bias, mm", "largest error, mm"],
        [0, None, 2, 2, 2],
    )
    for depth, values in estimates.items():
        error = np.array(values) - depth
        largest = float(np.abs(error).max()) if values else None
        table.add(depth, len(values), _mean(np.abs(error)), _mean(error), largest)
    return table


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


EXHIBITS = {"fig10": fig10}
