"""The equilibrium search: it goes downhill, survives, or says why not."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from tactorch.errors import ConvergenceError
from tactorch.fem import ELEMENTS, MATERIALS, NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.materials.base import lame
from tactorch.mesh import box_mesh

# Give up soon: these tests are about how it ends, not about how far it gets.
SHORT = NewtonOptions(max_iterations=12, max_step_iterations=8, min_load_step=0.2)


@pytest.fixture(params=ELEMENTS.names())
def element(request):
    return request.param


def body_of(mesh, element="tet4", material="neo_hookean", poisson=0.45, **options):
    return SoftBody(mesh, make_material(material, poisson), element=element, **options)


def sliding(mesh, clamped):
    """Clamped below; the top moves up and down only, so that no load can topple the block."""
    fixed = clamped(mesh, "z-")
    fixed[clamped(mesh, "z+")[:, 0], :2] = True
    return Supports(fixed=fixed)


@pytest.mark.parametrize("material", [m for m in MATERIALS.names() if m != "linear"])
def test_energy_falls_in_every_iteration(material, element, block, clamped):
    body = body_of(block, element, material)
    # Saint Venant-Kirchhoff softens under compression and gives way early.
    press = -0.02 if material == "st_venant_kirchhoff" else -0.08
    forces = body.traction("z+", [0.03, 0.0, press]).numpy()
    youngs = np.random.default_rng(0).uniform(0.5, 2.0, block.n_tets)
    found = body.equilibrate(youngs, forces, Supports(fixed=clamped(block, "z-")))
    assert found.converged, found.reason
    assert found.load_steps == 1
    assert len(found.energies) == found.iterations + 1 >= 4
    energies = np.array(found.energies)
    round_off = 1e-13 * np.abs(energies).max()
    assert np.all(np.diff(energies) < round_off)
    assert energies[0] == 0.0
    assert energies[-1] < -1e-3


def test_linear_elasticity_takes_one_iteration(element, block, clamped):
    body = body_of(block, element, "linear")
    forces = body.traction("z+", [0.03, 0.0, -0.08]).numpy()
    found = body.equilibrate(np.ones(block.n_tets), forces, Supports(fixed=clamped(block, "z-")))
    assert found.converged
    assert found.iterations == 1


def test_convergence_is_quadratic(element, block, clamped):
    """From three digits to twelve in two iterations; slower means a wrong tangent."""
    iterations = []
    for rtol in (1e-3, 1e-12):
        body = body_of(block, element, newton=NewtonOptions(rtol=rtol))
        forces = body.traction("z+", [0.02, 0.0, -0.08]).numpy()
        supports = Supports(fixed=clamped(block, "z-"))
        found = body.equilibrate(np.ones(block.n_tets), forces, supports)
        assert found.converged
        iterations.append(found.iterations)
    assert 0 < iterations[1] - iterations[0] <= 2


def test_load_steps_take_over_where_one_step_fails(block, clamped):
    supports = sliding(block, clamped)
    youngs = np.ones(block.n_tets)
    patient = body_of(block, "tet10")
    forces = patient.pressure("z+", 2.0).numpy()
    expected = patient.equilibrate(youngs, forces, supports)
    assert expected.converged
    assert expected.load_steps == 1
    assert expected.iterations > 6
    hurried = body_of(block, "tet10", newton=NewtonOptions(max_iterations=6))
    found = hurried.equilibrate(youngs, forces, supports)
    assert found.converged, found.reason
    assert found.load_steps > 1
    assert found.iterations > expected.iterations
    np.testing.assert_allclose(found.displacement, expected.displacement, atol=1e-8)


def test_heavy_loads_end_with_every_element_the_right_way_out(element, block, clamped):
    body = body_of(block, element)
    forces = body.pressure("z+", 2.0).numpy()
    found = body.equilibrate(np.ones(block.n_tets), forces, sliding(block, clamped))
    assert found.converged, found.reason
    assert found.response.smallest_volume_ratio[1] > 0
    top = clamped(block, "z+")[:, 0]
    assert found.displacement[: block.n_points][top, 2].mean() < -4.0  # of 10 mm


def test_a_hole_beside_soft_tissue_survives(element, block, clamped):
    body = body_of(block, element)
    hole = np.linalg.norm(block.centroids - 5.0, axis=1) < 3.0
    assert hole.sum() >= 5
    youngs = np.where(hole, 0.001, 0.2)
    forces = body.pressure("z+", 0.02).numpy()
    supports = Supports(fixed=clamped(block, "z-"))
    found = body.equilibrate(youngs, forces, supports)
    assert found.converged, found.reason
    assert found.residual < 1e-9
    full = body.equilibrate(np.full(block.n_tets, 0.2), forces, supports)
    top = clamped(block, "z+")[:, 0]
    sink = [f.displacement[: block.n_points][top, 2].mean() for f in (found, full)]
    assert sink[0] < 1.05 * sink[1] < 0


@pytest.mark.parametrize(
    ("material", "pressure_mpa", "message"),
    [
        ("neo_hookean", 20_000.0, r"collapses.*beyond 0% of the load.*check their unit"),
        (
            "st_venant_kirchhoff",
            1.0,
            r"collapses.*element \d+ near \(.*\) mm with 1 MPa.*of the load",
        ),
    ],
    ids=["pascals-for-megapascals", "beyond-what-the-material-bears"],
)
def test_collapse_is_refused(material, pressure_mpa, message, element, clamped):
    coarse = box_mesh(10.0, 2, tets_per_cell=5)
    body = body_of(coarse, element, material, newton=SHORT)
    forces = body.pressure("z+", pressure_mpa).numpy()
    found = body.equilibrate(np.ones(coarse.n_tets), forces, Supports(fixed=clamped(coarse, "z-")))
    assert not found.converged
    with pytest.raises(ConvergenceError, match=message):
        found.require()


def test_nothing_held_is_refused(element, block):
    body = body_of(block, element)
    forces = body.pressure("z+", 0.01).numpy()
    with pytest.raises(ConvergenceError, match=r"Nothing holds the object.*Fix a face"):
        body.equilibrate(np.ones(block.n_tets), forces, Supports()).require()


@pytest.mark.parametrize("nodes", [[0], [0, 1]], ids=["one-node", "two-nodes"])
def test_a_block_free_to_turn_is_not_held(nodes, block):
    body = body_of(block, newton=SHORT)
    fixed = np.zeros((block.n_points, 3), dtype=bool)
    fixed[nodes] = True
    forces = body.traction("z+", [0.01, 0.02, 0.0]).numpy()
    with pytest.raises(ConvergenceError, match=r"hold|held"):
        body.equilibrate(np.ones(block.n_tets), forces, Supports(fixed=fixed)).require()


def test_three_nodes_hold(block):
    body = body_of(block, "tet4", "linear")
    fixed = np.zeros((block.n_points, 3), dtype=bool)
    fixed[[0, 1, 4]] = True
    forces = body.traction("z+", [0.0, 0.0, -0.001]).numpy()
    assert body.equilibrate(np.ones(block.n_tets), forces, Supports(fixed=fixed)).converged


def test_failure_is_a_value_first(block):
    """`equilibrate` never raises; `require` does."""
    found = body_of(block).equilibrate(
        np.ones(block.n_tets), np.zeros((block.n_points, 3)), Supports()
    )
    assert not found.converged
    assert found.iterations == 0
    assert found.response is None


@pytest.mark.parametrize("shift", [0.5, -2.0, -6.0])
def test_prescribed_displacements_are_met_exactly(shift, element, block, clamped):
    body = body_of(block, element)
    prescribed = np.zeros((block.n_points, 3))
    top = clamped(block, "z+")[:, 0]
    prescribed[top] = (0.3, 0.0, shift)
    supports = Supports(fixed=clamped(block, "z-", "z+"), prescribed=prescribed)
    found = body.equilibrate(np.ones(block.n_tets), np.zeros((block.n_points, 3)), supports)
    assert found.converged, found.reason
    vertices = found.displacement[: block.n_points]
    np.testing.assert_array_equal(vertices[top], prescribed[top])
    np.testing.assert_array_equal(vertices[clamped(block, "z-")[:, 0]], 0.0)
    inside = ~clamped(block, "z-", "z+")[:, 0]
    assert np.abs(vertices[inside]).min() > 0


def test_prescribed_displacements_beyond_one_step_are_walked_up_to(block, clamped):
    """Moving one layer through the next inverts it: only steps get there."""
    fine = block
    body = body_of(fine, "tet4")
    prescribed = np.zeros((fine.n_points, 3))
    top = clamped(fine, "x+")[:, 0]
    prescribed[top, 2] = 14.0
    prescribed[top, 0] = -6.0
    supports = Supports(fixed=clamped(fine, "x-", "x+"), prescribed=prescribed)
    found = body.equilibrate(np.ones(fine.n_tets), np.zeros((fine.n_points, 3)), supports)
    assert found.converged, found.reason
    assert found.response.smallest_volume_ratio[1] > 0


def test_no_load_is_no_displacement_at_once(element, block, clamped):
    body = body_of(block, element)
    found = body.equilibrate(
        np.ones(block.n_tets),
        np.zeros((block.n_points, 3)),
        Supports(fixed=clamped(block, "z-")),
    )
    assert found.converged
    assert found.iterations == 0
    np.testing.assert_array_equal(found.displacement, 0.0)


def test_a_start_at_the_answer_costs_nothing(block, clamped):
    body = body_of(block)
    youngs, supports = np.ones(block.n_tets), Supports(fixed=clamped(block, "z-"))
    forces = body.pressure("z+", 0.05).numpy()
    cold = body.equilibrate(youngs, forces, supports)
    warm = body.equilibrate(youngs, forces, supports, start=cold.displacement)
    assert cold.iterations >= 3
    assert warm.iterations == 0


def test_an_inverted_start_is_recovered_from(block, clamped):
    body = body_of(block)
    youngs, supports = np.ones(block.n_tets), Supports(fixed=clamped(block, "z-"))
    forces = body.pressure("z+", 0.05).numpy()
    start = np.zeros((body.n_nodes, 3))
    start[:, 2] = -2.0 * block.points[:, 2]
    found = body.equilibrate(youngs, forces, supports, start=start)
    cold = body.equilibrate(youngs, forces, supports)
    assert found.converged
    np.testing.assert_allclose(found.displacement, cold.displacement, atol=1e-8)


@pytest.mark.parametrize("solver", ["pardiso", "superlu", "multigrid", "torch_cg"])
def test_solvers_find_the_same_equilibrium(solver, block, clamped):
    from tactorch.linalg import available_solvers

    if solver not in available_solvers():
        pytest.skip(f"{solver} is not installed")
    body, plain = body_of(block, solver=solver), body_of(block)
    forces = body.pressure("z+", 0.1).numpy()
    supports = Supports(fixed=clamped(block, "z-"))
    found = [b.equilibrate(np.ones(block.n_tets), forces, supports) for b in (body, plain)]
    np.testing.assert_allclose(found[0].displacement, found[1].displacement, atol=1e-9)


def test_a_column_that_buckles_is_unstable_not_squeezed() -> None:
    """A cube of 20 mm under a dead pressure; three planes of symmetry leave an eighth of it.

    Uniform compression is unstable beyond 0.295 E: by Ritz's method with polynomials of degree 6
    for the second variation of the energy, without a mesh. Coarse meshes are stiffer.
    """
    mesh, ratio = box_mesh(10.0, 2), 0.499
    fixed = np.isclose(mesh.points, 0.0)
    body = body_of(mesh, "tet10", poisson=ratio, newton=SHORT)
    youngs, supports = np.ones(mesh.n_tets), Supports(fixed=fixed)
    search = body.search(youngs, body.pressure("z+", 0.25).numpy(), supports)
    start = search.run()
    assert start.converged
    lower, upper = (_uniform(body, ratio, pressure) for pressure in (0.25, 0.45))
    np.testing.assert_allclose(start.displacement, lower, atol=1e-6)
    assert not search._is_unstable(lower, search._respond(lower), 1.0)
    assert search._is_unstable(upper, search._respond(upper), 0.45 / 0.25)
    found = body.equilibrate(youngs, body.pressure("z+", 0.6).numpy(), supports)
    with pytest.raises(ConvergenceError, match=r"no stable equilibrium .* buckles or leans over"):
        found.require()


def _uniform(body: SoftBody, ratio: float, pressure: float) -> np.ndarray:
    """Return the displacement of uniform compression by a dead pressure, for E = 1 MPa."""
    lam, mu = lame(ratio)

    def unbalanced(stretches: np.ndarray) -> list[float]:
        along, across = stretches
        log_j = np.log(along * across**2)
        axial = mu * (along - 1.0 / along) + lam * log_j / along + pressure
        return [axial, mu * (across - 1.0 / across) + lam * log_j / across]

    along, across = fsolve(unbalanced, [0.8, 1.1])
    strain = np.array([across, across, along]) - 1.0
    return np.asarray(body.discretisation.extend(body.mesh.points) * strain)
