"""Credibility by depth, pressure and stiffness (Section III-D, eq. 14 and 15, Fig. 3).

    python benchmarks/credibility.py [--divisions 10] [--layers 10] [--side-mm 1] [--out FOLDER]

The paper's object: a homogeneous unit cube of 5, 7.5 and 10 MPa, its top under 0.06, 0.10 and 0.14
MPa (strains of 0.6 to 3 %). The paper states neither the unit of length nor the support: here the
side is 1 mm, on springs of 1 N/mm per node as elsewhere in the paper, and Poisson's ratio is 0.45.
With a rigid support the curves scale with the size of the cube. On springs they do not: the springs
of a cube of 10 mm (`--side-mm 10`) are as soft as the cube, and its lowest layer, which bends on
them, has a slightly larger metric than the layer above. All three displacement components of the
top nodes are observed.

L(j) = max_i |du_i / de_j| is the metric of an element. The integral of a layer is the sum of L over
its elements; elements on a border are divided between the layers. The figures state whether the
integral decreases with depth, increases with pressure and increases with softness. Besides the
metric per MPa of the paper, the relative metric E L is given: the displacement per change of log E.
Per MPa, a stiffer object has a smaller metric for two reasons: it deforms less, and 1 MPa is a
smaller relative change.

`reach` is the depth (in sides) down to which a layer has at least the integral that the middle
layer has at the middle pressure and stiffness.

The last line printed is one JSON object.
"""

import argparse
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe_machine

from tactorch.mesh import TetMesh, box_mesh
from tactorch.reproduce.credibility import PRESSURES_MPA, YOUNGS_MPA, compute_metric, layer_sums
from tactorch.viz import depth_figure, save_figure

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")

Key = tuple[float, float]  # Young's modulus, pressure; MPa


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the profiles and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--divisions", type=int, default=10, help="cells along the cube's side")
    parser.add_argument("--layers", type=int, default=10)
    parser.add_argument("--side-mm", type=float, default=1.0)
    parser.add_argument("--out", type=Path, help="folder for credibility.json, .md and .png")
    options = parser.parse_args(arguments)
    mesh = box_mesh(options.side_mm, options.divisions, tets_per_cell=5)
    maps = {(e, p): compute_metric(mesh, e, p) for e in YOUNGS_MPA for p in PRESSURES_MPA}
    profiles = {key: layer_sums(mesh, values, options.layers) for key, values in maps.items()}
    report = {
        "elements": mesh.n_tets,
        "side_mm": options.side_mm,
        **trends(profiles),
        **across(mesh, maps),
    }
    lines = table(profiles, report["reach"])
    print("\n".join(lines))
    if options.out is not None:
        _write(options.out, lines, report, mesh, maps, profiles)
    print(json.dumps(report))


def trends(profiles: dict[Key, np.ndarray]) -> dict[str, Any]:
    """Return how the profiles change with depth, pressure and stiffness."""
    ordered = sorted(profiles)
    falls = {_name(key): bool(np.all(np.diff(profiles[key]) < 0)) for key in ordered}
    drop = {_name(key): float(profiles[key][0] / profiles[key][-1]) for key in ordered}
    by_pressure = _steps(profiles, PRESSURES_MPA, lambda e, p: (e, p), YOUNGS_MPA)
    softer = tuple(reversed(YOUNGS_MPA))
    by_softness = _steps(profiles, softer, lambda p, e: (e, p), PRESSURES_MPA)
    relative = {key: key[0] * values for key, values in profiles.items()}
    relative_steps = _steps(relative, softer, lambda p, e: (e, p), PRESSURES_MPA)
    middle = profiles[YOUNGS_MPA[1], PRESSURES_MPA[1]]
    level = float(np.interp(0.5, _depths(len(middle)), middle))
    return {
        "falls_with_depth": falls,
        "top_over_bottom": drop,
        "rises_with_pressure": all(step["least"] > 1 for step in by_pressure),
        "ratio_by_pressure": by_pressure,
        "rises_with_softness": all(step["least"] > 1 for step in by_softness),
        "ratio_by_softness": by_softness,
        "relative_ratio_by_softness": relative_steps,
        "reach_level_mm_per_mpa": level,
        "reach": {_name(key): reach(profiles[key], level) for key in ordered},
        "layers": {_name(key): profiles[key].tolist() for key in ordered},
    }


