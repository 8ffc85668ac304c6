"""Derivative order one: reverse and forward mode, for every material, element and input."""

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad, gradcheck

from tactorch.fem import Supports

INPUTS = ("youngs", "poisson", "forces", "points")


def check(cell, names):
    """Gradients with respect to some inputs against finite differences, both modes."""
    values = [cell.inputs[n].clone().requires_grad_(True) for n in names]

    def solve(*given):
        return cell.solve(**dict(zip(names, given, strict=True)))

    assert gradcheck(
        solve, values, fast_mode=True, eps=1e-6, atol=1e-6, rtol=1e-4, check_forward_ad=True
    )


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
    # A smaller step would see where Newton's method stopped: 1e-12 of the displacement.
    assert gradcheck(goal, [amounts], eps=1e-5, atol=1e-6, rtol=1e-4, check_forward_ad=True)


def direction(value):
    """A change of an input, a tenth of the input."""
    noise = torch.randn_like(value)
    return 0.1 * value.abs().max() * noise / noise.abs().max()


def test_gradcheck(name, element, cell):
    check(cell(name, element), INPUTS)


def test_gradcheck_with_moduli_at_the_quadrature_points(cell):
    check(cell("neo_hookean", "tet10", per_point=True), INPUTS)


@pytest.mark.slow
@pytest.mark.parametrize("which", INPUTS)
def test_gradcheck_entry_by_entry(name, element, which, cell):
    check_entries(cell(name, element), which)


@pytest.mark.parametrize("which", INPUTS)
def test_forward_and_reverse_mode_agree(name, element, which, cell):
    c = cell(name, element)
    value = c.inputs[which].clone()
    change, weight = direction(value), torch.randn(2, c.body.n_nodes, 3, dtype=torch.float64)
    with forward_ad.dual_level():
        u = c.solve(**{which: forward_ad.make_dual(value, change)})
        tangent = forward_ad.unpack_dual(u).tangent
    leaf = value.requires_grad_(True)
    (gradient,) = torch.autograd.grad((c.solve(**{which: leaf}) * weight).sum(), leaf)
    torch.testing.assert_close(
        (tangent * weight).sum(), (gradient * change).sum(), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("which", INPUTS)
def test_taylor_remainder_falls_with_the_square_of_the_step(name, element, which, cell):
    c = cell(name, element)
    value = c.inputs[which].clone()
    change, weight = direction(value), torch.randn(2, c.body.n_nodes, 3, dtype=torch.float64)

    def goal(x):
        return (c.solve(**{which: x}) * weight).sum()

    leaf = value.clone().requires_grad_(True)
    base = goal(leaf)
    (gradient,) = torch.autograd.grad(base, leaf)
    slope = (gradient * change).sum().item()
    steps = [0.02, 0.01, 0.005]
    rest = [abs(goal(value + h * change).item() - base.item() - h * slope) for h in steps]
    if max(rest) < 1e-11 * abs(base.item()):
        assert name == "linear"  # linear in this input: nothing remains
        assert which == "forces"
        return
    orders = np.log2(np.array(rest[:-1]) / rest[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


@pytest.mark.parametrize("element", ["tet4", pytest.param("tet10", marks=pytest.mark.slow)])
def test_prescribed_displacements(element, cell):
    """Exact Dirichlet conditions take another way through the solver than springs."""
    c = cell("neo_hookean", element)
    fixed = c.supports.springs > 0
    moved = np.zeros_like(fixed)
    moved[c.body.mesh.points[:, 2] > 0.5] = (False, True, True)
    prescribed = np.where(moved, 0.05, 0.0)
    supports = Supports(fixed=fixed | moved, prescribed=prescribed)
    values = [c.inputs[n].clone().requires_grad_(True) for n in INPUTS]

    def solve(e, nu, f, x):
        return c.body.solve(e, f, supports, poisson=nu, points=x)

    assert gradcheck(solve, values, atol=1e-6, rtol=1e-4, fast_mode=True, check_forward_ad=True)


def test_poisson_may_be_differentiated_element_by_element(cell):
    c = cell("neo_hookean", "tet10")
    each = torch.full((c.body.mesh.n_tets,), 0.4, dtype=torch.float64).requires_grad_(True)
    (gradient,) = torch.autograd.grad(c.solve(poisson=each).pow(2).sum(), each)
    one = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    (total,) = torch.autograd.grad(c.solve(poisson=one).pow(2).sum(), one)
    torch.testing.assert_close(gradient.sum(), total, rtol=1e-9, atol=0)
    assert gradient.abs().min() > 0


def test_gradients_do_not_depend_on_the_way_to_the_equilibrium(cell):
    """Hyperelasticity has no memory: a warm start changes nothing."""
    c = cell("neo_hookean", "tet4")
    gradients = []
    for start in (None, c.solve().numpy()):
        e = c.inputs["youngs"].clone().requires_grad_(True)
        u = c.body.solve(e, c.inputs["forces"], c.supports, start=start)
        gradients.append(torch.autograd.grad(u.pow(2).sum(), e)[0])
    torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-14)


def test_moduli_and_forces_scale_together(cell):
    """u(s e, s f, s k) = u(e, f, k): by Euler, e . du/de = -(f . du/df) without springs."""
    c = cell("mooney_rivlin", "tet10")
    supports = Supports(fixed=c.supports.springs > 0)
    e, f = (c.inputs[k].clone().requires_grad_(True) for k in ("youngs", "forces"))
    goal = c.body.solve(e, f, supports).pow(2).sum()
    by_e, by_f = torch.autograd.grad(goal, (e, f))
    torch.testing.assert_close((by_e * e).sum(), -(by_f * f).sum(), rtol=1e-9, atol=0)


def test_one_graph_serves_several_backward_passes(cell):
    c = cell("neo_hookean", "tet4")
    e = c.inputs["youngs"].clone().requires_grad_(True)
    u = c.solve(youngs=e)
    first = torch.autograd.grad(u[0].sum(), e, retain_graph=True)[0]
    second = torch.autograd.grad(u[1].sum(), e, retain_graph=True)[0]
    both = torch.autograd.grad(u.sum(), e)[0]
    torch.testing.assert_close(first + second, both, rtol=1e-10, atol=1e-14)
