"""A simulated stiff lesion in the anatomy of a breast, for `scale.py`: the fine DigiBreast mesh.

The breast (Deng et al., 2015) is compressed for mammography, 226 x 131 x 31 mm. Young's
modulus goes from 0.02 (fat) to 0.05 MPa (gland) with the glandularity of the data set, and is 0.3
MPa in a ball of 8 mm radius about the data set's fibroglandular lesion centroid, 15 mm below the
upper face; the figures are those of Krouskop et al. (1998) for tissue under 20 % compression,
rounded. The chest wall is held, the lower face rests on a plate, and twelve soft fingers of 15 mm
radius press on the upper face, one after the other; only the nodes under the finger are observed,
with 1 % noise.

No inverse crime: the presses are computed with quadratic elements (eight times the unknowns) on
another mesh of the same surface, the data set's with its interior nodes moved at random by about a
quarter of an edge, whose elements sample ball and glandularity on their own; the inversion has
linear elements on the data set's mesh, corrects for their error on a homogeneous breast
(`model_error`, which does not use the other mesh), and starts from the uniform modulus that
fits best. Of that error 0.07 stays as uncertainty: so much is left, on average over the presses, by
balls drawn at random, not by the truth; it is 0.00 to 0.03 at most presses and 0.6 with a ball
under the finger (`python benchmarks/breast.py --left RECORDING`). The lesion is the largest
connected region past half way from the map's median to its extreme
(`tactorch.metrics.find_inclusion`), without use of the truth.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from machine import peak_gib

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.transfer import Transfer
from tactorch.inverse import (
    InverseProblem,
    NewtonCG,
    Settings,
    best_uniform,
    homogeneous,
    invert_map,
)
from tactorch.mesh import TetMesh, locate
from tactorch.mesh.geometry import signed_volumes
from tactorch.metrics import find_inclusion, position_error_mm, scores
from tactorch.recording import MaterialSpec, Press, Recording

WHERE = "data/digibreast of the shared data (TACTORCH_SHARED or ../shared)"
FAT, GLAND, LESION = 0.02, 0.05, 0.3  # MPa
CENTRE, RADIUS = np.array([140.625, 49.2341, 15.0]), 8.0  # mm
FINGER, PRESSURE, PLACES = 15.0, 0.006, (  # mm, MPa at the middle, (x, y) mm
    *((x, 5.0) for x in (70.0, 110.0, 150.0, 190.0, 230.0)),
    *((x, 40.0) for x in (90.0, 130.0, 170.0, 210.0)),
    *((x, 72.0) for x in (110.0, 150.0, 190.0)),
)  # fmt: skip
NOISE, POISSON, UPRIGHT = 0.01, 0.45, 0.8
MOVED, FLATTEST = 0.25, 0.25  # of an edge; of an element's volume
LEFT = 0.07  # of the mesh's error, once it is taken off


def folder() -> Path | None:
    """The data set's folder, or None."""
    default = Path(__file__).resolve().parents[2] / "shared"
    path = Path(os.environ.get("TACTORCH_SHARED") or default) / "data" / "digibreast"
    return path if (path / "digibreast_fine.npz").is_file() else None


@dataclass(frozen=True, eq=False)
class Breast:
    """The data set's mesh, mm, and the glandularity of each element, 0 to 1."""

    mesh: TetMesh
    glandularity: np.ndarray

    @staticmethod
    def load(path: Path) -> "Breast":
        """Read the fine mesh."""
        with np.load(path / "digibreast_fine.npz") as data:
            mesh = TetMesh.create(1e3 * data["points_m"], data["tets"])
            return Breast(mesh, data["glandularity_truth"][mesh.tets].mean(axis=1))

    def other_mesh(self, seed: int = 0) -> TetMesh:
        """Move the interior nodes at random; those that would flatten an element, less."""
        mesh, rng = self.mesh, np.random.default_rng(seed)
        ends = mesh.points[mesh.edges]
        edge = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
        shift = MOVED * edge * rng.standard_normal(mesh.points.shape)
        shift[np.unique(mesh.surface.triangles)] = 0.0
        for _ in range(20):
            volumes = signed_volumes(mesh.points + shift, mesh.tets)
            flat = volumes < FLATTEST * mesh.volumes
            if not flat.any():
                return TetMesh.create(mesh.points + shift, mesh.tets, repair=False)
            shift[np.unique(mesh.tets[flat])] *= 0.6
        raise RuntimeError("the interior nodes cannot be moved so far")

    def moduli(self, mesh: TetMesh) -> np.ndarray:
        """True moduli on any mesh of the breast, each element's mean over four points, MPa."""
        from tactorch.mesh.quadrature import element_means

        return element_means(mesh, self._at, 2)

    def _at(self, points: np.ndarray) -> np.ndarray:
        from scipy.spatial import cKDTree

        held = locate(self.mesh, points)
        outside = held < 0
        held[outside] = cKDTree(self.mesh.centroids).query(points[outside])[1]
        tissue = FAT + self.glandularity[held] * (GLAND - FAT)
        return np.where(np.linalg.norm(points - CENTRE, axis=1) <= RADIUS, LESION, tissue)


