"""Design factors (Section IV-B and IV-C1): how hard, how often, from how many sides, how noisy.

Two cubes of 10 mm and 0.2 MPa with a ball of 1 MPa, radius 0.2 sides, 0.3 (model 1) and 0.6
(model 2) sides below the top; Poisson's ratio 0.45; whole faces pressed, bottom on springs:

- p1 to p4: from above, up to 5, 10, 15 and 20 kPa in steps of 5 kPa (1, 2, 3, 4 frames);
- t2 to t9: from above, up to 20 kPa in 1, 2, 4 and 8 frames (the paper's header counts the
  unloaded one as well);
- dir1 to dir3: 8 frames up to 20 kPa from one, two and three sides (the paper does not say how
  many frames; "a consistent resolution");
- snr20, snr10: the three sides, with white noise of 20 and 10 dB on every press, as the ratio of
  powers (a tenth and a third of the signal's root mean square);
- amp20, amp10: the same as the ratio of amplitudes (a hundredth and a tenth), beside the paper's
  snr20 and snr10 once more. The paper does not define its dB; its scores at 20 dB are those
  without noise, so these may be its cells.

`same` inverts on the mesh that the presses were simulated on, as the paper does: an inverse
crime. `other` simulates on a mesh twice as fine. Every cell is inverted with the default settings,
started from 0.2 MPa everywhere as in the paper, which is the modulus of the cube around the
inclusion: a start that the paper's protocol leaks, and so do we, in both columns.
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
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.objects import MATERIAL, SIDES, START_MPA, stored_mesh
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.simulation import PressPlan, simulate
from tactorch.viz.paper import Panel, plot_curves, plot_panels

MODELS = {"model1": "cube_shallow_sphere", "model2": "cube_deep_sphere"}
METRICS = {"s": "normalised_correlation", "ssim": "ssim", "psnr": "psnr", "rmse_mpa": "rmse_mpa"}
MESHES = ("same", "other")
_KPA = 1e-3  # MPa
_LIMITS = (0.2, 1.0)  # of the colours, MPa: the two moduli
_FINER = 0.5
_PRESSURES, _FRAMES = ("p1", "p2", "p3", "p4"), ("t2", "t3", "t5", "t9")


@dataclass(frozen=True)
class Cell:
    """One column of Table II.

    Attributes:
        p_max_kpa: Highest pressure, kPa.
        frames: Presses on each side, in equal steps.
        sides: Pressed sides.
        snr_db: Of the noise; None for none.
        column: The paper's, where it is not the cell's own name; cells that differ in no more
            are one case.
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


def plan_of(cell: Cell) -> PressPlan:
    """Return the presses of one cell."""
    faces = SIDES[: cell.sides]
    return PressPlan(faces=faces, p_max_mpa=cell.p_max_kpa * _KPA, steps=cell.frames)


def record(
    model: str, cell: Cell, *, same_mesh: bool, relative_edge_length: float = 0.1
) -> Recording:
    """Simulate the presses of one cell."""
    phantom = make_phantom(MODELS[model])
    fine = _FINER * relative_edge_length
    return simulate(
        phantom,
        plan_of(cell),
        material=MATERIAL,
        mesh=phantom.mesh(relative_edge_length=relative_edge_length),
        fine_mesh=None if same_mesh else phantom.mesh(relative_edge_length=fine),
        samples=1 if same_mesh else 4,
        snr_db=cell.snr_db,
        seed=0,
    )


def cases(options: Mapping[str, Any]) -> list[Case]:
    """One for each model, mesh and distinct cell."""
    found: dict[str, Case] = {}
    for model in MODELS:
        for mesh in options["meshes"]:
            for cell in CELLS.values():
                name = _case_name(model, mesh, cell)
                settings = {k: v for k, v in asdict(cell).items() if k != "column"}
                shared = {"relative_edge_length": options["relative_edge_length"]}
                known = {"model": model, "mesh": mesh, **settings, **shared}
                found[name] = Case("design", name, known)
    return list(found.values())


def _case_name(model: str, mesh: str, cell: Cell) -> str:
    noise = "" if cell.snr_db is None else f"-snr{cell.snr_db:g}"
    return f"{model}-{mesh}-{cell.p_max_kpa:g}kpa-{cell.frames}frames-{cell.sides}sides{noise}"


