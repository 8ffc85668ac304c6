"""Credibility by depth, pressure and stiffness (Section III-D, eq. 14 and 15, Fig. 3).

The object of the paper is a homogeneous unit cube of 5, 7.5 and 10 MPa under pressures of 0.06,
0.10 and 0.14 MPa on its top (strains of 0.6 to 3 %). The paper states neither the unit of length
nor the support: here it is 1 mm on springs of 1 N/mm per node, as elsewhere in the paper, with a
Poisson's ratio of 0.45. All three displacements of the top nodes are observed.

The metric of an element is L(j) = max_i |du_i / de_j|. The integral over a layer is the sum of L
over its elements; elements that cross a border are divided between layers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import InverseProblem
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.objects import MATERIAL, mesh_arrays, stored_mesh
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.uncertainty import credibility, layer_profile
from tactorch.viz import depth_figure, save_figure

YOUNGS_MPA = (5.0, 7.5, 10.0)
PRESSURES_MPA = (0.06, 0.10, 0.14)
_SIDE_MM = 1.0


def compute_metric(mesh: TetMesh, youngs_mpa: float, pressure_mpa: float) -> np.ndarray:
    """Return L of each element of the homogeneous cube, mm/MPa."""
    recording = simulate(
        make_phantom("uniform_cube", side_mm=float(mesh.bounds[1, 2]), youngs_mpa=youngs_mpa),
        PressPlan(("z+",), (pressure_mpa,)),
        mesh=mesh,
        material=MATERIAL,
    )
    evaluation = InverseProblem(recording).evaluate(np.full(mesh.n_tets, youngs_mpa))
    return credibility(evaluation).values


def layer_sums(mesh: TetMesh, values: np.ndarray, layers: int) -> np.ndarray:
    """Return the sum of a metric over each layer, the top one first."""
    return layer_profile(mesh, values / mesh.volumes, 2, layers)[1][::-1]


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return one case per stiffness and pressure."""
    return [
        Case("credibility", _name(e, p), {"youngs_mpa": e, "pressure_mpa": p, **options})
        for e in YOUNGS_MPA
        for p in PRESSURES_MPA
    ]


def _name(youngs_mpa: float, pressure_mpa: float) -> str:
    return f"{1e3 * youngs_mpa:.0f}kpa-under-{1e3 * pressure_mpa:.0f}kpa"


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Compute the metric of one cube."""
    settings = case.settings
    mesh = box_mesh(_SIDE_MM, settings["divisions"], tets_per_cell=5)
    values = compute_metric(mesh, settings["youngs_mpa"], settings["pressure_mpa"])
    return CaseResult(
        {"layers": layer_sums(mesh, values, settings["layers"]).tolist()},
        mesh_arrays(mesh, metric=values),
    )


def fig3(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 3, layer integrals and slices, and return whether the trends of the paper hold."""
    profiles = {
        (e, p): np.array(results[_name(e, p)].figures["layers"])
        for e in YOUNGS_MPA
        for p in PRESSURES_MPA
        if _name(e, p) in results
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
    middle = results[_name(YOUNGS_MPA[1], PRESSURES_MPA[1])]
    mesh = stored_mesh(middle.arrays)
    # Per volume, because the central element of a cell is twice as large as the others.
    values = middle.arrays["metric"] / mesh.volumes
    curve = f"E = {YOUNGS_MPA[1]:g} MPa, {1e3 * PRESSURES_MPA[1]:g} kPa"
    save_figure(depth_figure(groups, mesh, values, slices_of=curve), out / "fig3.png")
    return "\n".join(
        (
            "| Fig. 3 of the paper | here |",
            "| --- | --- |",
            f"| shallow layers have a higher credibility | {_decrease(profiles)} |",
            f"| higher pressure increases it | {_increase(profiles, by='pressure')} |",
            f"| softer objects have a higher credibility | {_increase(profiles, by='softness')} |",
            "",
            "![Credibility by depth, pressure and stiffness](fig3.png)",
        )
    )


def _decrease(profiles: Mapping[tuple[float, float], np.ndarray]) -> str:
    decreasing = sum(bool((np.diff(values) < 0).all()) for values in profiles.values())
    drops = [values[0] / values[-1] for values in profiles.values()]
    return (
        f"in {decreasing} of {len(profiles)} cubes it decreases from each layer to the next;"
        f" the top layer has {min(drops):.0f} to {max(drops):.0f} times the value of the lowest"
    )


def _increase(profiles: Mapping[tuple[float, float], np.ndarray], *, by: str) -> str:
    """Return a summary of the ratios of neighbouring profiles in every layer."""
    ratios = []
    for e, p in profiles:
        if by == "pressure" and p != PRESSURES_MPA[-1]:
            larger = (e, PRESSURES_MPA[PRESSURES_MPA.index(p) + 1])
        elif by == "softness" and e != YOUNGS_MPA[0]:
            larger = (YOUNGS_MPA[YOUNGS_MPA.index(e) - 1], p)
        else:
            continue
        ratios.append(profiles[larger] / profiles[e, p])
    layers = np.concatenate(ratios)
    return (
        f"in {np.mean(layers > 1):.0%} of the layers each step increases it, by a factor of"
        f" {layers.min():.2f} to {layers.max():.2f}"
    )


EXHIBITS = {"fig3": fig3}
