"""Derivative order two: Hessian-vector products through backward of backward."""

import numpy as np
import pytest
import torch
from torch.autograd import gradgradcheck

INPUTS = ("youngs", "poisson", "forces", "points")


def check(cell, names):
    """Second derivatives with respect to some inputs against differences of first ones."""
    values = [cell.inputs[n].clone().requires_grad_(True) for n in names]

    def solve(*given):
        return cell.solve(**dict(zip(names, given, strict=True)))

    assert gradgradcheck(solve, values, fast_mode=True, eps=1e-6, atol=1e-5, rtol=1e-3)


def check_entries(cell, name):
    """The same for one input, entry by entry, and one output; forces in twelve directions."""
    value = cell.inputs[name]
    weight = torch.randn(2, cell.body.n_nodes, 3, dtype=torch.float64)
    scale = value.abs().max()
    ways = torch.eye(value.numel(), dtype=torch.float64).reshape(-1, *value.shape)
    if len(ways) > 30:
        ways = scale * torch.randn(12, *value.shape, dtype=torch.float64)

    def goal(amounts):
        changed = value + torch.einsum("k,k...->...", amounts, ways)
        return (cell.solve(**{name: changed}) * weight).sum()

    amounts = torch.zeros(len(ways), dtype=torch.float64, requires_grad=True)
    assert gradgradcheck(goal, [amounts], eps=1e-6, atol=1e-5, rtol=1e-3)


class Goal:
    """A weighted sum of displacements and of their squares, and its derivatives."""

    def __init__(self, cell):
        self.cell = cell
        self.weight = torch.randn(2, cell.body.n_nodes, 3, dtype=torch.float64)

    def __call__(self, **inputs):
        u = self.cell.solve(**inputs)
        return (self.weight * (u + 3.0 * u * u)).sum()

    def hessian_product(self, changes):
        """The Hessian in the named inputs times a change of all of them."""
        leaves = {n: self.cell.inputs[n].clone().requires_grad_(True) for n in changes}
        gradients = torch.autograd.grad(self(**leaves), leaves.values(), create_graph=True)
        slope = sum((g * changes[n]).sum() for g, n in zip(gradients, leaves, strict=True))
        products = torch.autograd.grad(slope, leaves.values())
        return dict(zip(leaves, products, strict=True)), slope.item()


def changes(cell, names):
    """A change of each input, a tenth of the input."""
    noise = {n: torch.randn_like(cell.inputs[n]) for n in names}
    return {n: 0.1 * cell.inputs[n].abs().max() * noise[n] / noise[n].abs().max() for n in names}


# One of each here; all of them among the slow tests, and symmetry and Taylor tests below.
@pytest.mark.parametrize("pair", [("neo_hookean", "tet10")], indirect=True)
def test_gradgradcheck(name, element, cell):
    check(cell(name, element), INPUTS)


def test_gradgradcheck_with_moduli_at_the_quadrature_points(cell):
    check(cell("neo_hookean", "tet10", per_point=True), INPUTS)


@pytest.mark.slow
@pytest.mark.parametrize("which", INPUTS)
def test_gradgradcheck_entry_by_entry(name, element, which, cell):
    check_entries(cell(name, element), which)


@pytest.mark.slow
def test_gradgradcheck_of_all_materials(name, element, cell):
    check(cell(name, element), INPUTS)


def test_hessian_is_symmetric_across_all_inputs(name, element, cell):
    c = cell(name, element)
    goal, d, g = Goal(c), changes(c, INPUTS), changes(c, INPUTS)
    forth, _ = goal.hessian_product(d)
    back, _ = goal.hessian_product(g)
    left = sum((forth[n] * g[n]).sum() for n in INPUTS)
    right = sum((back[n] * d[n]).sum() for n in INPUTS)
    torch.testing.assert_close(left, right, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("which", INPUTS)
def test_taylor_remainder_falls_with_the_cube_of_the_step(name, element, which, cell):
    c = cell(name, element)
    goal, change = Goal(c), changes(c, [which])
    value = c.inputs[which]
    products, slope = goal.hessian_product(change)
    curvature = (products[which] * change[which]).sum().item()
    base = goal().item()
    steps = [0.08, 0.04, 0.02]
    rest = []
    for h in steps:
        moved = goal(**{which: value + h * change[which]}).item()
        rest.append(abs(moved - base - h * slope - 0.5 * h * h * curvature))
    if max(rest) < 1e-11 * abs(base):
        assert (name, which) == ("linear", "forces")  # quadratic in this input: nothing remains
        return
    orders = np.log2(np.array(rest[:-1]) / rest[1:])
    np.testing.assert_allclose(orders, 3.0, atol=0.25)


def test_graph_gradients_equal_plain_gradients(name, element, cell):
    """With and without a graph the adjoint takes different code: kernels or plain torch."""
    c = cell(name, element)
    goal = Goal(c)
    out = []
    for graph in (False, True):
        leaves = [c.inputs[n].clone().requires_grad_(True) for n in INPUTS]
        total = goal(**dict(zip(INPUTS, leaves, strict=True)))
        out.append(torch.autograd.grad(total, leaves, create_graph=graph))
    for plain, graphed in zip(*out, strict=True):
        torch.testing.assert_close(plain, graphed.detach(), rtol=1e-9, atol=1e-12)