def work(case: Case, scratch: Path) -> Outcome:
    """Simulate and invert one cell."""
    settings = dict(case.settings)
    model, mesh = settings.pop("model"), settings.pop("mesh")
    edge = settings.pop("relative_edge_length")
    recording = record(model, Cell(**settings), same_mesh=mesh == "same", relative_edge_length=edge)
    truth = recording.truth
    assert truth is not None
    blind = replace(recording, truth=None)
    found = invert(blind, Settings(), start_mpa=START_MPA, show_progress=False)
    return Outcome(
        {
            "scores": scores(recording.mesh, found.youngs, truth),
            "seconds": found.seconds,
            "iterations": found.iterations,
            "elements": recording.mesh.n_tets,
        },
        {
            "points": recording.mesh.points,
            "tets": recording.mesh.tets,
            "truth": truth,
            "youngs": found.youngs,
        },
    )


def table2(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Write Table II: four metrics of each cell, beside the paper's."""
    shown = ["s", "SSIM", "PSNR, dB", "RMSE, MPa"]
    heads = [f"{name}: {who}" for name in shown for who in ("paper", *options["meshes"])]
    count = 1 + len(options["meshes"])
    digits = [2 if metric == "psnr" else 4 for metric in METRICS for _ in range(count)]
    place_head = f"position error, mm: {options['meshes'][0]}"
    table = Table(["model", "cell", *heads, place_head], [None, None, *digits, 2])
    beaten = total = 0
    for model in MODELS:
        for name, cell in CELLS.items():
            found = _found(outcomes, options, model, cell)
            values: list[Any] = []
            for metric, key in METRICS.items():
                known = _of_paper(model, cell.column or name, metric)
                values += [known, *(None if o is None else o.figures["scores"][key] for o in found)]
            first = found[0]
            place = None if first is None else first.figures["scores"]["position_error_mm"]
            table.add(model, name, *values, place)
            if first is not None:
                better = first.figures["scores"]["ssim"] > values[len(found) + 1]
                total, beaten = total + 1, beaten + int(better)
    table.write_csv(out / "table2.csv")
    first_mesh = options["meshes"][0]
    return (
        f"{table.markdown()}\n\nSSIM ({first_mesh} mesh) above the paper's in {beaten} of {total}"
        " cells; amp20 and amp10 stand beside the paper's snr20 and snr10 once more."
    )


def _of_paper(model: str, column: str, metric: str) -> float:
    table = paper()["table2"]
    return float(table[model][metric][table["columns"].index(column)])


def _found(
    outcomes: Mapping[str, Outcome], options: Mapping[str, Any], model: str, cell: Cell
) -> list[Outcome | None]:
    return [outcomes.get(_case_name(model, mesh, cell)) for mesh in options["meshes"]]


def fig7(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 7: the maps of all cells, truth first."""
    rows: list[list[Panel]] = []
    for model in MODELS:
        line: list[Panel] = []
        for name, cell in CELLS.items():
            outcome = _found(outcomes, options, model, cell)[0]
            if outcome is None or cell.column is not None:
                continue
            mesh = stored_mesh(outcome.arrays)
            if not line:
                line.append(Panel(mesh, outcome.arrays["truth"], _LIMITS, title="truth"))
            similar = f"SSIM {outcome.figures['scores']['ssim']:.2f}"
            youngs = outcome.arrays["youngs"]
            line.append(Panel(mesh, youngs, _LIMITS, title=name, caption=similar))
        rows.append(line)
    plot_panels(rows, list(MODELS), out / "fig7.png")
    return f"![Maps of all cells, {options['meshes'][0]} mesh, middle slices across y](fig7.png)"


def fig8(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 8: similarity of each layer by depth; pressures above, frames below."""
    panels: dict[str, dict[str, np.ndarray]] = {}
    groups = {"highest pressure": _PRESSURES, "frames up to 20 kPa": _FRAMES}
    table = Table(["model", "cell", *(f"layer {i + 1}" for i in range(options["layers"]))])
    for group, names in groups.items():
        for model in MODELS:
            curves = {}
            for name in names:
                outcome = _found(outcomes, options, model, CELLS[name])[0]
                if outcome is not None:
                    cell = CELLS[name]
                    label = (
                        f"{cell.p_max_kpa:g} kPa"
                        if name[0] == "p"
                        else f"{cell.frames} frame{'s' if cell.frames > 1 else ''}"
                    )
                    curves[label] = _layers(outcome, options["layers"])
                    table.add(model, name, *curves[label].tolist())
            panels[f"{model}: {group}"] = curves
    table.write_csv(out / "fig8.csv")
    plot_curves(
        panels,
        out / "fig8.png",
        columns=2,
        across="depth (share of the height)",
        up="SSIM of the layer",
    )
    return "![Similarity to the truth by layer](fig8.png)"


def _layers(outcome: Outcome, count: int, voxels: int = 24) -> np.ndarray:
    """Similarity of each layer, the top one first: SSIM in 3-D, averaged over the layer."""
    mesh = stored_mesh(outcome.arrays)
    local = _similarity(mesh, outcome.arrays["youngs"], outcome.arrays["truth"], voxels)
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
