"""Time of the forward solution and the gradient, compared with torch-fem in one process.

A cube of plain tetrahedra, clamped at the bottom, under a compressive dead traction of 0.1 MPa
on top: E = 1 MPa, Poisson's ratio 0.45, the paper's Neo-Hookean energy (eq. 2). The gradient is
that of the mean vertical displacement of the top with respect to the modulus of each element, timed
separately from the forward solution.

    python benchmarks/forward_gradient.py [--small-only] [--repeats 7] [--out FOLDER]

Models are built and compiled before the time is measured. Both packages solve to the same relative
residual in one load increment with the same exact boundary conditions and nodal forces. torch-fem
runs with each of its linear solvers (PARDISO, and conjugate gradients with algebraic multigrid);
each figure is compared with the faster one. The packages alternate, so that other processes on the
machine affect both.

tactorch factors the tangent at the equilibrium in its forward solution when a gradient is
requested, so the gradient costs one solve: the sum of both times is also given. Medians are
compared; the best times, which other processes affect least, and the share of the cores that other
processes used are given as well.

The table is printed and written, with the description of the machine, to a Markdown and a JSON
file. The last line printed is one JSON object with the figures.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np
import torch
from machine import OtherWork, describe_machine
from torch import Tensor
from torchfem.materials import Hyperelastic3D
from torchfem.solid import Solid

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh, face_nodes

POISSON = 0.45
TRACTION_MPA = (0.0, 0.0, -0.1)
SIZE_MM = 10.0
RTOL = 1e-10  # of the residual force; tactorch's default
PACKAGES = (
    "tactorch", "torch-fem", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl", "pyamg",
)  # fmt: skip

Method = Literal["direct", "cg"]
KINDS = ("forward", "gradient", "both", "alone")

METHODS: dict[Method, str] = {"direct": "PARDISO", "cg": "CG + AMG"}
Solve = Callable[[Tensor], Tensor]


@dataclass
class Contestant:
    """A package with a linear solver, its times and results."""

    name: str
    solve: Solve
    alone: list[float] = field(default_factory=list)
    forward: list[float] = field(default_factory=list)
    gradient: list[float] = field(default_factory=list)
    displacement: np.ndarray = field(default_factory=lambda: np.empty(0))
    slope: np.ndarray = field(default_factory=lambda: np.empty(0))

    def run(self, count: int, top: Tensor, keep: bool) -> None:
        """Solve without, then with a gradient, on `count` elements; record times if `keep`."""
        youngs = torch.ones(count, dtype=torch.float64)
        start = time.perf_counter()
        self.solve(youngs)
        alone = time.perf_counter() - start
        youngs.requires_grad_()
        begin = time.perf_counter()
        u = self.solve(youngs)
        solved = time.perf_counter()
        mean = u[top, 2].mean()
        middle = time.perf_counter()
        (slope,) = torch.autograd.grad(mean, youngs)
        end = time.perf_counter()
        self.displacement, self.slope = u.detach().numpy(), slope.numpy()
        if keep:
            self.alone.append(alone)
            self.forward.append(solved - begin)
            self.gradient.append(end - middle)

    def seconds(self) -> dict[str, float]:
        """Return medians and best times."""
        times = {"forward": self.forward, "gradient": self.gradient, "alone": self.alone}
        times["both"] = [f + g for f, g in zip(self.forward, self.gradient, strict=True)]
        return {k: median(t) for k, t in times.items()} | {
            f"best_{k}": min(t) for k, t in times.items()
        }


def tactorch_solve(body: SoftBody, forces: Tensor, fixed: np.ndarray) -> Solve:
    """Return the solve of this package."""
    supports = Supports(fixed=fixed)
    return lambda youngs: body.solve(youngs, forces, supports)


def torchfem_solve(mesh: TetMesh, forces: Tensor, fixed: np.ndarray, method: Method) -> Solve:
    """Return torch-fem's solve with one of its linear solvers."""
    model = Solid(torch.tensor(mesh.points), torch.tensor(mesh.tets), None)
    model.forces = forces
    model.constraints = torch.tensor(fixed)

    def solve(youngs: Tensor) -> Tensor:
        model.material = Hyperelastic3D(neo_hookean, youngs[:, None])
        wanted = youngs if youngs.requires_grad else None
        options = {"rtol": RTOL, "atol": 1e-30, "method": method}
        return model.solve(**options, differentiable_parameters=wanted)[0]

    return solve


def neo_hookean(F: Tensor, params: Tensor) -> Tensor:
    """Energy density of eq. (2) at one point; `params` holds Young's modulus."""
    mu = 0.5 * params[0] / (1.0 + POISSON)
    lam = 2.0 * mu * POISSON / (1.0 - 2.0 * POISSON)
    C = F.T @ F
    log_j = 0.5 * torch.logdet(C)  # torch-fem's advice: det's second derivative is not finite
    return 0.5 * mu * (C.trace() - 3.0) - mu * log_j + 0.5 * lam * log_j**2