def facing(mesh: TetMesh, axis: int, sign: float) -> np.ndarray:
    """Surface triangles that face along an axis, within about 37 degrees."""
    return np.flatnonzero(sign * mesh.surface.normals[:, axis] > UPRIGHT)


def held(mesh: TetMesh) -> np.ndarray:
    """Degrees of freedom held: the chest wall, and the lower face along z."""
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[np.unique(mesh.surface.triangles[facing(mesh, 2, -1.0)]), 2] = True
    fixed[np.unique(mesh.surface.triangles[facing(mesh, 1, -1.0)])] = True
    return fixed


def finger_forces(mesh: TetMesh, place: tuple[float, float]) -> np.ndarray:
    """Nodal forces of a soft finger, N: downward, p (1 - r^2 / R^2), of equal total on any mesh."""
    forces = np.zeros((mesh.n_points, 3))
    chosen = facing(mesh, 2, 1.0)
    triangles = mesh.surface.triangles[chosen]
    areas = mesh.surface.areas[chosen] * mesh.surface.normals[chosen, 2]
    n = 6  # points along an edge
    grid = [(i + 1 / 3, j + 1 / 3) for i in range(n) for j in range(n - i)]
    grid += [(i + 2 / 3, j + 2 / 3) for i in range(n) for j in range(n - i - 1)]
    for a, b in np.array(grid) / n:
        shares = np.array([1 - a - b, a, b])
        points = np.einsum("c,tcd->td", shares, mesh.points[triangles])
        square = ((points[:, :2] - np.array(place)) ** 2).sum(axis=1) / FINGER**2
        load = PRESSURE * np.maximum(1.0 - square, 0.0) * areas / len(grid)
        for corner in range(3):
            np.add.at(forces[:, 2], triangles[:, corner], -shares[corner] * load)
    return forces * (0.5 * PRESSURE * np.pi * FINGER**2 / -forces[:, 2].sum())


def touched(mesh: TetMesh, place: tuple[float, float]) -> np.ndarray:
    """All components of the upper nodes under the finger."""
    nodes = np.unique(mesh.surface.triangles[facing(mesh, 2, 1.0)])
    near = np.linalg.norm(mesh.points[nodes, :2] - np.array(place), axis=1) <= FINGER
    observed = np.zeros((mesh.n_points, 3), dtype=bool)
    observed[nodes[near]] = True
    return observed


def displacements(
    mesh: TetMesh, youngs: np.ndarray, element: str, points: np.ndarray
) -> list[np.ndarray]:
    """Displacement at points by each press, mm; one factorisation goes from press to press."""
    body = SoftBody(mesh, make_material("neo_hookean", POISSON), element=element)
    supports, transfer = Supports(fixed=held(mesh)), Transfer.between(body.discretisation, points)
    out, search = [], None
    for place in PLACES:
        search = body.search(youngs, finger_forces(mesh, place), supports, after=search)
        out.append(transfer(search.run().require().displacement))
    return out


