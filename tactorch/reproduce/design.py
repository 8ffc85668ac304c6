"""Design factors (Sections IV-B and IV-C1): pressure, number of frames, pressed sides and noise.

Two cubes of 10 mm and 0.2 MPa contain a ball of 1 MPa with a radius of 0.2 sides, 0.3 (model 1)
and 0.6 (model 2) sides below the top. Poisson's ratio is 0.45; complete sides are pressed, with
the bottom on springs:

- p1 to p4: from above, up to 5, 10, 15 and 20 kPa in steps of 5 kPa (1, 2, 3, 4 frames);
- t2 to t9: from above, up to 20 kPa in 1, 2, 4 and 8 frames (the header of the paper also counts
  the unloaded frame);
- dir1 to dir3: 8 frames up to 20 kPa from one, two and three sides (the paper does not state the
  number of frames; "a consistent resolution");
- snr20, snr10: three sides, with white noise of 20 and 10 dB on every press as a ratio of powers
  (a tenth and a third of the RMS of the signal);
- amp20, amp10: the same as a ratio of amplitudes (a hundredth and a tenth), compared to snr20 and
  snr10 of the paper again. The paper does not define its dB; its scores at 20 dB equal those
  without noise, which suggests amplitudes.

`same` inverts on the mesh of the simulation, as the paper does, which is an inverse crime. `other`
simulates on a mesh twice as fine. Every cell is inverted with the default settings from 0.2 MPa,
as in the paper. This is the true modulus outside the inclusion: the protocol of the paper leaks it
to the inversion, in both columns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.inverse import Settings, invert
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics import scores
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.objects import MATERIAL, SIDES, START_MPA, mesh_arrays, stored_mesh
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.viz.paper import Panel, plot_curves, plot_panels

MODELS = {"model1": "cube_shallow_sphere", "model2": "cube_deep_sphere"}
METRICS = {"s": "normalised_correlation", "ssim": "ssim", "psnr": "psnr", "rmse_mpa": "rmse_mpa"}
MESHES = ("same", "other")
_KPA = 1e-3  # MPa
_LIMITS = (0.2, 1.0)  # colour scale, MPa: the two moduli
_REFINEMENT = 0.5
_PRESSURES, _FRAMES = ("p1", "p2", "p3", "p4"), ("t2", "t3", "t5", "t9")


@dataclass(frozen=True)
class Cell:
    """One column of Table II.

    Attributes:
        p_max_kpa: Maximum pressure, kPa.
        frames: Number of presses on each side, in equal steps.
        sides: Number of pressed sides.
        snr_db: Signal-to-noise ratio, dB; None without noise.
        column: Column of the paper if it differs from the name of the cell; cells that differ in
            nothing else are one case.
    """

    p_max_kpa: float = 20.0
    frames: int = 8
    sides: int = 1
    snr_db: float | None = None
    column: str | None = field(default=None, compare=False)


CELLS = {
    **{f"p{k}": Cell(p_max_kpa=5.0 * k, frames=k) for k in (1, 2, 3, 4)},
    **{f"t{t + 1}": Cell(frames=t) for t in (1, 2, 4, 8)},
    **{f"dir{n}": Cell(sides=n) for n in (1, 2, 3)},
    "snr20": Cell(sides=3, snr_db=20.0),
    "snr10": Cell(sides=3, snr_db=10.0),
    "amp20": Cell(sides=3, snr_db=40.0, column="snr20"),
    "amp10": Cell(sides=3, snr_db=20.0, column="snr10"),
}


def make_plan(cell: Cell) -> PressPlan:
    """Return the presses of one cell."""
    faces = SIDES[: cell.sides]
    return PressPlan(faces=faces, p_max_mpa=cell.p_max_kpa * _KPA, steps=cell.frames)


def simulate_cell(
    model: str, cell: Cell, *, same_mesh: bool, relative_edge_length: float = 0.1
) -> Recording:
    """Simulate the presses of one cell."""
    phantom = make_phantom(MODELS[model])
    fine = _REFINEMENT * relative_edge_length
    return simulate(
        phantom,
        make_plan(cell),
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=relative_edge_length),
        fine_mesh=None if same_mesh else phantom.mesh(relative_edge_length=fine),
        samples=1 if same_mesh else 4,
        snr_db=cell.snr_db,
        seed=0,
    )


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return one case per model, mesh and distinct cell."""
    named: dict[str, Case] = {}
    for model in MODELS:
        for mesh in options["meshes"]:
            for cell in CELLS.values():
                name = _case_name(model, mesh, cell)
                settings = {k: v for k, v in asdict(cell).items() if k != "column"}
                shared = {"relative_edge_length": options["relative_edge_length"]}
                values = {"model": model, "mesh": mesh, **settings, **shared}
                named[name] = Case("design", name, values)
    return list(named.values())