def compare(divisions: int, repeats: int) -> dict[str, Any]:
    """Compare on one cube; print a table and return the figures."""
    mesh = box_mesh(SIZE_MM, divisions, tets_per_cell=5)
    top = torch.from_numpy(face_nodes(mesh, "z+"))
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    body = SoftBody(mesh, make_material("neo_hookean", POISSON))
    forces = body.traction("z+", TRACTION_MPA)
    ours = Contestant("tactorch", tactorch_solve(body, forces, fixed))
    theirs = [
        Contestant(f"torch-fem, {name}", torchfem_solve(mesh, forces, fixed, method))
        for method, name in METHODS.items()
    ]
    for contestant in (ours, *theirs):
        contestant.run(mesh.n_tets, top, keep=False)
    others = OtherWork()
    for _ in range(repeats):
        for contestant in (ours, *theirs):
            contestant.run(mesh.n_tets, top, keep=True)
    figures = summarise(mesh, ours, theirs) | {"share_of_other_work": others.share()}
    print(table(figures), flush=True)
    return figures


def summarise(mesh: TetMesh, ours: Contestant, theirs: list[Contestant]) -> dict[str, Any]:
    """Return times, ratios to the faster of `theirs`, and differences of the results."""
    seconds = {c.name: c.seconds() for c in (ours, *theirs)}
    ratios = {
        f"{kind}_ratio": min(seconds[c.name][kind] for c in theirs) / seconds[ours.name][kind]
        for kind in seconds[ours.name]
    }
    return {
        "elements": mesh.n_tets,
        "nodes": mesh.n_points,
        "repeats": len(ours.forward),
        "seconds": seconds,
        **ratios,
        "displacement_difference": max(
            difference(ours.displacement, c.displacement) for c in theirs
        ),
        "gradient_difference": max(difference(ours.slope, c.slope) for c in theirs),
    }


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference, relative to the largest value."""
    return float(np.abs(a - b).max() / np.abs(b).max())


def table(figures: dict[str, Any]) -> str:
    """Format one cube's figures as a Markdown table."""
    lines = [
        f"### {figures['elements']:,} tetrahedra, {figures['nodes']:,} nodes "
        f"({figures['repeats']} repeats)",
        "",
        "| seconds: median (best) | forward | gradient | both | forward, no gradient |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, s in figures["seconds"].items():
        cells = [f"{s[k]:.4f} ({s[f'best_{k}']:.4f})" for k in KINDS]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    share = figures["share_of_other_work"]
    cells = [f"**{figures[f'{k}_ratio']:.1f}** ({figures[f'best_{k}_ratio']:.1f})" for k in KINDS]
    lines += [
        f"| **times faster** | {' | '.join(cells)} |",
        "",
        f"Largest relative difference of the results: displacement "
        f"{figures['displacement_difference']:.1e}, gradient "
        f"{figures['gradient_difference']:.1e}."
        + ("" if share is None else f" Other processes took {share:.0%} of the cores meanwhile."),
        "",
    ]
    return "\n".join(lines)


def headline(cubes: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Return the figures of the JSON line."""
    out = {
        f"{kind}_ratio_{size}": round(figures[f"{kind}_ratio"], 2)
        for size, figures in cubes.items()
        for kind in ("forward", "gradient", "alone")
    }
    for kind in ("displacement", "gradient"):
        out[f"{kind}_difference"] = max(f[f"{kind}_difference"] for f in cubes.values())
    return out


def write(
    folder: Path,
    machine: dict[str, str | int],
    cubes: dict[str, dict[str, Any]],
    figures: dict[str, float],
) -> None:
    """Write forward_gradient.json and forward_gradient.md."""
    folder.mkdir(parents=True, exist_ok=True)
    record = {"machine": machine, "cubes": cubes, "figures": figures}
    (folder / "forward_gradient.json").write_text(json.dumps(record, indent=2) + "\n")
    text = ["# Forward solution and gradient, compared with torch-fem", ""]
    text += ["`python benchmarks/forward_gradient.py`; its docstring describes the problem.", ""]
    text += [table(f) for f in cubes.values()]
    text += ["## Machine", "", *(f"- {key}: {value}" for key, value in machine.items()), ""]
    (folder / "forward_gradient.md").write_text("\n".join(text))


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--small-only", action="store_true", help="omit the large cube")
    parser.add_argument(
        "--repeats", type=int, default=7, help="repeats of the small cube (default 7)"
    )
    parser.add_argument(
        "--large-repeats", type=int, default=2, help="repeats of the large cube (default 2)"
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    torch.set_default_dtype(torch.float64)  # torch-fem makes its arrays in the default type
    cubes = {"small": compare(8, options.repeats)}
    if not options.small_only:
        cubes["large"] = compare(23, options.large_repeats)
    figures = headline(cubes)
    if not options.small_only:
        write(options.out, describe_machine(PACKAGES), cubes, figures)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