def record(breast: Breast) -> Recording:
    """Press the breast on the other mesh, and record on the data set's."""
    mesh, other = breast.mesh, breast.other_mesh()
    moved = displacements(other, breast.moduli(other), "tet10", mesh.points)
    presses = []
    for i, place in enumerate(PLACES):
        seen = touched(mesh, place)
        noise = NOISE * float(np.sqrt(np.mean(moved[i][seen] ** 2)))
        drawn = np.random.default_rng([0, i]).normal(scale=noise, size=moved[i].shape)
        presses.append(
            Press(
                finger_forces(mesh, place),
                seen,
                moved[i] + drawn,
                fixed=held(mesh),
                noise_mm=noise,
                direction=np.array([0.0, 0.0, -1.0]),
                name=f"finger at ({place[0]:g}, {place[1]:g}) mm",
            )
        )
    about = {"source": "DigiBreast, fine mesh", "other_mesh_tets": other.n_tets}
    truth = breast.moduli(mesh)
    material = MaterialSpec("neo_hookean", POISSON)
    return Recording(mesh, tuple(presses), material, truth=truth, provenance=about)


def _size(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def inverted(recording: Recording, picture: Path | None, limit: float | None) -> dict[str, Any]:
    """Invert, find the lesion, draw the slices; returns the figures."""
    settings = Settings(optimizer=NewtonCG(), residual_model_error_fraction=LEFT, max_seconds=limit)
    blind = replace(recording, truth=None)
    began = time.perf_counter()
    found = invert_map(blind, settings, start_mpa=homogeneous, show_progress=False)
    seconds = time.perf_counter() - began  # with the model's error, which comes before the search
    lesion = find_inclusion(recording.mesh, found.youngs)
    truth = recording.truth
    assert truth is not None
    figures = {
        "elements": recording.mesh.n_tets,
        "simulated_on": recording.provenance["other_mesh_tets"],
        "presses": len(recording.presses),
        "data": int(sum(press.data.sum() for press in recording.presses)),
        "seconds": seconds,
        "search_seconds": found.seconds,
        "cpu_seconds": time.process_time(),
        "peak_gib": peak_gib(),
        "iterations": found.iterations,
        "chi2": found.history[-1]["chi2"],
        "stop_reason": found.stop_reason,
        "pearson": scores(recording.mesh, found.youngs, truth)["pearson"],
        "position_error_by_half_way_mm": position_error_mm(recording.mesh, found.youngs, truth),
        "lesion": None,
    }  # fmt: skip
    if lesion is not None:
        figures["lesion"] = {
            "side": lesion.side,
            "center_mm": lesion.center_mm.tolist(),
            "position_error_mm": float(np.linalg.norm(lesion.center_mm - CENTRE)),
            "equivalent_radius_mm": lesion.equivalent_radius_mm,
            "mean_mpa": lesion.mean_mpa,
        }
    if picture is not None:
        draw(recording.mesh, truth, found.youngs, picture)
    return figures


def share_left(recording: Recording, seed: int = 0) -> float:
    """Mean share that the correction leaves of a press's error where moduli are drawn."""
    problem = InverseProblem(recording)
    finer = InverseProblem(recording, element="tet10")
    uniform = np.full(recording.mesh.n_tets, best_uniform(problem))
    drawn = uniform * np.exp(_draw_logs(recording.mesh, np.random.default_rng([seed, 7])))
    shares = []
    for (plain, fine), (drawn_plain, drawn_fine) in zip(
        _predictions(problem, finer, uniform), _predictions(problem, finer, drawn), strict=True
    ):
        extent = float(drawn_fine @ fine) / float(fine @ fine)  # as `discretisation_error` does
        left = drawn_fine - drawn_plain - extent * (fine - plain)
        shares.append(_size(left) / (extent * _size(fine - plain)))
    print(f"# by press: {np.round(shares, 3).tolist()}", flush=True)
    return float(np.mean(shares))


def _draw_logs(mesh: TetMesh, rng: np.random.Generator) -> np.ndarray:
    """Changes of log-moduli: three balls of 6 to 12 mm radius."""
    logs = np.zeros(mesh.n_tets)
    for _ in range(3):
        gaps = np.linalg.norm(mesh.centroids - mesh.centroids[rng.integers(mesh.n_tets)], axis=1)
        logs[gaps < rng.uniform(6.0, 12.0)] += rng.uniform(-1.0, 2.3)
    return logs


def _predictions(
    problem: InverseProblem, finer: InverseProblem, youngs: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Displacements seen in each press, mm, by plain elements and by finer ones."""
    plain, fine = (p.evaluate(youngs, chained=True).reported for p in (problem, finer))
    seen = [one.index for one in problem.data.observations]
    return [(a.ravel()[i], b.ravel()[i]) for a, b, i in zip(plain, fine, seen, strict=True)]


def draw(mesh: TetMesh, truth: np.ndarray, youngs: np.ndarray, path: Path) -> None:
    """Draw slices through the lesion's centre, truth above reconstruction."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    panels = figure.subplots(3, 2, height_ratios=[2.2, 0.8, 0.8])
    low, high = mesh.bounds
    for row, (across, up, axis) in enumerate([(0, 1, 2), (0, 2, 1), (1, 2, 0)]):
        ticks = [np.arange(low[a], high[a], 0.75) for a in (across, up)]
        points = np.empty((len(ticks[1]), len(ticks[0]), 3))
        points[..., across], points[..., up] = np.meshgrid(*ticks)
        points[..., axis] = CENTRE[axis]
        inside = locate(mesh, points.reshape(-1, 3)).reshape(points.shape[:2])
        for axes, values, name in zip(
            panels[row], (truth, youngs), ("truth", "found"), strict=True
        ):
            image = axes.imshow(
                np.where(inside >= 0, 1e3 * values[inside], np.nan),
                extent=(low[across], high[across], low[up], high[up]),
                origin="lower",
                norm=LogNorm(10.0, 400.0),
            )
            angle = np.linspace(0.0, 2.0 * np.pi, 100)
            axes.plot(CENTRE[across] + RADIUS * np.cos(angle), CENTRE[up] + RADIUS * np.sin(angle),
                      "w--", linewidth=0.8)  # fmt: skip
            if axis == 2:
                for x, y in PLACES:
                    axes.plot(x + FINGER * np.cos(angle), y + FINGER * np.sin(angle), "w:",
                              linewidth=0.6)  # fmt: skip
            axes.set_title(f"{name}, {'xyz'[axis]} = {CENTRE[axis]:.4g} mm", fontsize=9)
            axes.set_xlabel(f"{'xyz'[across]} (mm)")
            axes.set_ylabel(f"{'xyz'[up]} (mm)")
    figure.colorbar(image, ax=panels, label="Young's modulus (kPa)", shrink=0.7)
    figure.savefig(path, dpi=110)


def run(data: Path, out: Path | None, max_seconds: float | None) -> dict[str, Any]:
    """Simulate in one process, invert in another; returns the figures."""
    with TemporaryDirectory() as name:
        file = Path(name) / "breast.h5"
        began = time.perf_counter()
        _child("--simulate", str(file), "--data", str(data))
        simulating = time.perf_counter() - began
        more = [] if max_seconds is None else ["--max-seconds", str(max_seconds)]
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            more += ["--picture", str(out / "breast.png")]
        figures = json.loads(_child("--invert", str(file), *more).splitlines()[-1])
    return {**figures, "simulation_seconds": simulating}


def _child(*arguments: str) -> str:
    command = [sys.executable, str(Path(__file__).resolve()), *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def table(figures: dict[str, Any]) -> str:
    """One line about the breast."""
    lesion = figures["lesion"]
    text = "no lesion stands out"
    if lesion is not None:
        text = (
            f"the {lesion['side']} region found is {lesion['position_error_mm']:.1f} mm from the "
            f"lesion's centre, radius {lesion['equivalent_radius_mm']:.1f} mm (truth {RADIUS:g}), "
            f"{lesion['mean_mpa']:.3g} MPa (truth {LESION:g})"
        )
    return (
        f"DigiBreast, {figures['elements']} tetrahedra, {figures['presses']} presses: "
        f"{figures['seconds']:.0f} s, {figures['peak_gib']:.2f} GiB; {text}."
    )


def main() -> None:
    """Simulate or invert for `run`, or print the remaining model error of a recording."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulate", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--invert", type=Path)
    parser.add_argument("--left", type=Path)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--max-seconds", type=float)
    options = parser.parse_args()
    if options.simulate is not None:
        record(Breast.load(options.data)).save(options.simulate)
    if options.left is not None:
        print(json.dumps(share_left(Recording.load(options.left))))
    if options.invert is not None:
        recording = Recording.load(options.invert)
        print(json.dumps(inverted(recording, options.picture, options.max_seconds)))


if __name__ == "__main__":
    main()
