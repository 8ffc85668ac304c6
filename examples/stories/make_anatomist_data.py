"""Make the data of the story of an anatomist: a surface and the table of an indenter.

    python examples/stories/make_anatomist_data.py FOLDER

A block of soft tissue, 30 x 24 x 18 mm, has a stiff ball and stands on a plate. The indenter is a
membrane that presses on one side at a time; a camera measures the displacement of marks on it. The
presses are simulated with quadratic elements on a mesh that follows the ball. It is not the mesh of
the inversion, which the story makes from the surface alone. The files are

    specimen.stl   surface, mm
    indenter.csv   position, displacement and force of each mark, with noise
    truth.json     what is inside, which the story does not read

Displacements have noise of 0.06 mm, the forces of each press a common error of 1 %. Files that are
there are kept.
"""

import argparse
import csv
import json
from pathlib import Path

import meshio
import numpy as np

from tactorch import Phantom, SoftBody, make_material
from tactorch.fem import Supports
from tactorch.mesh import BodyFile, Sphere, TetMesh, box_mesh, select_face

SIZE_MM = (30.0, 24.0, 18.0)
CENTER_MM, RADIUS_MM = (18.0, 11.0, 12.0), 4.5
TISSUE_MPA, BALL_MPA, POISSON = 0.02, 0.2, 0.45
PRESSURES_MPA = {"z+": 0.002, "x+": 0.0007, "y+": 0.0007}
NOISE_MM, FORCE_ERROR = 0.06, 0.01
EDGE_MM = 2.6  # of the mesh of the simulation
COLUMNS = ["press", "x_mm", "y_mm", "z_mm", "ux_mm", "uy_mm", "uz_mm", "fx_n", "fy_n", "fz_n"]


def main() -> None:
    """Write the files that are not there."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    make(parser.parse_args().folder)


def make(folder: Path) -> None:
    """Write the files into a folder, unless it has them all; `truth.json` is the last one."""
    if (folder / "truth.json").is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    block = box_mesh(SIZE_MM, (5, 4, 3))
    meshio.write_points_cells(
        folder / "specimen.stl", block.points, [("triangle", block.surface.triangles)]
    )
    ball = Sphere(CENTER_MM, RADIUS_MM)
    phantom = Phantom(BodyFile(str(folder / "specimen.stl")), [(ball, BALL_MPA)], TISSUE_MPA)
    mesh = phantom.mesh(EDGE_MM, conforming=True)
    rows = press(mesh, phantom.on_mesh(mesh, 1))
    with open(folder / "indenter.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows([side, *(f"{value:.5g}" for value in values)] for side, values in rows)
    truth = {"center_mm": CENTER_MM, "radius_mm": RADIUS_MM, "youngs_mpa": BALL_MPA}
    (folder / "truth.json").write_text(json.dumps({**truth, "around_mpa": TISSUE_MPA}))


def press(mesh: TetMesh, youngs: np.ndarray) -> list[tuple[str, list[float]]]:
    """Press each side, and return the rows of the table: side, and the numbers of a mark."""
    body = SoftBody(mesh, make_material("neo_hookean", POISSON), element="tet10")
    nothing, rng = np.zeros((mesh.n_points, 3)), np.random.default_rng(0)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[mesh.points[:, 2] < 0.02] = True
    rows = []
    for side, pressure in PRESSURES_MPA.items():
        areas = np.zeros(mesh.n_points)
        for triangle in select_face(mesh, side):
            areas[mesh.surface.triangles[triangle]] += mesh.surface.areas[triangle] / 3.0
        forces = nothing.copy()
        forces[:, "xyz".index(side[0])] = -pressure * areas
        moved = body.equilibrate(youngs, forces, Supports(fixed, nothing)).require().displacement
        scale = 1.0 + FORCE_ERROR * rng.standard_normal()
        for node in np.flatnonzero(areas):
            measured = moved[node] + NOISE_MM * rng.standard_normal(3)
            rows.append((side, [*mesh.points[node], *measured, *(scale * forces[node])]))
    return rows


if __name__ == "__main__":
    main()
