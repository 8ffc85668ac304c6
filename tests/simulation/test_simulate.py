from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError, MeshError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import MeshSize, Phantom, make_phantom
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.simulation import PressPlan, simulate

# Stretch and lateral stretch under a nominal traction of -0.2 MPa at 1 MPa (DESIGN.md).
UNIAXIAL = {
    0.30: (0.828310984658, 1.056797425871),
    0.45: (0.833017354831, 1.084927637795),
    0.49: (0.834457641796, 1.092545793302),
}


def seen(press: Press) -> np.ndarray:
    return press.displacement[press.observed].reshape(-1, 3)


def depth(press: Press) -> float:
    """Mean displacement along the push."""
    assert press.direction is not None
    return float(np.mean(seen(press) @ press.direction))


@pytest.mark.parametrize("poisson", sorted(UNIAXIAL))
@pytest.mark.parametrize("face", ["z+", "x-"])
def test_uniform_cube_on_rollers_is_the_uniaxial_solution(poisson: float, face: str) -> None:
    cube = make_phantom("uniform_cube", side_mm=1.0, youngs_mpa=1.0)
    plan = PressPlan(face, (0.1, 0.2), support="roller")
    mesh, law = box_mesh(1.0, 3), MaterialSpec("neo_hookean", poisson)
    press = simulate(cube, plan, mesh=mesh, material=law).presses[-1]
    stretch, lateral = UNIAXIAL[poisson]
    axis = "xyz".index(face[0])
    moved = seen(press)
    np.testing.assert_allclose(moved @ press.direction, 1.0 - stretch, atol=1e-9)
    across = np.delete(moved, axis, axis=1)
    np.testing.assert_allclose(np.ptp(across, axis=0), lateral - 1.0, atol=1e-9)


def test_uniaxial_solution_survives_a_finer_mesh_and_quadratic_elements() -> None:
    cube = make_phantom("uniform_cube", side_mm=1.0, youngs_mpa=1.0)
    plan = PressPlan("z+", (0.2,), support="roller")
    for fine, element in ((box_mesh(1.0, 3), "tet4"), (box_mesh(1.0, 3), "tet10"), (None, "tet10")):
        recording = simulate(cube, plan, mesh=box_mesh(1.0, 2), fine_mesh=fine, element=element)
        np.testing.assert_allclose(depth(recording.presses[0]), 1.0 - UNIAXIAL[0.45][0], atol=1e-9)


