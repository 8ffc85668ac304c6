"""How well simulated presses are those of the object itself, by the mesh they are solved on.

    python benchmarks/simulate_object.py [--only NAME ...] [--meshes NAME ...] [--out FOLDER]

Cubes of 10 mm with one inclusion are pressed on three sides, with one step of 20 kPa, on quadratic
elements. `error` is the root mean square difference of the observed displacements from those on a
finer mesh, over the root mean square displacement: noise of 40 dB is 1e-2. `seconds` is the
processor time of mesh, moduli and solution, that of fTetWild included.

- `averaged`: a regular mesh of 0.05 of the diagonal; elements have the mean modulus. It was the
  default before.
- `tetwild`: a mesh of 0.06 by fTetWild that conforms to the surface of the inclusion.
- `default`: the default of `tactorch simulate`.

The faces of the L are grid planes of the finer mesh, of cells of 0.5 mm. For other inclusions
it is regular, of 0.05 of the diagonal, with edges of at most REFERENCE_MM at the surface of the
inclusion, which its faces follow as those of the default do. All meshes of a case are solved in one
process, one after the other. The last line printed is one JSON object.
"""

import argparse
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from machine import write_results

from tactorch.fem import SoftBody, make_material
from tactorch.fem.elements import TET10
from tactorch.mesh import Box, TetMesh, Union, box_mesh
from tactorch.mesh.refine import refine
from tactorch.phantoms import MeshSize, Phantom, make_phantom
from tactorch.phantoms.cubes import cube_body
from tactorch.phantoms.object_mesh import follow_inclusions
from tactorch.simulation import PressPlan
from tactorch.simulation.solve import PressSimulator

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "pyamg", "mkl")
CASES = ("cube_sphere", "cube_l", "cube_two_tiers", "cube_torus", "cube_cylinder")
BARS = (Box((4.0, 5.0, 4.5), (2.0, 6.0, 3.0)), Box((6.0, 3.0, 4.5), (4.0, 2.0, 3.0)))  # of the L
PLAN = PressPlan(("z+", "x+", "y+"), steps=1)
REFERENCE_RELATIVE, REFERENCE_MM, GROWTH = 0.05, 0.6, 0.6

Solved = tuple[TetMesh, np.ndarray]  # mesh, and moduli of elements or quadrature points, MPa


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", default=CASES, choices=CASES)
    parser.add_argument("--meshes", nargs="+", default=tuple(MESHES), choices=tuple(MESHES))
    parser.add_argument("--out", type=Path, help="Folder for simulate_object.md and .json")
    options = parser.parse_args(arguments)
    lines = ["| object | mesh | elements | error | seconds |", "|---" * 5 + "|"]
    print("\n".join(lines), flush=True)
    rows = []
    for name in options.only:
        for row in compare(name, options.meshes):
            rows.append(row)
            lines.append(
                f"| {row['object']} | {row['mesh']} | {row['elements']} | {row['error']:.1e} |"
                f" {row['seconds']:.1f} |"
            )
            print(lines[-1], flush=True)
    result = {"rows": rows}
    if options.out:
        write_results(options.out, "simulate_object", lines, result, PACKAGES)
    print(json.dumps(result))


def make_object(name: str) -> Phantom:
    """Return a cube with the inclusion of a name."""
    if name == "cube_l":
        return Phantom(cube_body(10.0), [(Union(BARS), 1.0)])
    return make_phantom(name)


def compare(name: str, meshes: Sequence[str]) -> list[dict[str, Any]]:
    """Return errors and times of the meshes of a case."""
    phantom = make_object(name)
    mesh = phantom.mesh()
    press(mesh, (mesh, phantom.on_mesh(mesh)))  # compiles what all use
    exact = press(mesh, reference(phantom))
    rows = []
    for label in meshes:
        began = _seconds()
        solved = MESHES[label](phantom)
        found = press(mesh, solved)
        seconds = _seconds() - began
        error = float(np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)))
        elements = solved[0].n_tets
        rows.append(
            {
                "object": name,
                "mesh": label,
                "elements": elements,
                "error": error,
                "seconds": seconds,
            }
        )
    return rows


def averaged(phantom: Phantom) -> Solved:
    """Return a regular mesh and mean moduli."""
    mesh = phantom.mesh(relative_edge_length=0.05)
    return mesh, phantom.on_mesh(mesh, 4)


def tetwild(phantom: Phantom) -> Solved:
    """Return fTetWild's mesh, and the moduli at centroids."""
    mesh = phantom.mesh(relative_edge_length=0.06, conforming=True, cache=False)
    return mesh, phantom.on_mesh(mesh)


def default(phantom: Phantom) -> Solved:
    """Return mesh and moduli of `tactorch simulate`."""
    mesh = MeshSize().build(phantom)[1]
    assert mesh is not None
    return mesh, phantom.at_quadrature(mesh, TET10.points)


def reference(phantom: Phantom) -> Solved:
    """Return the finer mesh and the moduli at its quadrature points."""
    shapes = [shape for shape, _ in phantom.inclusions]
    if isinstance(shapes[0], Union) and shapes[0].parts == BARS:
        aligned = box_mesh(10.0, 20, tets_per_cell=5)
        return aligned, phantom.on_mesh(aligned)

    def sizing(points: np.ndarray) -> np.ndarray:
        distances = [np.abs(shape.signed_distance(points)) for shape in shapes]
        return REFERENCE_MM + GROWTH * np.min(distances, axis=0)

    mesh = refine(phantom.mesh(relative_edge_length=REFERENCE_RELATIVE), sizing).mesh
    mesh = follow_inclusions(mesh, shapes)
    return mesh, phantom.at_quadrature(mesh, TET10.points)


def press(recorded: TetMesh, solved: Solved) -> np.ndarray:
    """Return the observed displacements of all presses on the recording's mesh, mm."""
    law = make_material("neo_hookean", 0.45)
    body = SoftBody(solved[0], law, element="tet10", solver="p_multigrid")
    simulator = PressSimulator(body, solved[1], recorded, PLAN, np.zeros((body.n_nodes, 3)))
    sites = [simulator.conditions(site) for site in PLAN.sites_on(recorded)]
    return np.concatenate([simulator.solve(site)[-1][site.observed] for site in sites])


def _seconds() -> float:
    """Processor time of this process and those that it has started, s."""
    return sum(os.times()[:4])


#: Meshes by name.
MESHES: dict[str, Callable[[Phantom], Solved]] = {
    "averaged": averaged,
    "tetwild": tetwild,
    "default": default,
}


if __name__ == "__main__":
    main()
