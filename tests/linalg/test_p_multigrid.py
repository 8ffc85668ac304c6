"""Multigrid in the degree of elements, on a clamped cube of quadratic elements."""

import numpy as np
import pytest

from tactorch.fem import SoftBody, Supports, make_material
from tactorch.linalg import CoarseSpaces, analyse
from tactorch.linalg.p_multigrid import PMultigrid
from tactorch.linalg.solver import IndefiniteError
from tactorch.mesh import box_mesh, face_nodes


def body(divisions: int, solver: str = "superlu") -> tuple[SoftBody, Supports, np.ndarray]:
    """Return a cube clamped below, with shear and pressure above."""
    mesh = box_mesh(10.0, divisions)
    soft = SoftBody(mesh, make_material("neo_hookean", 0.45), element="tet10", solver=solver)
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    return soft, Supports(fixed=fixed), soft.traction("z+", [0.005, 0.0, -0.02]).numpy()


def stiffness(divisions: int, stiff: float = 1.0):
    """Return pattern, values, interpolation from linear elements and load."""
    soft, supports, load = body(divisions)
    youngs = np.ones(soft.mesh.n_tets)
    youngs[soft.mesh.centroids[:, 2] > 5.0] = stiff
    case = soft.search(youngs, load, supports).supports
    values = soft.assembly.tangent(soft.assembly.respond(np.zeros_like(load)), youngs)
    d = soft.discretisation
    fixed = case.fixed.ravel()
    return d.pattern, d.pattern.apply_dirichlet(values, fixed), d.from_linear, load.ravel(), fixed


def cycles(solver, load, rtol, monkeypatch) -> int:
    """Count the cycles of one solve."""
    count, cycle = 0, solver._cycle

    def counted(residual):
        nonlocal count
        count += 1
        return cycle(residual)

    monkeypatch.setattr(solver, "_cycle", counted)
    solver.solve(load, rtol)
    monkeypatch.undo()
    return count


def test_linear_elements_reach_the_answer_in_few_cycles_on_any_mesh(monkeypatch, caplog):
    for divisions in (3, 6):
        pattern, values, linear, load, fixed = stiffness(divisions, stiff=5.0)
        solver = PMultigrid().analyse(pattern, CoarseSpaces(linear=linear))
        assert solver.factor(values)
        direct = analyse(pattern, "superlu")
        direct.factor(values)
        expected = direct.solve(load)
        found = solver.solve(load)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        assert not found[fixed].any()
        solver._renew()
        assert cycles(solver, load, 1e-4, monkeypatch) <= 12
    poor = PMultigrid(max_iterations=12).analyse(pattern, CoarseSpaces(linear=linear[:, :9]))
    poor.factor(values)
    np.testing.assert_allclose(poor.solve(load, 1e-4), expected, atol=1e-9 * abs(expected).max())
    assert "p_multigrid did not converge" in caplog.text


def test_an_earlier_cycle_serves_while_the_matrix_changes_little(monkeypatch):
    pattern, values, linear, load, _ = stiffness(3)
    solver = PMultigrid().analyse(pattern, CoarseSpaces(linear=linear))
    solver.factor(values)
    solver.solve(load, 1e-2)
    first = solver._cycle
    other = stiffness(3, stiff=1.1)[1]
    solver.factor(other)
    found = solver.solve(load, 1e-8)
    assert solver._cycle is first
    np.testing.assert_allclose(pattern.product(other, found), load, atol=1e-6)
    different = stiffness(3, stiff=1e4)[1]
    solver.factor(different)
    found = solver.solve(load, 1e-8)
    assert solver._cycle is not first
    residual = pattern.product(different, found) - load
    assert np.linalg.norm(residual) < 2e-8 * np.linalg.norm(load)


def test_an_indefinite_matrix_is_reported(monkeypatch):
    pattern, values, linear, load, fixed = stiffness(3)
    solver = PMultigrid().analyse(pattern, CoarseSpaces(linear=linear))
    solver.factor(values)
    solver.solve(load)
    shifted = values.copy()
    shifted[pattern.diagonal[~fixed]] -= 0.05 * values[pattern.diagonal].mean()
    assert solver.factor(shifted)
    with pytest.raises(IndefiniteError, match="positive definite"):
        solver.solve(load)


def test_equilibria_are_those_of_a_direct_solver():
    found = []
    for solver in ("superlu", "p_multigrid"):
        soft, supports, load = body(3, solver)
        found.append(soft.equilibrate(np.full(soft.mesh.n_tets, 0.2), load, supports).require())
    displacements = [result.displacement for result in found]
    np.testing.assert_allclose(*displacements, rtol=0, atol=1e-8)