def test_recording_holds_the_plan(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(("z+", "x-"), (0.01, 0.02))
    recording = simulate(phantom, plan, mesh=mesh)
    assert [p.name for p in recording.presses] == [
        "z+, 10 kPa", "z+, 20 kPa", "x-, 10 kPa", "x-, 20 kPa"
    ]  # fmt: skip
    assert [p.step for p in recording.presses] == [0, 1, 0, 1]
    for press, pressure in zip(recording.presses, (0.01, 0.02) * 2, strict=True):
        assert press.direction is not None
        np.testing.assert_allclose(press.total_force, 100 * pressure * press.direction, rtol=1e-12)
        np.testing.assert_array_equal(press.observed.any(axis=1), press.observed.all(axis=1))
        assert press.noise_mm is None
    top, left = recording.presses[0], recording.presses[2]
    np.testing.assert_array_equal(top.observed[:, 0], mesh.points[:, 2] == 10.0)
    np.testing.assert_array_equal(left.observed[:, 0], mesh.points[:, 0] == 0.0)
    np.testing.assert_array_equal(top.springs, np.repeat(mesh.points[:, 2:] == 0.0, 3, axis=1))
    assert not top.fixed.any()
    np.testing.assert_array_equal(recording.truth, phantom.on_mesh(mesh))


@pytest.mark.parametrize("support", ["springs", "fixed", "roller"])
def test_same_mesh_is_an_exact_solution_of_the_recorded_problem(
    phantom: Phantom, mesh: TetMesh, support: str
) -> None:
    recording = simulate(phantom, PressPlan("y+", (0.01, 0.02), support=support), mesh=mesh)
    press, law = recording.presses[1], recording.material
    body = SoftBody(mesh, make_material(law.name, law.poisson))
    supports = Supports(fixed=press.fixed, springs=press.springs)
    assert recording.truth is not None
    found = body.equilibrate(recording.truth, press.forces, supports).require()
    np.testing.assert_allclose(
        found.displacement[press.observed], press.displacement[press.observed], atol=1e-8
    )
    assert recording.provenance["inverse_crime"] is True
    assert recording.provenance["fine_mesh"] is None


def test_springs_carry_the_load(phantom: Phantom, mesh: TetMesh) -> None:
    soft, stiff, fixed = (
        depth(simulate(phantom, plan, mesh=mesh).presses[0])
        for plan in (
            PressPlan(pressures_mpa=(0.02,), spring_n_per_mm=1.0),
            PressPlan(pressures_mpa=(0.02,), spring_n_per_mm=1e4),
            PressPlan(pressures_mpa=(0.02,), support="fixed"),
        )
    )
    # Thirty-six springs under 2 N give way by 2 / 36 mm, and sideways a little.
    assert 1.0 < (soft - fixed) / (2.0 / 36.0) < 1.5
    assert stiff == pytest.approx(fixed, rel=1e-4)


def test_stiffer_inclusion_moves_less(mesh: TetMesh) -> None:
    plan = PressPlan(pressures_mpa=(0.02,))
    depths = [
        depth(simulate(make_phantom("cube_box", inclusion_mpa=e), plan, mesh=mesh).presses[0])
        for e in (0.05, 0.2, 1.0)
    ]
    assert depths[0] > depths[1] > depths[2] > 0


def test_seed_repeats_bit_for_bit(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(("z+", "x+"), (0.01, 0.02))

    def noisy(seed: int) -> Recording:
        return simulate(phantom, plan, mesh=mesh, snr_db=20.0, seed=seed)

    first, again, other = noisy(1), noisy(1), noisy(2)
    for a, b, c in zip(first.presses, again.presses, other.presses, strict=True):
        assert seen(a).tobytes() == seen(b).tobytes()
        assert a.noise_mm == b.noise_mm == c.noise_mm
        assert not np.isclose(seen(a), seen(c), rtol=1e-6).any()


def test_noise_is_recorded_and_independent_between_presses(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(("z+", "x+"), (0.01, 0.02))
    clean = simulate(phantom, plan, mesh=mesh)
    noisy = simulate(phantom, plan, mesh=mesh, snr_db=20.0)
    draws = []
    for exact, press in zip(clean.presses, noisy.presses, strict=True):
        assert press.noise_mm == pytest.approx(0.1 * np.sqrt((seen(exact) ** 2).mean()), rel=1e-6)
        draws.append((seen(press) - seen(exact)).ravel() / press.noise_mm)
    assert np.abs(np.corrcoef(draws) - np.eye(4)).max() < 0.35
    assert np.std(draws) == pytest.approx(1.0, rel=0.15)
    alone = simulate(phantom, replace(plan, faces=("z+",)), mesh=mesh, snr_db=20.0)
    assert seen(alone.presses[1]).tobytes() == seen(noisy.presses[1]).tobytes()


@pytest.mark.slow
def test_presses_are_those_of_the_object() -> None:
    """The default agrees with a mesh by fTetWild, whose elements are inside or outside."""
    phantom = make_phantom("cube_sphere")
    mesh, fine = MeshSize().build(phantom)
    conforming = phantom.mesh(1.2, conforming=True)
    plan = PressPlan(pressures_mpa=(0.02,))
    found, exact = (
        seen(
            simulate(
                phantom, plan, mesh=mesh, fine_mesh=solved, samples=samples, element="tet10",
                solver="p_multigrid",
            ).presses[0]
        )
        for solved, samples in ((fine, 4), (conforming, 1))
    )  # fmt: skip
    # The noise of 40 dB is 1e-2; fTetWild gives another mesh in each run, itself 1e-3 off.
    assert np.linalg.norm(found - exact) < 3e-3 * np.linalg.norm(exact)


def test_moduli_are_at_quadrature_points_of_a_finer_quadratic_mesh(
    phantom: Phantom, mesh: TetMesh, fine: TetMesh
) -> None:
    plan = PressPlan(pressures_mpa=(0.02,))

    def modulus(fine_mesh: TetMesh | None, **settings: Any) -> str:
        recording = simulate(phantom, plan, mesh=mesh, fine_mesh=fine_mesh, **settings)
        np.testing.assert_array_equal(
            recording.truth, phantom.on_mesh(mesh, settings.get("samples", 1))
        )
        return recording.provenance["modulus"]

    assert modulus(fine, element="tet10", samples=4) == "at quadrature points"
    assert modulus(fine, element="tet10") == "per element"
    assert modulus(fine, samples=4) == "per element"
    assert modulus(None, element="tet10", samples=4) == "per element"


def test_fine_mesh_is_close_but_no_crime(phantom: Phantom, mesh: TetMesh, fine: TetMesh) -> None:
    plan = PressPlan(("z+", "x-"), (0.02,), patch_radius_mm=4.0)
    same = simulate(phantom, plan, mesh=mesh)
    other = simulate(phantom, plan, mesh=mesh, fine_mesh=fine)
    for a, b in zip(same.presses, other.presses, strict=True):
        difference = np.linalg.norm(seen(a) - seen(b)) / np.linalg.norm(seen(a))
        assert 1e-3 < difference < 0.2
        np.testing.assert_array_equal(a.forces, b.forces)
        assert a.direction is not None
        np.testing.assert_allclose(a.total_force, 0.02 * np.pi * 16 * a.direction, rtol=1e-12)
    facts = other.provenance
    assert facts["inverse_crime"] is False
    assert (facts["fine_mesh"]["points"], facts["fine_mesh"]["tets"]) == (729, 2560)
    assert Phantom.from_config(facts["phantom"]) == phantom
    assert PressPlan(**facts["plan"]) == plan


def test_equal_fine_mesh_is_a_crime(phantom: Phantom, mesh: TetMesh) -> None:
    copy = TetMesh(mesh.points, mesh.tets)
    recording = simulate(phantom, PressPlan(pressures_mpa=(0.01,)), mesh=mesh, fine_mesh=copy)
    assert recording.provenance["inverse_crime"] is True


def test_finer_meshes_converge(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(pressures_mpa=(0.02,))
    depths = [
        depth(simulate(phantom, plan, mesh=mesh, fine_mesh=box_mesh(10.0, n), samples=4).presses[0])
        for n in (3, 6, 12)
    ]
    assert abs(depths[2] - depths[1]) < 0.6 * abs(depths[1] - depths[0])
    assert depths[2] > depths[1] > depths[0]  # a finer mesh is softer


def test_springs_and_elements_agree_across_meshes() -> None:
    cube = make_phantom("uniform_cube")
    plan, mesh = PressPlan(pressures_mpa=(0.02,)), box_mesh(10.0, 4, tets_per_cell=5)
    law = MaterialSpec("neo_hookean", 0.3)
    fine = box_mesh(10.0, 6, tets_per_cell=5)
    depths = [
        depth(simulate(cube, plan, mesh=mesh, material=law, fine_mesh=f, element=e).presses[0])
        for f, e in ((None, "tet4"), (fine, "tet4"), (fine, "tet10"), (None, "tet10"))
    ]
    np.testing.assert_allclose(depths, depths[2], rtol=0.03)


def test_patches_are_observed_where_pressed(phantom: Phantom, mesh: TetMesh) -> None:
    centers = [(3.0, 3.0, 0.0), (7.0, 6.0, 0.0)]
    plan = PressPlan("z+", (0.02,), patch_radius_mm=2.0, patch_centers_mm=centers)
    recording = simulate(phantom, plan, mesh=mesh)
    for press, center in zip(recording.presses, centers, strict=True):
        points = mesh.points[press.observed[:, 0]]
        assert (np.linalg.norm(points[:, :2] - center[:2], axis=1) <= 2.0).all()
        np.testing.assert_allclose(press.total_force, [0, 0, -0.02 * np.pi * 4], atol=1e-12)
    assert recording.presses[0].name == "z+ at (3, 3, 0) mm, 20 kPa"


def test_weight_adds_to_the_press(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(pressures_mpa=(0.005,))
    light = simulate(phantom, plan, mesh=mesh)
    heavy = simulate(phantom, plan, mesh=mesh, density=1.07e-7)  # a hundred times silicone
    assert heavy.density == 1.07e-7
    np.testing.assert_array_equal(heavy.gravity, [0.0, 0.0, -9806.65])
    assert light.density is None
    assert depth(heavy.presses[0]) > 1.5 * depth(light.presses[0])
    np.testing.assert_array_equal(heavy.presses[0].forces, light.presses[0].forces)


def test_progress_counts_every_press(phantom: Phantom, mesh: TetMesh) -> None:
    calls: list[tuple[int, int]] = []
    plan = PressPlan(("z+", "x+", "y-"), (0.01, 0.02))
    simulate(phantom, plan, mesh=mesh, progress=lambda *at: calls.append(at))
    assert calls == [(i, 6) for i in range(1, 7)]


def test_recording_survives_its_file(phantom: Phantom, mesh: TetMesh, tmp_path: Path) -> None:
    recording = simulate(phantom, PressPlan(pressures_mpa=(0.01,)), mesh=mesh, snr_db=20.0)
    recording.save(tmp_path / "cube.h5")
    again = Recording.load(tmp_path / "cube.h5")
    assert again.provenance == recording.provenance
    np.testing.assert_array_equal(seen(again.presses[0]), seen(recording.presses[0]))


def test_collapse_names_the_press(phantom: Phantom, mesh: TetMesh) -> None:
    plan = PressPlan(pressures_mpa=(0.02, 20.0))  # kPa given for MPa
    with pytest.raises(ConvergenceError, match=r"Press z\+ at 20 MPa: .*unit"):
        simulate(phantom, plan, mesh=mesh, check_units=False)
    with pytest.raises(ConfigError, match=r"20 kPa is 0\.02"):
        simulate(phantom, plan, mesh=mesh)


def test_wrong_settings_are_refused(phantom: Phantom, mesh: TetMesh) -> None:
    for settings, error, message in (
        ({"snr_db": float("nan")}, ConfigError, "snr_db"),
        ({"seed": -1}, ConfigError, "seed=-1"),
        ({"density": 0.0}, ConfigError, "density"),
        ({"samples": 0}, ConfigError, "samples"),
        ({"element": "hex8"}, ConfigError, "hex8"),
        ({"material": MaterialSpec("jelly", 0.4)}, ConfigError, "jelly"),
        ({"mesh": box_mesh(9.0, 3)}, MeshError, "phantom's body"),
        ({"fine_mesh": box_mesh(9.0, 3)}, MeshError, "phantom's body"),
        ({"plan": PressPlan(patch_radius_mm=0.1)}, ConfigError, "patch_radius_mm"),
    ):
        arguments: dict[str, Any] = {"plan": PressPlan(), "mesh": mesh, **settings}
        with pytest.raises(error, match=message):
            simulate(phantom, **arguments)
