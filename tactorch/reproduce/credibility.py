"""Credibility by depth, pressure and stiffness (Section III-D, eq. 14 and 15, Fig. 3).

The object of the paper is a homogeneous unit cube of 5, 7.5 and 10 MPa under pressures of 0.06,
0.10 and 0.14 MPa on its top (strains of 0.6 to 3 %). The paper states neither the unit of length
nor the support: here it is 1 mm on springs of 1 N/mm per node, as elsewhere in the paper, with a
Poisson's ratio of 0.45. All three displacements of the top nodes are observed.

The metric of an element is L(j) = max_i |du_i / de_j|. The integral over a layer is the sum of L
over its elements; elements that cross a border are divided between layers.
"""

from pathlib import Path

import numpy as np

from tactorch.inverse import InverseProblem
from tactorch.inverse.posterior import credibility, layer_profile
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.paper import MATERIAL
from tactorch.simulation import PressPlan, simulate
from tactorch.viz import depth_figure

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
    return credibility(InverseProblem(recording).evaluate(np.full(mesh.n_tets, youngs_mpa)))


def layer_sums(mesh: TetMesh, values: np.ndarray, layers: int) -> np.ndarray:
    """Return the sum of a metric over each layer, the top one first."""
    return layer_profile(mesh, values / mesh.volumes, 2, layers)[1][::-1]


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return one case per stiffness and pressure."""
    return {
        _name(e, p): {"youngs_mpa": e, "pressure_mpa": p, **options}
        for e in YOUNGS_MPA
        for p in PRESSURES_MPA
    }


def _name(youngs_mpa: float, pressure_mpa: float) -> str:
    return f"{1e3 * youngs_mpa:.0f}kpa-under-{1e3 * pressure_mpa:.0f}kpa"


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Compute the metric of one cube."""
    mesh = box_mesh(_SIDE_MM, settings["divisions"], tets_per_cell=5)
    values = compute_metric(mesh, settings["youngs_mpa"], settings["pressure_mpa"])
    figures = {"layers": layer_sums(mesh, values, settings["layers"]).tolist()}
    return CaseResult.on_mesh(mesh, figures, metric=values)


def fig3(results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 3, layer integrals and slices, and whether the trends of the paper hold."""
    profiles = np.array(
        [[results[_name(e, p)].figures["layers"] for p in PRESSURES_MPA] for e in YOUNGS_MPA]
    )
    table = Table(
        {"Young's modulus, MPa": 1, "pressure, MPa": 2, "layer from the top": None, "L, mm/MPa": 6}
    )
    groups: dict[str, dict[str, np.ndarray]] = {}
    for e, by_pressure in zip(YOUNGS_MPA, profiles, strict=True):
        curves = groups[f"E = {e:g} MPa"] = {}
        for p, layers in zip(PRESSURES_MPA, by_pressure, strict=True):
            curves[f"{1e3 * p:g} kPa"] = layers
            for i, value in enumerate(layers.tolist(), start=1):
                table.add(e, p, i, value)
    middle = results[_name(YOUNGS_MPA[1], PRESSURES_MPA[1])]
    # Per volume, because the central element of a cell is twice as large as the others.
    values = middle.arrays["metric"] / middle.mesh.volumes
    curve = f"E = {YOUNGS_MPA[1]:g} MPa, {1e3 * PRESSURES_MPA[1]:g} kPa"
    decreasing = (np.diff(profiles) < 0).all(axis=2)
    drops = profiles[..., 0] / profiles[..., -1]
    text = (
        "| Fig. 3 of the paper | here |\n| --- | --- |\n"
        "| shallow layers have a higher credibility |"
        f" in {decreasing.sum()} of {decreasing.size} cubes it decreases from each layer to the"
        f" next; the top layer has {drops.min():.0f} to {drops.max():.0f} times the value of the"
        " lowest |\n"
        f"| higher pressure increases it | {_summary(profiles[:, 1:] / profiles[:, :-1])} |\n"
        f"| softer objects have a higher credibility | {_summary(profiles[:-1] / profiles[1:])} |"
    )
    figure = depth_figure(groups, middle.mesh, values, slices_of=curve)
    return Exhibit([text], table, figure, "Credibility by depth, pressure and stiffness")


def _summary(ratios: np.ndarray) -> str:
    """Return a summary of the ratios of neighbouring profiles in every layer."""
    return (
        f"in {np.mean(ratios > 1):.0%} of the layers each step increases it, by a factor of"
        f" {ratios.min():.2f} to {ratios.max():.2f}"
    )


EXHIBITS = {"fig3": fig3}
