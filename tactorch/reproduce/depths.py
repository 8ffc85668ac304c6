"""Depth of a hard ball (Section V-A, Fig. 10): seven depths, random lateral positions.

A cube of 10 mm and 4 MPa contains a ball of 30 MPa and 2 mm radius. Its centre is 2 to 8 mm below
the top, at a random lateral position within the cube. Noisy presses from three sides are simulated
with quadratic elements on a mesh twice as fine as that of the inversion. The ball is the hard
inclusion of `find_shapes`, or with `estimate=map` the lump that `find_lumps` detects in the map
inverted from the best uniform modulus. Its class is the one of the seven depths that is nearest to
the depth of its centre. No parameter was fitted to these objects, and settings are the defaults.

The paper defines neither the presses nor the noise, nor the reference of its relative error: both
`of the side` and `of the depth` are given.
"""

import time
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.inverse import find_lumps, find_shapes, homogeneous
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.paper import invert_blindly, paper, press_finely
from tactorch.simulation import PressPlan
from tactorch.viz.paper import boxes_figure

DEPTHS_MM = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
SIDE_MM, RADIUS_MM = 10.0, 2.0


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return one case per object."""
    shared = {k: v for k, v in options.items() if k not in ("places", "seed")}
    return {
        _name(depth, place): {**shared, **_object(depth, place, options)}
        for depth in DEPTHS_MM
        for place in range(options["places"])
    }


def _name(depth: float, place: int) -> str:
    return f"{depth:g}mm-{place:02d}"


def _object(depth: float, place: int, options: CaseSettings) -> CaseSettings:
    """Return the position of the ball, which does not depend on the size of the study."""
    rng = np.random.default_rng([options["seed"], int(depth), place])
    margin = 0.5 - RADIUS_MM / SIDE_MM
    offset = [float(x) for x in rng.uniform(-margin, margin, 2)]
    return {"depth_mm": depth, "offset": offset, "noise_seed": int(rng.integers(2**31))}


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Simulate and invert presses, and detect the ball."""
    depth, offset = settings["depth_mm"] / SIDE_MM, tuple(settings["offset"])
    phantom = make_phantom("depth_cube", depth=depth, offset=offset)
    edge, snr_db = settings["relative_edge_length"], settings["snr_db"]
    plan = PressPlan(**{key: settings[key] for key in ("p_max_mpa", "steps", "faces", "support")})
    seed = settings["noise_seed"]
    recording = press_finely(phantom, plan, edge, snr_db=snr_db, seed=seed, element="tet10")
    (ball, _), *_ = phantom.inclusions
    true, began = np.array(ball.bounds()).mean(axis=0), time.perf_counter()
    estimate = _from_shapes if settings["estimate"] == "shapes" else _from_map
    youngs, found = estimate(recording)
    detected: dict[str, float | None] = {"depth_mm": None, "off_mm": None, "radius_mm": None}
    if found is not None:
        detected["depth_mm"] = float(SIDE_MM - found.center_mm[2])
        detected["off_mm"] = float(np.linalg.norm(found.center_mm - true))
        detected["radius_mm"] = found.radius_mm
    figures = {**detected, "seconds": time.perf_counter() - began}
    return CaseResult.on_mesh(recording.mesh, figures, youngs=youngs, center=true)


class _Ball(NamedTuple):
    """The ball that is detected."""

    center_mm: Float[np.ndarray, "3"]
    radius_mm: float


def _from_shapes(recording: Recording) -> tuple[Float[np.ndarray, " m"], _Ball | None]:
    """Return the moduli at the elements' centroids, MPa, and the hard inclusion, if any."""
    shapes = find_shapes(recording)
    hard = [one for one in shapes.inclusions if one.youngs_mpa > one.background_mpa]
    ball = None
    if hard:
        surest = max(hard, key=lambda one: one.probability)
        ball = _Ball(np.array(surest.shape.center_mm), surest.shape.radius_mm)
    return shapes.youngs_at(recording.mesh.centroids), ball


def _from_map(recording: Recording) -> tuple[Float[np.ndarray, " m"], _Ball | None]:
    """Return the map, MPa, and its most conspicuous hard lump, if any."""
    youngs = invert_blindly(recording, start=homogeneous).youngs
    for lump in find_lumps(recording.mesh, youngs, max_lumps=1, side="stiff"):
        return youngs, _Ball(lump.center_mm, lump.equivalent_radius_mm)
    return youngs, None


def classify_depth(depth_mm: float) -> float:
    """Return the one of the seven depths that is nearest to an estimate, mm."""
    return min(DEPTHS_MM, key=lambda known: abs(known - depth_mm))


def fig10(results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 10, estimated against true depths, with accuracy and error of the paper."""
    objects = Table(
        {"true depth, mm": 0, "place": None, "estimate, mm": 3, "class, mm": 0,
         "position error, mm": 3}
    )  # fmt: skip
    estimates: dict[float, list[float]] = {}
    correct = []
    for depth, place in product(DEPTHS_MM, range(options["places"])):
        if (result := results.get(_name(depth, place))) is None:
            continue
        estimate = result.figures["depth_mm"]
        label = None if estimate is None else classify_depth(estimate)
        objects.add(depth, place, estimate, label, result.figures["off_mm"])
        estimates.setdefault(depth, []).extend([] if estimate is None else [estimate])
        correct.append(label == depth)
    errors = {depth: np.array(values) - depth for depth, values in estimates.items()}
    error = np.abs(np.concatenate(list(errors.values())))
    depths = np.concatenate([np.full(len(values), depth) for depth, values in errors.items()])
    accuracy, known = float(np.mean(correct)), paper()["depth"]
    summary = Table({"": None, "paper": 4, "here": 4})
    summary.add("objects", None, len(correct))
    summary.add("accuracy of the depth class, of seven", known["accuracy"], accuracy)
    summary.add("mean error relative to the side", known["mean_error"], _mean(error / SIDE_MM))
    summary.add("mean error relative to the depth", known["mean_error"], _mean(error / depths))
    summary.add("no inclusion detected", None, len(correct) - len(error))
    by_depth = Table(
        {"true depth, mm": 0, "objects": None, "mean error, mm": 2, "bias, mm": 2,
         "largest error, mm": 2}
    )  # fmt: skip
    for depth, values in errors.items():
        largest = float(np.abs(values).max()) if len(values) else None
        by_depth.add(depth, len(values), _mean(np.abs(values)), _mean(values), largest)
    drawn = {depth: values for depth, values in estimates.items() if values}
    title = f"accuracy {accuracy:.1%} (paper: {known['accuracy']:.0%})"
    figure = boxes_figure(drawn, title=title) if drawn else None
    text = [summary.markdown(), by_depth.markdown()]
    return Exhibit(text, objects, figure, "Estimated against true depths")


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


EXHIBITS = {"fig10": fig10}
