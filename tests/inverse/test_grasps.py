"""Grasps between two gels: equilibria, derivatives of the force, and the modulus of an object."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.fem import Supports
from tactorch.inverse import Settings, invert
from tactorch.inverse.forward.gel import GelProblem
from tactorch.inverse.search.gel import GraspSearch
from tactorch.inverse.search.gel_correction import gel_sites
from tactorch.mesh import Box, TetMesh, box_mesh
from tactorch.recording import ForceReading, GelReading, MaterialSpec, Press, Recording
from tactorch.recording.press import constant_field
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelMesh
from tactorch.touch.coupled import Coupled
from tactorch.touch.pairing import face_each_other

SIZE, YOUNGS = 6.0, 0.1
LAYER = GelLayer(2.0, 0.15, 0.45, size_mm=(8.0, 8.0))
MATERIAL = MaterialSpec("neo_hookean", 0.45)


def soft_springs(mesh: TetMesh) -> np.ndarray:
    """Springs of a hundredth of the stiffness of a cube."""
    return np.full(mesh.points.shape, 0.01 * YOUNGS * SIZE / mesh.n_points)


def tapered(mesh: TetMesh) -> TetMesh:
    points = mesh.points.copy()
    points[:, :2] *= 0.7 - 0.6 * points[:, 2:] / SIZE
    return TetMesh.create(points, mesh.tets)


def coupled(layer: GelLayer, cells: int, depth: float, sticks: bool = True) -> Coupled:
    """A cube between two gels that face each other along z."""
    mesh, gel = box_mesh(SIZE, cells, center_mm=(0.0, 0.0, 0.0)), GelMesh(layer, 8.0 / cells, 2)
    pose = np.eye(4)
    pose[2, 3] = -0.5 * SIZE - 0.2
    box = Box((0.0, 0.0, 0.0), SIZE)
    facing = face_each_other(mesh, box, gel, pose, opening_mm=SIZE + 0.5)
    assert facing is not None
    assert facing.first_touch[1] == pytest.approx(0.25)  # the mean of 0.2 and 0.3
    free = Supports(fixed=np.zeros(mesh.points.shape, bool), springs=soft_springs(mesh))
    return Coupled(
        facing, mesh, gel, MATERIAL, free, body_mpa=YOUNGS, depth_mm=depth, sticks=sticks
    )


def force(both: Coupled, depth: float, youngs: float = YOUNGS) -> np.ndarray:
    """Force of each gel on the cube along the motion of the first, N."""
    moduli = both.youngs(np.full((both.counts[0], 1), youngs))
    state = both.solve(moduli, np.array([0.0, 0.0, depth]))
    pairs = state.contact.pair_forces(state.displacement)[:, 2]
    return np.array([pairs[~both.opposed].sum(), pairs[both.opposed].sum()])


def test_cube_between_rigid_gels_has_the_force_of_uniaxial_compression() -> None:
    """Nominal traction of a fifth of the modulus at the stretch 0.833017354831, free sides."""
    depth = 0.5 * SIZE * (1.0 - 0.833017354831)
    both = coupled(replace(LAYER, youngs_mpa=20.0, thickness_mm=0.5), 4, depth, sticks=False)
    assert force(both, depth) == pytest.approx(0.2 * YOUNGS * SIZE**2, rel=0.01)


def test_both_gels_press_a_tapered_object_with_the_same_force() -> None:
    mesh, gel = tapered(box_mesh(SIZE, 4, center_mm=(0.0, 0.0, 0.0))), GelMesh(LAYER, 2.0, 2)
    pose = np.eye(4)
    pose[2, 3] = -0.5 * SIZE
    facing = face_each_other(mesh, mesh, gel, pose, opening_mm=SIZE)
    assert facing is not None
    free = Supports(fixed=np.zeros(mesh.points.shape, bool), springs=soft_springs(mesh))
    both = Coupled(facing, mesh, gel, MATERIAL, free, body_mpa=YOUNGS, depth_mm=0.6)
    first, second = force(both, 0.6)
    assert first == pytest.approx(second, rel=0.02)


def grasp(mesh: TetMesh, force_n: float, depth: float = 0.5, **changes: object) -> Press:
    first, pose = np.eye(4), np.eye(4)
    first[2, 3] = -0.5 * SIZE
    pose[2, 3] = first[2, 3] + depth
    none = np.zeros((0, 2))
    reading = GelReading(
        LAYER.numbers, pose, first, none, none, np.zeros(0), np.array([0.2, 0.01, 0.0]),
        np.array([SIZE, 0.1]),
    )  # fmt: skip
    fields = [constant_field(n, mesh.n_points) for n in ("forces", "observed", "displacement")]
    usual: dict[str, object] = {
        "springs": soft_springs(mesh), "gel": reading, "name": "grasp",
        "force": ForceReading.along((0.0, 0.0, -1.0), force_n, 0.01 * force_n),
    }  # fmt: skip
    return Press(*fields, **{**usual, **changes})  # type: ignore[arg-type]


def recording(force_n: float = 1.0) -> Recording:
    mesh = box_mesh(SIZE, 3, center_mm=(0.0, 0.0, 0.0))
    return Recording(mesh, (grasp(mesh, force_n),), MATERIAL)


def test_recording_of_a_grasp_is_the_same_from_its_file(tmp_path: Path) -> None:
    before = recording()
    before.save(tmp_path / "grasp.h5")
    after = Recording.load(tmp_path / "grasp.h5").presses[0]
    assert after.gel is not None
    assert after.gel.is_grasp
    assert before.presses[0].readings_bytes() == after.readings_bytes()
    assert after.total_force == pytest.approx([0.0, 0.0, 1.0])


def test_gel_without_markers_and_force_is_refused() -> None:
    mesh = box_mesh(SIZE, 4, center_mm=(0.0, 0.0, 0.0))
    with pytest.raises(RecordingError, match="no markers and no force"):
        grasp(mesh, 1.0, force=None)
    reading = grasp(mesh, 1.0).gel
    assert reading is not None
    with pytest.raises(RecordingError, match=r"opposed is .* positive distance"):
        replace(reading, opposed=np.array([6.0, np.nan]))


def test_grasps_and_other_presses_of_a_gel_are_separate_recordings() -> None:
    mesh = box_mesh(SIZE, 4, center_mm=(0.0, 0.0, 0.0))
    press = grasp(mesh, 1.0)
    assert press.gel is not None
    one = np.zeros((1, 2))
    marked = replace(press.gel, markers_mm=one, displacement_mm=one, deviations_mm=np.ones(1))
    with pytest.raises(RecordingError, match="markers and a force"):
        replace(press, gel=marked)
    shape = mesh.points.shape
    other = replace(
        press, force=None, gel=marked, observed=np.ones(shape, bool),
        displacement=np.full(shape, 0.1), forces=np.full(shape, 0.01),
    )  # fmt: skip
    with pytest.raises(ConfigError, match="grasps as a separate recording"):
        invert(Recording(mesh, (press, other), MATERIAL))


def test_derivatives_of_the_force_are_those_of_differences() -> None:
    """By moduli of the cube, the modulus of both gels and their distance."""
    recorded = recording()
    problem, shape = GelProblem(recorded, YOUNGS), gel_sites(recorded.mesh).shape
    youngs = np.exp(np.random.default_rng(0).normal(np.log(YOUNGS), 0.2, shape))
    evaluation = problem.evaluate(youngs)
    change, step = np.random.default_rng(1).normal(0.0, 1.0, shape), 1e-4
    up, down = (
        problem.evaluate(youngs * np.exp(s * step * change), starts=evaluation.displacements)
        for s in (1.0, -1.0)
    )
    difference = (up.predicted[0] - down.predicted[0]) / (2.0 * step)
    rates = evaluation.jacobian() / evaluation.data.scale[:, None]
    assert rates @ (youngs * change).ravel() == pytest.approx(difference, rel=1e-4)
    by_element = (rates * youngs.ravel()).reshape(len(rates), *shape).sum(axis=2)
    np.testing.assert_allclose(evaluation.log_rates(), by_element, rtol=1e-9)
    gradient = evaluation.transpose_times(np.ones(1)) / evaluation.data.scale
    assert float((gradient * youngs * change).sum()) == pytest.approx(difference[0], rel=1e-4)

    def predicted(log_gel: float, apart: float) -> float:
        layer, press = LAYER.numbers, recorded.presses[0]
        layer[1] *= np.exp(log_gel)
        assert press.gel is not None
        pose = press.gel.pose.copy()
        pose[2, 3] -= 0.5 * apart
        moved = replace(press, gel=replace(press.gel, layer=layer, pose=pose))
        other = GelProblem(replace(recorded, presses=(moved,)), YOUNGS)
        other._sticking = problem._sticking
        return float(other.evaluate(youngs, starts=evaluation.displacements).predicted[0][0])

    columns = evaluation.uncertain([0], problem.readings)[0] / evaluation.data.scale[0]
    by_gel = (predicted(0.01, 0.001) - predicted(-0.01, -0.001)) / 0.02  # 0.1 mm apart per unit
    assert columns[0] == pytest.approx(0.2 * by_gel, rel=2e-3)
    by_motion = (predicted(0.0, -0.002) - predicted(0.0, 0.002)) / 0.002
    assert columns[1] == pytest.approx(0.01 * by_motion, rel=2e-3)


def test_presses_solved_alone_have_the_predictions_of_all() -> None:
    mesh = box_mesh(SIZE, 3, center_mm=(0.0, 0.0, 0.0))
    presses = grasp(mesh, 0.5, 0.3), grasp(mesh, 1.0, 0.5)
    problem = GelProblem(Recording(mesh, presses, MATERIAL), YOUNGS)
    assert problem.contact_of == [0, 0]
    youngs = np.full(gel_sites(mesh).shape, YOUNGS)
    expected = problem.evaluate(youngs).predicted
    found = problem.predicted_alone(youngs, [1, 0])
    assert found.keys() == {0, 1}
    for i in range(2):
        assert found[i] == pytest.approx(expected[i], rel=1e-5)


def test_modulus_of_a_cube_is_found_from_the_force_of_a_grasp() -> None:
    """The force is that of a finer mesh."""
    both = coupled(LAYER, 5, 0.5)
    result = invert(recording(float(force(both, 0.5).mean())), Settings())
    assert not result.lumps
    assert result.background_mpa == pytest.approx(YOUNGS, rel=0.05)
    low, high = result.plain()["background_90_mpa"]
    assert low < YOUNGS < high
    # A fifth of the gels' modulus, 0.01 mm of 0.5 and a per cent of the force.
    assert 1.05 < high / low < 2.0
    assert "90 %" in result.summary()


def test_grasps_have_no_element_map() -> None:
    with pytest.raises(ConfigError, match=r"method=map"):
        invert(recording(), Settings(method="map"))


def test_displacements_of_a_grasp_are_in_the_frame_of_the_object() -> None:
    mesh = box_mesh(SIZE, 3, center_mm=(0.0, 0.0, 0.0))
    press = grasp(mesh, 1.0)
    assert press.gel is not None
    turn = np.eye(4)
    turn[:3, :3] = np.roll(np.eye(3), 1, axis=0)  # z of the sensor is x of the object
    poses = {name: turn @ getattr(press.gel, name) for name in ("pose", "first_pose")}
    reading = ForceReading.along((-1.0, 0.0, 0.0), 1.0, 0.01)
    turned = replace(press, gel=replace(press.gel, **poses), force=reading)
    problem = GelProblem(Recording(mesh, (turned,), MATERIAL), YOUNGS)
    evaluation = problem.evaluate(np.full(gel_sites(mesh).shape, YOUNGS))
    moved = evaluation.on_object[0][: mesh.n_points]
    assert np.corrcoef(moved[:, 0], mesh.points[:, 0])[0, 1] < -0.9
    assert evaluation.predicted[0][0] > 0.0


def test_force_of_a_rigid_object_is_refused() -> None:
    with pytest.raises(ConvergenceError, match="gripper is wider"):
        GraspSearch(recording(1e3), Settings())
