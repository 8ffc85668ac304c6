"""Depth of a hard ball (Section V-A, Fig. 10): seven depths, random places.

A cube of 10 mm and 4 MPa with a ball of 30 MPa and 2 mm radius, its centre 2 to 8 mm below the top
and anywhere within it sideways. Presses from three sides, simulated on a mesh twice as fine as
that of the inversion, with noise; inverted by default settings from the uniform modulus that fits
best. The lump is what stands out by `find_lumps`; the class is the depth, of the seven, nearest to
that of its centroid. Nothing was fitted to these objects.

The paper names neither the presses nor the noise, nor what its error is a share of: `of the side`
and `of the depth` are both given.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.findings import find_lumps
from tactorch.inverse import Settings, homogeneous, invert
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import MATERIAL
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.viz.paper import plot_boxes

DEPTHS_MM = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
SIDE_MM, RADIUS_MM = 10.0, 2.0


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One an object."""
    shared = {k: v for k, v in options.items() if k not in ("places", "seed")}
    return [
        Case("depths", f"{depth:g}mm-{place:02d}", {**shared, **_object(depth, place, options)})
        for depth in DEPTHS_MM
        for place in range(options["places"])
    ]


def _object(depth: float, place: int, options: Mapping[str, Any]) -> dict[str, Any]:
    """Where the ball is; the same whatever else there is in the study."""
    rng = np.random.default_rng([options["seed"], int(depth), place])
    free = 0.5 - RADIUS_MM / SIDE_MM
    return {
        "depth_mm": depth,
        "offset": [float(x) for x in rng.uniform(-free, free, 2)],
        "noise_seed": int(rng.integers(2**31)),
    }


def work(case: Case, scratch: Path) -> Outcome:
    """Simulate, invert, and find the ball."""
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
    found = invert(blind, Settings(), start_mpa=homogeneous, show_progress=False)
    lumps = find_lumps(recording.mesh, found.youngs, most=1, side="stiff")
    (ball, _), *_ = phantom.inclusions
    true = np.array(ball.bounds()).mean(axis=0)
    center = lumps[0].center_mm if lumps else None
    return Outcome(
        {
            "depth_mm": None if center is None else float(SIDE_MM - center[2]),
            "off_mm": None if center is None else float(np.linalg.norm(center - true)),
            "radius_mm": lumps[0].equivalent_radius_mm if lumps else None,
            "seconds": found.seconds,
        },
        {
            "points": recording.mesh.points,
            "tets": recording.mesh.tets,
            "youngs": found.youngs,
            "center": true,
        },
    )


def nearest(depth_mm: float) -> float:
    """Return the depth, of the seven, that an estimate is nearest to."""
    return min(DEPTHS_MM, key=lambda known: abs(known - depth_mm))


def fig10(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 10: estimated over true depths; accuracy and mean error beside the paper's."""
    told = _told(outcomes, options["places"], out)
    estimates = {depth: [e for e in found if e is not None] for depth, found in told.items()}
    right = [e is not None and nearest(e) == depth for depth, found in told.items() for e in found]
    errors = [(depth, abs(e - depth)) for depth, found in estimates.items() for e in found]
    depths, off = np.array(errors).reshape(-1, 2).T
    known = paper()["depth"]
    summary = Table(["", "paper", "here"], [None, 4, 4])
    summary.add("objects", None, len(right))
    summary.add("depth told right, of seven", known["accuracy"], float(np.mean(right)))
    summary.add("mean error of the side", known["mean_error"], _mean(off / SIDE_MM))
    summary.add("mean error of the depth", known["mean_error"], _mean(off / depths))
    summary.add("no lump found", None, len(right) - len(off))
    title = f"{float(np.mean(right)):.1%} told right (paper: {known['accuracy']:.0%})"
    parts = [summary.markdown(), _by_depth(estimates).markdown()]
    drawn = {depth: found for depth, found in estimates.items() if found}
    if drawn:
        plot_boxes(drawn, out / "fig10.png", reference=title)
        parts.append("![Estimated over true depths](fig10.png)")
    return "\n\n".join(parts)


def _told(
    outcomes: Mapping[str, Outcome], places: int, out: Path
) -> dict[float, list[float | None]]:
    """Estimates of each depth (mm), None where no lump was found; writes those of each object."""
    objects = Table(
        ["true depth, mm", "place", "estimate, mm", "told as, mm", "centre off, mm"],
        [0, None, 3, 0, 3],
    )
    told: dict[float, list[float | None]] = {}
    for depth in DEPTHS_MM:
        for place in range(places):
            outcome = outcomes.get(f"{depth:g}mm-{place:02d}")
            if outcome is None:
                continue
            found = outcome.figures["depth_mm"]
            called = None if found is None else nearest(found)
            objects.add(depth, place, found, called, outcome.figures["off_mm"])
            told.setdefault(depth, []).append(found)
    objects.write_csv(out / "fig10.csv")
    return told


def _by_depth(estimates: Mapping[float, list[float]]) -> Table:
    """Errors of each true depth."""
    table = Table(
        ["true depth, mm", "objects", "mean error, mm", "bias, mm", "largest error, mm"],
        [0, None, 2, 2, 2],
    )
    for depth, found in estimates.items():
        off = np.array(found) - depth
        largest = float(np.abs(off).max()) if found else None
        table.add(depth, len(found), _mean(np.abs(off)), _mean(off), largest)
    return table


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


EXHIBITS = {"fig10": fig10}
