"""Forces on probes and moved supports, and displacements at surface points."""

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.fem import NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.contact import Ball, Contact
from tactorch.fem.readings import Wrench, surface_rows
from tactorch.mesh import box_mesh, face_nodes

MESH = box_mesh(10.0, 3, tets_per_cell=5)
YOUNGS = 0.2 * np.exp(0.3 * np.random.default_rng(0).standard_normal(MESH.n_tets))
AXES = np.vstack([np.eye(6), np.random.default_rng(1).standard_normal((1, 6))])
WRENCH = Wrench(AXES, np.array([4.0, 5.0, 9.0]))


def _body(element: str) -> SoftBody:
    material = make_material("neo_hookean", 0.4)
    return SoftBody(MESH, material, element=element, newton=NewtonOptions(rtol=1e-12))


def _search(body: SoftBody, kind: str):
    """A ball that presses the top, or the top that is moved."""
    n = MESH.n_points
    fixed, prescribed = np.zeros((n, 3), dtype=bool), np.zeros((n, 3))
    fixed[face_nodes(MESH, "z-")] = True
    contact = None
    if kind == "ball":
        position = np.array([5.3, 4.6, 13.2])
        contact = Contact.of(body.discretisation, Ball(4.0), position, 0.2)
    else:  # a platen without friction, or one that is bonded
        top = face_nodes(MESH, "z+")
        fixed[top, 2] = True
        prescribed[top, 2] = -0.6
        if kind == "support":
            fixed[top] = True
            prescribed[top] = 0.2, 0.1, -0.6
    supports = Supports(fixed=fixed, prescribed=prescribed)

    def search(youngs):
        return body.search(youngs, np.zeros((body.n_nodes, 3)), supports, contact=contact)

    return search


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize("kind", ["ball", "support", "platen"])
def test_force_and_moment_balance_those_at_the_bottom(element: str, kind: str) -> None:
    body = _body(element)
    newton = _search(body, kind)(YOUNGS)
    result = newton.run().require()
    force, moment = np.split(WRENCH.value(newton, result)[:6], 2)
    below = newton.support_forces(result)
    bottom = np.abs(body.discretisation.positions[:, 2]) < 1e-9
    below[~bottom] = 0.0
    arms = body.discretisation.positions + result.displacement - WRENCH.about_mm
    np.testing.assert_allclose(force, below.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(moment, np.cross(arms, below).sum(axis=0), atol=1e-8)
    assert force[2] > 0.05  # the body pushes the probe up
    weights = AXES[6]
    mixed = weights[:3] @ force + weights[3:] @ moment
    assert WRENCH.value(newton, result)[6] == pytest.approx(mixed)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize("kind", ["ball", "support", "platen"])
def test_derivatives_by_moduli_are_finite_differences(element: str, kind: str) -> None:
    from tactorch.fem import Sensitivity

    search = _search(_body(element), kind)
    newton = search(YOUNGS)
    result = newton.run().require()
    rates = WRENCH.rates(newton, result)
    observed = np.array([5, 40], dtype=np.int64)
    case = Sensitivity(newton.linearize(result), observed, readings=rates)
    change = YOUNGS * np.random.default_rng(2).standard_normal(len(YOUNGS))
    step = 1e-5
    values = []
    for sign in (1.0, -1.0):
        other = search(YOUNGS + sign * step * change)
        moved = other.run(result.displacement).require()
        seen = moved.displacement.ravel()[observed]
        values.append(np.concatenate([seen, WRENCH.value(other, moved)]))
    expected = (values[0] - values[1]) / (2.0 * step)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(case.matrix() @ change, expected, atol=1e-7 * scale)
    np.testing.assert_allclose(case.times_each(change[None])[0][:, 0], expected, atol=1e-7 * scale)
    weights = np.random.default_rng(3).standard_normal(len(expected))
    product = case.transpose_times(weights) @ change
    assert product == pytest.approx(weights @ expected, rel=1e-6)


def test_a_force_needs_something_that_moves() -> None:
    body = _body("tet4")
    fixed = np.zeros((MESH.n_points, 3), dtype=bool)
    fixed[face_nodes(MESH, "z-")] = True
    forces = np.zeros((body.n_nodes, 3))
    forces[face_nodes(MESH, "z+"), 2] = -1e-3
    newton = body.search(YOUNGS, forces, Supports(fixed=fixed))
    with pytest.raises(ConfigError, match="no support is moved"):
        WRENCH.value(newton, newton.run().require())


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_displacements_at_surface_points_are_interpolated(element: str) -> None:
    body = _body(element)
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(0.0, 10.0, (20, 2)), np.full(20, 10.3)])
    directions = rng.standard_normal((20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows = surface_rows(body.discretisation, points, directions)
    slope, offset = rng.standard_normal((3, 3)), rng.standard_normal(3)

    def field(x: np.ndarray) -> np.ndarray:
        value = x @ slope + offset
        return value + 0.1 * x[:, :1] * x[:, 1:2] if element == "tet10" else value

    on_surface = points * [1.0, 1.0, 0.0] + [0.0, 0.0, 10.0]
    expected = (field(on_surface) * directions).sum(axis=1)
    found = rows @ field(body.discretisation.positions).ravel()
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_a_point_far_from_the_body_is_refused() -> None:
    body = _body("tet4")
    points = np.array([[5.0, 5.0, 10.0], [0.005, 0.005, 30.0]])
    with pytest.raises(ConfigError, match=r"surface point 1 at .* is 20 mm from the body"):
        surface_rows(body.discretisation, points, np.tile([0.0, 0.0, 1.0], (2, 1)))