def _case_name(model: str, mesh: str, cell: Cell) -> str:
    noise = "" if cell.snr_db is None else f"-snr{cell.snr_db:g}"
    return f"{model}-{mesh}-{cell.p_max_kpa:g}kpa-{cell.frames}frames-{cell.sides}sides{noise}"


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Simulate and invert one cell."""
    settings = dict(case.settings)
    model, mesh = settings.pop("model"), settings.pop("mesh")
    edge = settings.pop("relative_edge_length")
    recording = simulate_cell(
        model, Cell(**settings), same_mesh=mesh == "same", relative_edge_length=edge
    )
    truth = recording.truth
    assert truth is not None
    blind = replace(recording, truth=None)
    reconstruction = invert(blind, Settings(), start_mpa=START_MPA, show_progress=False)
    return CaseResult(
        {
            "scores": scores(recording.mesh, reconstruction.youngs, truth),
            "seconds": reconstruction.seconds,
            "iterations": reconstruction.iterations,
            "elements": recording.mesh.n_tets,
        },
        mesh_arrays(recording.mesh, truth=truth, youngs=reconstruction.youngs),
    )


def table2(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Write Table II: four metrics of each cell and of the paper."""
    shown = ["s", "SSIM", "PSNR, dB", "RMSE, MPa"]
    heads = [f"{name}: {who}" for name in shown for who in ("paper", *options["meshes"])]
    count = 1 + len(options["meshes"])
    digits = [2 if metric == "psnr" else 4 for metric in METRICS for _ in range(count)]
    position_head = f"position error, mm: {options['meshes'][0]}"
    table = Table(["model", "cell", *heads, position_head], [None, None, *digits, 2])
    better = total = 0
    for model in MODELS:
        for name, cell in CELLS.items():
            by_mesh = _results_by_mesh(results, options, model, cell)
            values: list[Any] = []
            for metric, key in METRICS.items():
                values.append(_paper_value(model, cell.column or name, metric))
                values += [None if o is None else o.figures["scores"][key] for o in by_mesh]
            first = by_mesh[0]
            position = None if first is None else first.figures["scores"]["position_error_mm"]
            table.add(model, name, *values, position)
            if first is not None:
                total += 1
                better += int(first.figures["scores"]["ssim"] > values[len(by_mesh) + 1])
    table.write_csv(out / "table2.csv")
    first_mesh = options["meshes"][0]
    return (
        f"{table.markdown()}\n\nSSIM ({first_mesh} mesh) above that of the paper in {better} of"
        f" {total} cells; amp20 and amp10 are compared to snr20 and snr10 of the paper again."
    )


def _paper_value(model: str, column: str, metric: str) -> float:
    table = paper()["table2"]
    return float(table[model][metric][table["columns"].index(column)])


def _results_by_mesh(
    results: Mapping[str, CaseResult], options: Mapping[str, Any], model: str, cell: Cell
) -> list[CaseResult | None]:
    return [results.get(_case_name(model, mesh, cell)) for mesh in options["meshes"]]


def fig7(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 7: maps of all cells, starting with the truth."""
    rows: list[list[Panel]] = []
    for model in MODELS:
        line: list[Panel] = []
        for name, cell in CELLS.items():
            result = _results_by_mesh(results, options, model, cell)[0]
            if result is None or cell.column is not None:
                continue
            mesh = stored_mesh(result.arrays)
            if not line:
                line.append(Panel(mesh, result.arrays["truth"], _LIMITS, title="truth"))
            caption = f"SSIM {result.figures['scores']['ssim']:.2f}"
            youngs = result.arrays["youngs"]
            line.append(Panel(mesh, youngs, _LIMITS, title=name, caption=caption))
        rows.append(line)
    plot_panels(rows, list(MODELS), out / "fig7.png")
    return f"![Maps of all cells, {options['meshes'][0]} mesh, middle slices across y](fig7.png)"


def fig8(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 8: similarity of each layer by depth, for pressures (top) and frames (bottom)."""
    panels: dict[str, dict[str, np.ndarray]] = {}
    groups = {"maximum pressure": _PRESSURES, "frames up to 20 kPa": _FRAMES}
    table = Table(["model", "cell", *(f"layer {i + 1}" for i in range(options["layers"]))])
    for group, names in groups.items():
        for model in MODELS:
            curves = {}
            for name in names:
                result = _results_by_mesh(results, options, model, CELLS[name])[0]
                if result is not None:
                    cell = CELLS[name]
                    label = (
                        f"{cell.p_max_kpa:g} kPa"
                        if name[0] == "p"
                        else f"{cell.frames} frame{'s' if cell.frames > 1 else ''}"
                    )
                    curves[label] = _layers(result, options["layers"])
                    table.add(model, name, *curves[label].tolist())
            panels[f"{model}: {group}"] = curves
    table.write_csv(out / "fig8.csv")
    plot_curves(
        panels,
        out / "fig8.png",
        columns=2,
        across="depth (fraction of the height)",
        up="SSIM of the layer",
    )
    return "![Similarity to the truth by layer](fig8.png)"


def _layers(result: CaseResult, count: int, voxels: int = 24) -> np.ndarray:
    """Return the 3-D SSIM averaged over each layer, the top one first."""
    mesh = stored_mesh(result.arrays)
    local = _similarity(mesh, result.arrays["youngs"], result.arrays["truth"], voxels)
    return np.array([part.mean() for part in np.array_split(local[:, :, ::-1], count, axis=2)])


def _similarity(
    mesh: TetMesh, youngs: np.ndarray, truth: np.ndarray, voxels: int, window: int = 7
) -> np.ndarray:
    from skimage.metrics import structural_similarity

    grid = VoxelGrid(mesh, voxels)
    pair: Sequence[np.ndarray] = (grid.fill(youngs), grid.fill(truth))
    _, local = structural_similarity(*pair, win_size=window, data_range=1.0, full=True)
    return local


EXHIBITS = {"table2": table2, "fig7": fig7, "fig8": fig8}
