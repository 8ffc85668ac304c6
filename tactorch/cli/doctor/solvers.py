"""Solvers and the mechanics on them: each does a small piece of work whose answer is known."""

from collections.abc import Iterator
from functools import partial

from tactorch.cli.doctor.finding import Finding, looked_at
from tactorch.cli.doctor.packages import PACKAGES, install
from tactorch.errors import ConvergenceError

PART = "solvers"
SOLVERS = ("pardiso", "superlu", "multigrid", "torch_cg")
_NEEDS = {"pardiso": "pypardiso", "superlu": "scipy", "multigrid": "pyamg", "torch_cg": "torch"}
_SIZE = 300
# Uniaxial press of a Neo-Hookean block, E = 1, Poisson's ratio 0.3, nominal traction -0.2: exact.
_STRETCH = 0.828310984658


def look_at_solvers() -> Iterator[Finding]:
    """Factor and solve with each; then press a block."""
    packages = {package.name: package for package in PACKAGES}
    found = []
    for name in SOLVERS:
        remedy = install(packages[_NEEDS[name]])
        found.append(looked_at(PART, name, partial(_solve, name), f"solver={name}", remedy))
    yield from found
    works = [one.name for one in found if one.works]
    message = f"solver=auto takes {works[0]}" if works else "none of them works"
    remedy = "" if works else install(packages["scipy"])
    yield Finding(PART, "any of them", bool(works), message, "every simulation", remedy, core=True)
    yield looked_at(
        PART, "a pressed block", _press, "every simulation", "see what is wrong above", core=True
    )


def _solve(backend: str) -> str:
    import numpy as np

    from tactorch.linalg import SymmetricPattern, analyse

    chain = np.arange(_SIZE - 1)
    pattern = SymmetricPattern.from_pairs(_SIZE, chain, chain + 1)
    values = np.where(pattern.rows == pattern.indices, 2.5, -1.0)
    expected = np.sin(np.arange(_SIZE))
    solver = analyse(pattern, backend)
    if not solver.factor(values):
        raise ConvergenceError("a positive definite matrix was taken for an indefinite one")
    off = np.abs(solver.solve(pattern.product(values, expected)) - expected).max()
    if not off < 1e-8:
        raise ConvergenceError(f"the solution of {_SIZE} equations is off by {off:.1e}")
    return f"{_SIZE} equations solved"


def _press() -> str:
    import torch

    from tactorch.fem import SoftBody, Supports, make_material
    from tactorch.mesh import box_mesh, face_nodes

    mesh = box_mesh(1.0, 2)
    body = SoftBody(mesh, make_material("neo_hookean", poisson=0.3))
    rollers = Supports(fixed=mesh.points < 1e-9)  # each low side slides in its plane
    youngs = torch.ones(mesh.n_tets, dtype=torch.float64)
    u = body.solve(youngs, body.traction("z+", [0.0, 0.0, -0.2]), rollers)
    found = 1.0 + float(u[torch.from_numpy(face_nodes(mesh, "z+")), 2].mean())
    if not abs(found - _STRETCH) < 1e-6:
        raise ConvergenceError(f"its stretch is {found:.6f}, and should be {_STRETCH:.6f}")
    return f"stretch {found:.6f}, as theory has it"
