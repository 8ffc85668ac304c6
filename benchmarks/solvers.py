"""Linear solvers on quadratic elements: the time of one equilibrium iteration by mesh size.

    python benchmarks/solvers.py [--divisions N ...] [--out FOLDER]

A cube of 10 mm and 0.2 MPa with a stiff upper half (1 MPa) is held below and pressed from above.
`first` is the time of the analysis, the factorisation and one solution at rest, and `next` that of
the factorisation and the solution for moduli that are 5 % larger in the upper half. The relative
residual is at most 1e-4, of conjugate gradients preconditioned by a factorisation in single
precision for PARDISO. All solvers run in one process and one after the other, on the same matrices;
`ratio` is the time of PARDISO over that of the solver. The last line printed is one JSON object.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from machine import write_results

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.linalg import (
    CoarseSpaces,
    Solver,
    SolverOptions,
    available_solvers,
    conjugate_gradients,
)
from tactorch.linalg.solver import SOLVERS
from tactorch.mesh import box_mesh, face_nodes

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "pyamg", "mkl")
DIVISIONS = (8, 14, 20)
COMPARED = ("pardiso", "p_multigrid", "multigrid")
RTOL, SOFT_MPA, STIFF_MPA, CHANGE = 1e-4, 0.2, 1.0, 1.05


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all sizes; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--divisions", type=int, nargs="+", default=DIVISIONS)
    parser.add_argument("--out", type=Path, help="Folder for solvers.md and solvers.json")
    options = parser.parse_args(arguments)
    lines = ["| elements | unknowns | solver | first s | next s | ratio first | ratio next |"]
    lines.append("|---" * 7 + "|")
    print("\n".join(lines), flush=True)
    rows = []
    for divisions in options.divisions:
        for row in compare(divisions):
            rows.append(row)
            ratios = [_number(row[f"ratio_{key}"]) for key in ("first", "next")]
            lines.append(
                f"| {row['elements']} | {row['unknowns']} | {row['solver']} |"
                f" {row['first_s']:.2f} | {row['next_s']:.2f} | {' | '.join(ratios)} |"
            )
            print(lines[-1], flush=True)
    result = {"rows": rows}
    if options.out:
        write_results(options.out, "solvers", lines, result, PACKAGES)
    print(json.dumps(result))


def compare(divisions: int) -> list[dict[str, Any]]:
    """Return the times of the available solvers on a mesh."""
    mesh = box_mesh(10.0, divisions)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45), element="tet10")
    d, fixed = body.discretisation, np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    load = body.pressure("z+", 0.02).numpy()
    upper = mesh.centroids[:, 2] > 5.0
    rest = body.assembly.respond(np.zeros_like(load))
    matrices = []
    for factor in (1.0, CHANGE):
        youngs = np.where(upper, factor * STIFF_MPA, SOFT_MPA)
        case = body.search(youngs, load, Supports(fixed=fixed)).supports
        values = body.assembly.tangent(rest, youngs)
        matrices.append(d.pattern.apply_dirichlet(values, case.fixed.ravel()))
    rhs = np.where(case.fixed, 0.0, load).ravel()
    rows: list[dict[str, Any]] = []
    for name in (name for name in COMPARED if name in available_solvers()):
        options: SolverOptions = SOLVERS.build(name)
        began = time.perf_counter()
        solver = options.analyse(d.pattern, CoarseSpaces(d.rigid_modes, d.from_linear), True)
        times = []
        for values in matrices:
            solution = _solve(solver, values, rhs)
            times.append(time.perf_counter() - began)
            residual = d.pattern.product(values, solution) - rhs
            assert np.linalg.norm(residual) <= 2.0 * RTOL * np.linalg.norm(rhs)
            began = time.perf_counter()
        rows.append({
            "elements": mesh.n_tets, "unknowns": d.pattern.size, "solver": name,
            "first_s": times[0], "next_s": times[1],
        })  # fmt: skip
    direct = next((row for row in rows if row["solver"] == "pardiso"), None)
    for row in rows:
        for key in ("first", "next"):
            row[f"ratio_{key}"] = direct and direct[f"{key}_s"] / row[f"{key}_s"]
    return rows


def _solve(solver: Solver, values: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    assert solver.factor(values)
    if not solver.single_precision:
        return solver.solve(rhs, RTOL)
    result = conjugate_gradients(
        lambda x: solver.pattern.product(values, x), solver.solve, rhs, rtol=RTOL, max_iterations=50
    )
    assert result.converged
    return np.asarray(result.solution)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    main()
