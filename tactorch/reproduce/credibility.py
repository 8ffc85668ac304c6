"""Credibility by depth, pressure and stiffness (Section III-D, eq. 14 and 15, Fig. 3).

The paper's object: a homogeneous unit cube of 5, 7.5 and 10 MPa, its top under 0.06, 0.10 and 0.14
MPa (strains of 0.6 to 3 %). The paper gives the unit neither of length nor of support: here it is
1 mm, on springs of 1 N/mm a node as elsewhere in the paper, Poisson's ratio 0.45. All three
displacements of the top's nodes are observed.

L(j) = max_i |du_i / de_j| is the metric of an element; a layer's integral is the sum of L over its
elements, those on a border shared out.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import InverseProblem
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import MATERIAL, stored_mesh
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.uncertainty import credibility, layer_profile
from tactorch.viz import depth_figure, save_figure

YOUNGS_MPA = (5.0, 7.5, 10.0)
PRESSURES_MPA = (0.06, 0.10, 0.14)
_SIDE_MM = 1.0


def metric(mesh: TetMesh, youngs_mpa: float, pressure_mpa: float) -> np.ndarray:
    """Return L of each element of the homogeneous cube, mm/MPa."""
    recording = simulate(
        make_phantom("uniform_cube", side_mm=float(mesh.bounds[1, 2]), youngs_mpa=youngs_mpa),
        PressPlan(("z+",), (pressure_mpa,)),
        mesh=mesh,
        material=MATERIAL,
    )
    evaluation = InverseProblem(recording).evaluate(np.full(mesh.n_tets, youngs_mpa))
    return credibility(evaluation).values


def profile(mesh: TetMesh, values: np.ndarray, layers: int) -> np.ndarray:
    """Return the sum of a metric over each layer, the top one first."""
    return layer_profile(mesh, values / mesh.volumes, 2, layers)[1][::-1]


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One a stiffness and pressure."""
    return [
        Case("credibility", _name(e, p), {"youngs_mpa": e, "pressure_mpa": p, **options})
        for e in YOUNGS_MPA
        for p in PRESSURES_MPA
    ]


def _name(youngs_mpa: float, pressure_mpa: float) -> str:
    return f"{1e3 * youngs_mpa:.0f}kpa-under-{1e3 * pressure_mpa:.0f}kpa"


def work(case: Case, scratch: Path) -> Outcome:
    """Compute the metric of one cube."""
    settings = case.settings
    mesh = box_mesh(_SIDE_MM, settings["divisions"], tets_per_cell=5)
    values = metric(mesh, settings["youngs_mpa"], settings["pressure_mpa"])
    return Outcome(
        {"layers": profile(mesh, values, settings["layers"]).tolist()},
        {"points": mesh.points, "tets": mesh.tets, "metric": values},
    )


def fig3(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 3: the fall with depth, and slices; say whether the paper's trends hold."""
    profiles = {
        (e, p): np.array(outcomes[_name(e, p)].figures["layers"])
        for e in YOUNGS_MPA
        for p in PRESSURES_MPA
        if _name(e, p) in outcomes
    }
    table = Table(["Young's modulus, MPa", "pressure, MPa", "layer from the top", "L, mm/MPa"],
                  [1, 2, None, 6])  # fmt: skip
    for (e, p), values in profiles.items():
        for i, value in enumerate(values, start=1):
            table.add(e, p, i, float(value))
    table.write_csv(out / "fig3.csv")
    groups = {
        f"E = {e:g} MPa": {f"{1e3 * p:g} kPa": profiles[e, p] for p in PRESSURES_MPA}
        for e in YOUNGS_MPA
    }
    middle = outcomes[_name(YOUNGS_MPA[1], PRESSURES_MPA[1])]
    mesh = stored_mesh(middle.arrays)
    # By volume: the element in a cell's middle is twice as large as the others.
    values = middle.arrays["metric"] / mesh.volumes
    curve = f"E = {YOUNGS_MPA[1]:g} MPa, {1e3 * PRESSURES_MPA[1]:g} kPa"
    save_figure(depth_figure(groups, mesh, values, slices_of=curve), out / "fig3.png")
    return "\n".join(
        (
            "| what the paper's Fig. 3 shows | here |",
            "| --- | --- |",
            f"| shallow layers are felt more | {_falls(profiles)} |",
            f"| higher pressure reaches deeper | {_rises(profiles, by='pressure')} |",
            f"| softer objects are felt deeper | {_rises(profiles, by='softness')} |",
            "",
            "![Credibility by depth, pressure and stiffness](fig3.png)",
        )
    )


def _falls(profiles: Mapping[tuple[float, float], np.ndarray]) -> str:
    falling = sum(bool((np.diff(values) < 0).all()) for values in profiles.values())
    drops = [values[0] / values[-1] for values in profiles.values()]
    return (
        f"in {falling} of {len(profiles)} cubes every layer counts less than the one above; the top"
        f" one {min(drops):.0f} to {max(drops):.0f} times as much as the lowest"
    )


def _rises(profiles: Mapping[tuple[float, float], np.ndarray], *, by: str) -> str:
    """Ratios of neighbouring profiles in every layer."""
    ratios = []
    for e, p in profiles:
        if by == "pressure" and p != PRESSURES_MPA[-1]:
            more = (e, PRESSURES_MPA[PRESSURES_MPA.index(p) + 1])
        elif by == "softness" and e != YOUNGS_MPA[0]:
            more = (YOUNGS_MPA[YOUNGS_MPA.index(e) - 1], p)
        else:
            continue
        ratios.append(profiles[more] / profiles[e, p])
    every = np.concatenate(ratios)
    return (
        f"in {np.mean(every > 1):.0%} of the layers each step counts more, by"
        f" {every.min():.2f} to {every.max():.2f} times"
    )


EXHIBITS = {"fig3": fig3}
