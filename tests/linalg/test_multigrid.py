"""Multigrid on what it is for: a clamped elastic cube."""

import numpy as np

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.linalg import CoarseSpaces, analyse
from tactorch.linalg.iterative import Multigrid, MultigridSolver
from tactorch.mesh import box_mesh, face_nodes


def stiffness(divisions: int):
    """Pattern, values, rigid modes and load of a cube of soft material, clamped below."""
    mesh = box_mesh(10.0, divisions)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45))
    d = body.discretisation
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    rest = body.assembly.respond(np.zeros((d.n_nodes, 3)))
    values = body.assembly.tangent(rest, np.ones(mesh.n_tets))
    load = body.traction("z+", [0.02, 0.0, -0.1]).numpy().ravel()
    return d.pattern, d.pattern.apply_dirichlet(values, fixed.ravel()), d.rigid_modes, load


def iterations(solver: MultigridSolver, load: np.ndarray, monkeypatch) -> int:
    """Count preconditioner applications of one solve."""
    count = 0
    inner = solver._preconditioner

    class Counted:
        def __matmul__(self, x):
            nonlocal count
            count += 1
            return inner @ x

    monkeypatch.setattr(solver, "_preconditioner", Counted())
    solver.solve(load)
    monkeypatch.undo()
    return count


def test_rigid_modes_keep_iterations_few_and_the_answer_is_the_direct_one(monkeypatch):
    pattern, values, modes, load = stiffness(9)
    with_modes = Multigrid().analyse(pattern, CoarseSpaces(modes))
    with_modes.factor(values)
    without = Multigrid().analyse(pattern)
    without.factor(values)
    few = iterations(with_modes, load, monkeypatch)
    many = iterations(without, load, monkeypatch)
    assert few <= 40  # twelve digits of residual
    assert few < 0.75 * many
    direct = analyse(pattern, "superlu")
    direct.factor(values)
    expected = direct.solve(load)
    np.testing.assert_allclose(
        with_modes.solve(load), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


def test_kept_aggregates_serve_new_values():
    pattern, values, modes, load = stiffness(7)
    solver = Multigrid().analyse(pattern, CoarseSpaces(modes))
    solver.factor(values)
    solver.factor(2.0 * values)
    twice = solver.solve(load)
    fresh = Multigrid().analyse(pattern, CoarseSpaces(modes))
    fresh.factor(values)
    np.testing.assert_allclose(2.0 * twice, fresh.solve(load), rtol=0, atol=1e-9)


def test_a_direct_solver_takes_over_where_multigrid_does_not_converge(caplog):
    pattern, values, modes, load = stiffness(7)
    solver = Multigrid(max_iterations=2).analyse(pattern, CoarseSpaces(modes))
    direct = analyse(pattern, "superlu")
    for matrix in (values, 2.0 * values):
        assert solver.factor(matrix)
        direct.factor(matrix)
        np.testing.assert_allclose(solver.solve(load), direct.solve(load), rtol=1e-8, atol=1e-12)
    assert caplog.text.count("solver=multigrid did not converge: a relative residual of") == 1
    assert not solver.factor(-values)


def test_equilibrium_by_multigrid_is_that_of_the_direct_solver():
    mesh = box_mesh(10.0, 3)  # so small that the hierarchy has one level
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    found = {}
    for solver in ("superlu", "multigrid"):
        body = SoftBody(mesh, make_material("neo_hookean", 0.45), solver=solver)
        forces = body.pressure("z+", 0.1).numpy()
        found[solver] = body.equilibrate(np.ones(mesh.n_tets), forces, Supports(fixed=fixed))
        assert found[solver].converged, found[solver].reason
    np.testing.assert_allclose(
        found["multigrid"].displacement, found["superlu"].displacement, rtol=0, atol=1e-8
    )
