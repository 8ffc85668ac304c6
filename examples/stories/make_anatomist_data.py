"""Make the data of the story of an anatomist: a surface and the table of an indenter.

    python examples/stories/make_anatomist_data.py FOLDER

A block of soft tissue, 36 x 30 x 16 mm, has a stiff ball and stands on a plate. An indenter with a
ball of 3 mm radius presses 63 places of its top. The forces are those of small strains without
friction, solved with quadratic elements on a mesh that follows the ball. It is not the mesh of the
inversion, which the story makes from the surface alone. The files are

    specimen.stl   surface, mm
    indenter.csv   number of the place, position of the indenter's ball and force of each sample
    truth.json     what is inside, which the story does not read

Forces have noise of 0.003 N and an error of 1 % that is common to the samples of a place. Files
that are there are kept.
"""

import argparse
import csv
import json
from pathlib import Path

import meshio
import numpy as np

from tactorch import Phantom, SoftBody, make_material
from tactorch.fem import Supports
from tactorch.fem.indentation import BallPlace, Indentation
from tactorch.mesh import BodyFile, Sphere, box_mesh

SIZE_MM = (36.0, 30.0, 16.0)
CENTER_MM, RADIUS_MM = (21.0, 13.0, 10.0), 4.5
TISSUE_MPA, BALL_MPA, POISSON = 0.02, 0.2, 0.45
INDENTER_MM = 3.0
X_MM, Y_MM = np.arange(6.0, 31.0, 3.0), np.arange(5.0, 26.0, 3.0)
DEPTHS_MM = np.arange(-0.4, 1.61, 0.2)  # of the ball below the undeformed surface
NOISE_N, COMMON_ERROR = 0.003, 0.01
EDGE_MM = 1.8  # of the mesh of the simulation
COLUMNS = ["probe", "x_mm", "y_mm", "z_mm", "fx_n", "fy_n", "fz_n"]


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
    block = box_mesh(SIZE_MM, (6, 5, 3))
    meshio.write_points_cells(
        folder / "specimen.stl", block.points, [("triangle", block.surface.triangles)]
    )
    ball = Sphere(CENTER_MM, RADIUS_MM)
    rows = press(Phantom(BodyFile(str(folder / "specimen.stl")), [(ball, BALL_MPA)], TISSUE_MPA))
    with open(folder / "indenter.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows([int(row[0]), *(f"{value:.5g}" for value in row[1:])] for row in rows)
    truth = {"center_mm": CENTER_MM, "radius_mm": RADIUS_MM, "youngs_mpa": BALL_MPA}
    (folder / "truth.json").write_text(json.dumps({**truth, "around_mpa": TISSUE_MPA}))


def press(phantom: Phantom) -> list[list[float]]:
    """Press each place to all depths, and return the rows of the table."""
    mesh = phantom.mesh(EDGE_MM, conforming=True)
    body = SoftBody(mesh, make_material("linear", POISSON), element="tet10")
    fixed = np.repeat(mesh.points[:, 2:] < 0.02, 3, axis=1)
    top, up = SIZE_MM[2], np.array([0.0, 0.0, 1.0])
    points = [np.array([x, y, top]) for x in X_MM for y in Y_MM]
    places = [BallPlace(point, up, INDENTER_MM, DEPTHS_MM[-1] + 0.1) for point in points]
    indented = Indentation(body, Supports(fixed), places).at(phantom.on_mesh(mesh, 1))
    inside, rng, rows = DEPTHS_MM > 0.0, np.random.default_rng(0), []
    for number, point in enumerate(points):
        forces = np.zeros(len(DEPTHS_MM))
        here = np.full(int(inside.sum()), number)
        forces[inside] = indented.press(here, DEPTHS_MM[inside]).force_n
        forces *= 1.0 + COMMON_ERROR * rng.standard_normal()
        forces += NOISE_N * rng.standard_normal(len(forces))
        for depth, force in zip(DEPTHS_MM, forces, strict=True):
            rows.append([number, *point[:2], top + INDENTER_MM - depth, 0.0, 0.0, force])
    return rows


if __name__ == "__main__":
    main()