def _steps(
    profiles: dict[Key, np.ndarray], values: Sequence[float], key: Any, others: Sequence[float]
) -> list[dict[str, float]]:
    """Ratio of the profiles at two successive values: its extremes over layers and all else."""
    steps = []
    for before, after in pairwise(values):
        ratios = np.array([profiles[key(o, after)] / profiles[key(o, before)] for o in others])
        steps.append(
            {
                "from_mpa": before,
                "to_mpa": after,
                "least": float(ratios.min()),
                "most": float(ratios.max()),
            }
        )
    return steps


def reach(values: np.ndarray, level: float) -> float:
    """Depth (in sides) where a profile falls below a level first; 1 where it does not."""
    depths = _depths(len(values))
    below = np.flatnonzero(values < level)
    if len(below) == 0:
        return 1.0
    i = int(below[0])
    if i == 0:
        return 0.0
    share = (values[i - 1] - level) / (values[i - 1] - values[i])
    return float(depths[i - 1] + share * (depths[i] - depths[i - 1]))


def across(mesh: TetMesh, maps: dict[Key, np.ndarray]) -> dict[str, float]:
    """Within the top quarter: the metric (by volume) near the sides over that around the axis."""
    values = maps[YOUNGS_MPA[1], PRESSURES_MPA[1]] / mesh.volumes
    centred = 2.0 * mesh.centroids / mesh.bounds[1] - 1.0
    off, top = np.abs(centred[:, :2]).max(axis=1), centred[:, 2] > 0.5
    near, inner = values[top & (off > 0.8)], values[top & (off < 0.5)]
    return {"top_sides_over_middle": float(near.mean() / inner.mean())}


def table(profiles: dict[Key, np.ndarray], reaches: dict[str, float]) -> list[str]:
    """Return a Markdown table: a row per depth, a column per stiffness and pressure."""
    keys = sorted(profiles)
    head = ["depth (sides)", *[_name(key) for key in keys]]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for i, depth in enumerate(_depths(len(profiles[keys[0]]))):
        cells = [f"{depth:.2f}", *[f"{profiles[key][i]:.3e}" for key in keys]]
        lines.append(f"| {' | '.join(cells)} |")
    last = ["reach (sides)", *[f"{reaches[_name(key)]:.2f}" for key in keys]]
    return [*lines, f"| {' | '.join(last)} |"]


def _depths(layers: int) -> np.ndarray:
    return (np.arange(layers) + 0.5) / layers


def _name(key: Key) -> str:
    return f"{key[0]:g} MPa, {key[1]:g} MPa"


def _write(
    folder: Path,
    lines: list[str],
    report: dict[str, Any],
    mesh: TetMesh,
    maps: dict[Key, np.ndarray],
    profiles: dict[Key, np.ndarray],
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(PACKAGES), **report}, indent=2)
    (folder / "credibility.json").write_text(text + "\n")
    (folder / "credibility.md").write_text("\n".join(lines) + "\n")
    # By volume: the element in a cell's middle is twice as large as the others.
    values = maps[YOUNGS_MPA[1], PRESSURES_MPA[1]] / mesh.volumes
    groups = {
        f"E = {e:g} MPa": {f"{1e3 * p:g} kPa": profiles[e, p] for p in PRESSURES_MPA}
        for e in YOUNGS_MPA
    }
    middle = f"E = {YOUNGS_MPA[1]:g} MPa, {1e3 * PRESSURES_MPA[1]:g} kPa"
    figure = depth_figure(groups, mesh, values, slices_of=middle)
    save_figure(figure, folder / "credibility.png")


if __name__ == "__main__":
    main()
