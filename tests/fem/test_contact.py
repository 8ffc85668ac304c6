"""Contact with a rigid probe: consistency, derivatives, errors."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

from tactorch.errors import ConfigError
from tactorch.fem import NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.contact import PROBES, Ball, Contact, Cylinder, FlatPunch
from tactorch.mesh import box_mesh, face_nodes

YOUNGS = 0.2
MESH = box_mesh(10.0, 3, tets_per_cell=5)
PROBE_CASES = [
    (Ball(6.0), 15.3),
    (FlatPunch(3.0, 1.0), 9.4),
    (Cylinder(4.0), 13.4),
]


def _body(element: str, mesh=MESH) -> SoftBody:
    material = make_material("neo_hookean", 0.4)
    return SoftBody(mesh, material, element=element, newton=NewtonOptions(rtol=1e-12))


def _supports(mesh=MESH) -> Supports:
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    fixed[face_nodes(mesh, "z-")] = True
    return Supports(fixed=fixed)


def _contact(body: SoftBody, probe, height_mm: float, **options) -> Contact:
    return Contact.of(
        body.discretisation, probe, np.array([5.3, 4.6, height_mm]), YOUNGS, **options
    )


def _press(body: SoftBody, contact: Contact):
    n = body.mesh.n_points
    uniform, nothing = np.full(body.mesh.n_tets, YOUNGS), np.zeros((n, 3))
    return body.equilibrate(uniform, nothing, _supports(body.mesh), contact=contact).require()


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize(("probe", "height_mm"), PROBE_CASES)
def test_the_force_on_the_probe_is_that_on_the_supports(element, probe, height_mm) -> None:
    body = _body(element)
    contact = _contact(body, probe, height_mm)
    result = _press(body, contact)
    assert result.load_steps == 1
    response = contact.at(result.displacement)
    youngs = np.full(MESH.n_tets, YOUNGS)
    internal = body.assembly.internal_force(result.response, youngs)
    bottom = np.abs(body.discretisation.positions[:, 2]) < 1e-9
    np.testing.assert_allclose(internal[bottom].sum(axis=0), response.force_n, atol=1e-8)
    np.testing.assert_allclose(response.forces.sum(axis=0), response.force_n, atol=1e-12)
    assert response.force_n[2] > 0.02
    reaction = contact.reaction(
        torch.from_numpy(result.displacement), torch.from_numpy(contact.parameters)
    )
    np.testing.assert_allclose(reaction[:3].numpy(), response.force_n, atol=1e-12)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize(("probe", "height_mm"), PROBE_CASES)
def test_forces_and_tangent_are_derivatives_of_the_energy(element, probe, height_mm) -> None:
    body = _body(element)
    contact = _contact(body, probe, height_mm)
    rng = np.random.default_rng(0)
    u = 0.05 * rng.standard_normal((body.n_nodes, 3))
    change, step = rng.standard_normal((body.n_nodes, 3)), 1e-6
    response = contact.at(u)
    low, high = (contact.energy(u + sign * step * change) for sign in (-1.0, 1.0))
    slope = float((response.forces * change).sum())
    assert slope == pytest.approx((high - low) / (2.0 * step), rel=1e-6)
    assert contact.energy(u) == pytest.approx(response.energy)
    values = np.zeros(body.discretisation.pattern.nnz)
    contact.add_tangent(values, response)
    product = body.discretisation.pattern.product(values, change.ravel())
    low, high = (contact.at(u + sign * step * change).forces for sign in (-1.0, 1.0))
    expected = (high - low).ravel() / (2.0 * step)
    np.testing.assert_allclose(product, expected, atol=1e-5 * np.abs(expected).max())
    projected = np.zeros_like(values)
    contact.add_tangent(projected, response, project=True)
    dense = body.discretisation.pattern
    assert change.ravel() @ dense.product(projected, change.ravel()) >= change.ravel() @ product


@pytest.mark.parametrize(
    ("element", "probe", "height_mm"),
    [
        ("tet4", *PROBE_CASES[0]),
        pytest.param("tet4", *PROBE_CASES[1], marks=pytest.mark.slow),
        pytest.param("tet10", *PROBE_CASES[0], marks=pytest.mark.slow),
        pytest.param("tet10", *PROBE_CASES[1], marks=pytest.mark.slow),
        pytest.param("tet10", *PROBE_CASES[2], marks=pytest.mark.slow),
    ],
)
def test_derivatives_by_modulus_force_pose_and_sizes(element, probe, height_mm) -> None:
    mesh = box_mesh(10.0, 2, tets_per_cell=5)
    body, supports = _body(element, mesh), _supports(mesh)
    contact = _contact(body, probe, height_mm, relative_stiffness=20.0)
    generator = torch.Generator().manual_seed(0)
    youngs = YOUNGS * (
        1.0 + 0.2 * torch.rand(mesh.n_tets, dtype=torch.float64, generator=generator)
    )
    forces = 1e-3 * torch.randn(mesh.n_points, 3, dtype=torch.float64, generator=generator)
    parameters = torch.from_numpy(contact.parameters).clone()
    parameters[3:6] += torch.tensor([0.02, -0.03, 0.01])
    inputs = tuple(tensor.requires_grad_() for tensor in (youngs, forces, parameters))

    def outputs(youngs, forces, parameters):
        u = body.solve(youngs, forces, supports, contacts=contact, probes=parameters)
        return torch.cat([u[::3].reshape(-1)[:12], contact.reaction(u, parameters)])

    options = {"eps": 1e-6, "fast_mode": True}
    assert gradcheck(outputs, inputs, atol=1e-6, rtol=1e-4, **options)
    assert gradgradcheck(outputs, inputs, atol=1e-5, rtol=1e-3, **options)


def test_cases_have_a_contact_each() -> None:
    body, supports = _body("tet4"), _supports()
    contacts = [_contact(body, Ball(6.0), height) for height in (15.6, 15.3)]
    youngs = torch.full((MESH.n_tets,), YOUNGS, dtype=torch.float64)
    nothing = torch.zeros(2, MESH.n_points, 3, dtype=torch.float64)
    both = body.solve(youngs, nothing, supports, contacts=contacts)
    for u, contact in zip(both, contacts, strict=True):
        expected = _press(body, contact).displacement
        np.testing.assert_allclose(u.numpy(), expected, atol=1e-8)
    with pytest.raises(ConfigError, match="1 contacts for 2 load cases"):
        body.solve(youngs, nothing, supports, contacts=contacts[:1])
    with pytest.raises(ConfigError, match="probes have shape"):
        body.solve(youngs, nothing, supports, contacts=contacts, probes=torch.zeros(2, 3).double())
    points = torch.tensor(MESH.points)
    with pytest.raises(ConfigError, match="points cannot be given"):
        body.solve(youngs, nothing, supports, contacts=contacts, points=points)


def test_a_turned_probe_pushes_along_its_axis() -> None:
    """A punch from the side x+ as from the top of the turned cube."""
    mesh = box_mesh(10.0, 3, tets_per_cell=5)
    body = _body("tet4", mesh)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    contact = Contact.of(
        body.discretisation, Ball(6.0), np.array([15.3, 5.0, 5.0]), YOUNGS, rotation=turn
    )
    assert contact.approach_mm[0] < 0.0
    np.testing.assert_allclose(contact.approach_mm[1:], 0.0, atol=1e-12)
    response = contact.at(_press(body, contact).displacement)
    assert response.force_n[0] > 10.0 * np.abs(response.force_n[1])


def test_a_deep_press_is_applied_in_steps() -> None:
    body = _body("tet4")
    contact = _contact(body, Ball(3.0), 9.0)  # the tip is 4 mm below the top
    result = _press(body, contact)
    shallow = _press(body, _contact(body, Ball(3.0), 12.0))
    force = contact.at(result.displacement).force_n[2]
    assert force > 3.0 * _contact(body, Ball(3.0), 12.0).at(shallow.displacement).force_n[2]
    inside = -contact._distances(result.displacement).min()
    assert inside < 0.1


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(["ball", "cylinder", "flat"]),
    point=st.tuples(*[st.floats(-6.0, 6.0)] * 3),
)
def test_distances_have_gradients_of_one(name: str, point: tuple[float, float, float]) -> None:
    sizes = {"radius_mm": 2.0} | ({"edge_mm": 0.4} if name == "flat" else {})
    probe = PROBES.build({"name": name, **sizes})
    x = torch.tensor([point], dtype=torch.float64, requires_grad=True)
    distance = probe.distance(x, torch.tensor(probe.sizes, dtype=torch.float64))
    (slope,) = torch.autograd.grad(distance.sum(), x)
    length, away = float(slope.norm()), float(distance.detach())
    assert length < 1.0 + 1e-9
    if away > 1e-6:  # within a flat punch two parts of its surface may be equally near
        assert length == pytest.approx(1.0, abs=1e-6)
        nearest = (x - distance[:, None] * slope).detach()
        again = probe.distance(nearest, torch.tensor(probe.sizes, dtype=torch.float64))
        assert float(again) == pytest.approx(0.0, abs=1e-6)


def test_errors_name_what_is_wrong() -> None:
    body = _body("tet4")
    with pytest.raises(ConfigError, match="does not touch the body: it is 1 mm away"):
        _contact(body, Ball(6.0), 17.0)
    with pytest.raises(ConfigError, match="not finite"):
        _contact(body, Ball(6.0), np.nan)
    with pytest.raises(ConfigError, match="rotation is not a rotation"):
        _contact(body, Ball(6.0), 15.3, rotation=2.0 * np.eye(3))
    with pytest.raises(ConfigError, match=r"probe\.edge_mm=3.* exceeds"):
        FlatPunch(2.0, 3.0)
    with pytest.raises(ConfigError, match="radius_mm"):
        Ball(-1.0)
    with pytest.raises(ConfigError, match="choose one of ball, flat, cylinder"):
        PROBES.build({"name": "bal", "radius_mm": 1.0})
    small = replace(_contact(body, Ball(6.0), 15.3), position_mm=np.array([5.0, 5.0, 40.0]))
    assert not small.at(np.zeros((MESH.n_points, 3))).forces.any()
