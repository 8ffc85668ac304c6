from collections.abc import Callable
from dataclasses import fields as fields_of
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import RecordingError
from tactorch.fem import ELEMENTS, Discretisation, SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh, face_nodes, refine
from tactorch.mesh.tractions import LoadedSurface
from tactorch.recording import (
    MaterialSpec,
    Press,
    Recording,
    prolong_recording,
    refine_recording,
)

PRESSURE, STIFFNESS = 0.01, 0.05  # MPa, N/mm^3


def _uniform(edge_mm: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda points: np.full(len(points), edge_mm)


def _local(points: np.ndarray) -> np.ndarray:
    return 1.2 + 0.5 * np.linalg.norm(points - [3.0, 6.0, 10.0], axis=1)


def _areas(mesh: TetMesh, face: str) -> np.ndarray:
    """Return a third of the area of the face's triangles at each node."""
    body = SoftBody(mesh, make_material("neo_hookean", 0.4))
    return np.linalg.norm(body.pressure(face, 1.0).numpy(), axis=1)


def _pressed(mesh: TetMesh, support: str = "springs", **press: Any) -> Recording:
    """A box under uniform pressure, on uniform springs or clamped below."""
    shape = (mesh.n_points, 3)
    below = face_nodes(mesh, "z-")
    supports: dict[str, Any] = {"fixed": np.zeros(shape, dtype=bool)}
    if support == "fixed":
        supports["fixed"][below] = True
    else:
        supports["springs"] = STIFFNESS * np.repeat(_areas(mesh, "z-")[:, None], 3, axis=1)
    observed = np.zeros(shape, dtype=bool)
    observed[face_nodes(mesh, "z+")] = True
    loads = {
        "forces": np.outer(_areas(mesh, "z+"), [0.0, 0.0, -PRESSURE]),
        "observed": observed,
        "displacement": np.where(observed, -0.5, np.nan),
    }
    material = MaterialSpec("neo_hookean", 0.4)
    return Recording(mesh, (Press(**{**supports, **loads, **press}),), material)


def _solve(recording: Recording, element: str) -> np.ndarray:
    mesh, press = recording.mesh, recording.presses[0]
    material = make_material(recording.material.name, recording.material.poisson)
    supports = Supports(press.fixed, press.prescribed, press.springs)
    body = SoftBody(mesh, material, element=element)
    result = body.equilibrate(np.full(mesh.n_tets, 0.1), press.forces, supports)
    assert result.converged, result.reason
    return result.displacement


def test_uniform_pressure_and_springs_are_those_of_the_fine_mesh() -> None:
    fine = refine_recording(_pressed(box_mesh(10.0, 2)), _local)
    expected = _pressed(fine.mesh).presses[0]
    press = fine.presses[0]
    np.testing.assert_allclose(press.forces, expected.forces, atol=1e-14)
    np.testing.assert_allclose(press.springs, expected.springs, atol=1e-14)


@pytest.mark.parametrize("support", ["springs", "fixed"])
def test_the_displacement_at_the_coarse_nodes_converges(support: str) -> None:
    coarse = _pressed(box_mesh(10.0, 2), support)
    n = coarse.mesh.n_points
    solutions = [_solve(coarse, "tet10")]
    for edge_mm in (4.4, 2.2):
        fine = refine_recording(coarse, _uniform(edge_mm))
        solutions.append(_solve(fine, "tet10"))
    size = np.abs(solutions[-1][:n]).max()
    errors = [np.abs(u[:n] - solutions[-1][:n]).max() / size for u in solutions[:-1]]
    assert errors[0] < 0.06
    assert errors[1] < 0.3 * errors[0]


def test_a_locally_refined_mesh_is_close_to_a_fine_one_near_the_load() -> None:
    """A patch of the surface is pressed: only elements there are refined."""
    grid = box_mesh(10.0, 4)
    top = face_nodes(grid, "z+")
    near = top[np.abs(grid.points[top, :2] - 5.0).max(axis=1) < 2.6]
    pressure = np.zeros((grid.n_points, 3))
    pressure[near, 2] = -PRESSURE
    forces = LoadedSurface.of(grid.surface, pressure).mass @ pressure
    coarse = _pressed(grid, "fixed", forces=forces)

    def sizing(points: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - [5.0, 5.0, 10.0], axis=1)
        return np.where(distance < 4.5, 2.2, np.inf)

    fine, local = refine_recording(coarse, _uniform(2.2)), refine_recording(coarse, sizing)
    assert local.mesh.n_tets < 0.5 * fine.mesh.n_tets
    n, everywhere = grid.n_points, _solve(fine, "tet10")
    before = np.abs(_solve(coarse, "tet10")[:n] - everywhere[:n]).max()
    after = np.abs(_solve(local, "tet10")[:n] - everywhere[:n]).max()
    assert after < 0.4 * before


@settings(max_examples=20)
@given(
    center=st.tuples(*[st.floats(-2.0, 12.0)] * 3),
    size=st.floats(1.5, 9.0),
    growth=st.floats(0.0, 2.0),
    seed=st.integers(0, 1000),
)
def test_totals_are_preserved(center: Any, size: float, growth: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = box_mesh(10.0, 2)
    n = mesh.n_points
    forces = rng.normal(size=(n, 3)) * (rng.random((n, 1)) < 0.6)  # interior nodes too
    forces[0] = 1.0
    springs = rng.random((n, 3)) * (rng.random((n, 3)) < 0.7)
    springs[face_nodes(mesh, "z-")] = 0.3
    coarse = _pressed(mesh, forces=forces, springs=springs)
    refinement = refine(mesh, lambda p: size + growth * np.linalg.norm(p - center, axis=1))
    press = prolong_recording(coarse, refinement).presses[0]
    np.testing.assert_allclose(press.forces.sum(axis=0), forces.sum(axis=0), atol=1e-12)
    np.testing.assert_allclose(press.springs.sum(axis=0), springs.sum(axis=0), atol=1e-12)
    assert (press.springs >= 0).all()
    # Nodes away from bisected elements have the same load.
    bisected = np.bincount(refinement.parents, minlength=mesh.n_tets) > 1
    away = np.setdiff1d(np.arange(n), mesh.tets[bisected])
    np.testing.assert_array_equal(press.forces[away], forces[away])
    np.testing.assert_array_equal(press.springs[away], springs[away])
    inside = np.setdiff1d(np.arange(n), mesh.surface.nodes())
    np.testing.assert_array_equal(press.forces[inside], forces[inside])


def test_the_moment_is_preserved() -> None:
    mesh = box_mesh(10.0, 3)
    top = face_nodes(mesh, "z+")
    forces = np.zeros((mesh.n_points, 3))
    forces[top] = np.random.default_rng(0).uniform(0.5, 1.5, (len(top), 3))
    coarse = _pressed(mesh, forces=forces)
    expected = np.cross(mesh.points, forces).sum(axis=0)
    quadratic = Discretisation(mesh, ELEMENTS["tet10"])
    loads = quadratic.consistent_loads(forces)
    np.testing.assert_allclose(np.cross(quadratic.positions, loads).sum(axis=0), expected)
    fine = refine_recording(coarse, _uniform(2.9))
    assert fine.mesh.n_points > mesh.n_points
    moment = np.cross(fine.mesh.points, fine.presses[0].forces).sum(axis=0)
    np.testing.assert_allclose(moment, expected)


def test_the_fine_mesh_is_not_that_of_the_presses() -> None:
    coarse = replace(_pressed(box_mesh(10.0, 2)), provenance={"inverse_crime": True, "seed": 3})
    fine = refine_recording(coarse, _local)
    assert fine.provenance == {"inverse_crime": False, "seed": 3}
    assert coarse.provenance["inverse_crime"]


def test_vertices_without_a_loaded_triangle_keep_their_force() -> None:
    mesh = box_mesh(10.0, 2)
    forces = np.zeros((mesh.n_points, 3))
    nodes = [13, face_nodes(mesh, "z+")[4]]  # in the middle of the box, and of its top
    forces[nodes] = (0.1, 0.2, -0.3)
    assert 13 not in mesh.surface.nodes()
    fine = refine_recording(_pressed(mesh, forces=forces), _local)
    np.testing.assert_array_equal(fine.presses[0].forces[: mesh.n_points], forces)
    assert not fine.presses[0].forces[mesh.n_points :].any()


def test_new_nodes_are_fixed_on_fixed_faces_only() -> None:
    """Elements of one layer span a plate that is clamped below and pushed above."""
    mesh = box_mesh((10.0, 10.0, 2.0), (3, 3, 1))
    shape = (mesh.n_points, 3)
    low, high, left = (face_nodes(mesh, face) for face in ("z-", "z+", "x-"))
    fixed, prescribed = np.zeros(shape, dtype=bool), np.zeros(shape)
    fixed[low], fixed[high, 2], fixed[left, 1] = True, True, True
    prescribed[high, 2] = -0.1 - 0.01 * mesh.points[high, 0]
    coarse = _pressed(mesh, "fixed", fixed=fixed, prescribed=prescribed)
    fine = refine_recording(coarse, _uniform(1.5))
    press, n = fine.presses[0], mesh.n_points
    np.testing.assert_array_equal(press.fixed[:n], fixed)
    x, y, z = fine.mesh.points.T
    between = (x > 0) & (x < 10) & (y > 0) & (y < 10)
    between[:n] = False
    # Edges that join the two sides inside the plate have fixed ends and are free.
    assert (between & (z > 0) & (z < 2)).sum() > 100
    expected = np.stack([z == 0, z == 0, (z == 0) | (z == 2)], axis=1)
    np.testing.assert_array_equal(press.fixed[between], expected[between])
    on_left = (x == 0) & (y > 0) & (y < 10)
    assert press.fixed[on_left, 1].all()
    assert not press.fixed[on_left & (z > 0), 0].any()
    moved = np.where(z == 2, -0.1 - 0.01 * x, 0.0)
    np.testing.assert_allclose(press.prescribed[between, 2], moved[between], atol=1e-15)
    assert not press.prescribed[:, :2].any()


def _complete() -> Recording:
    """A recording with all that a recording may have."""
    mesh = box_mesh(10.0, 2)
    rng = np.random.default_rng(0)
    base = _pressed(mesh).presses[0]
    further = {
        "noise_mm": 0.02,
        "weights": np.where(base.observed, 0.7, 0.2),
        "step": 2,
        "direction": np.array([0.0, 0.0, -1.0]),
        "name": "top",
    }
    unloaded = rng.normal(size=(3, mesh.n_points, 3))
    unloaded[:, 5] = np.nan
    pressed = _pressed(mesh, **further)
    return Recording(
        mesh,
        pressed.presses * 2,
        MaterialSpec("neo_hookean", 0.45, {"lame_factor": 0.5}),
        truth=rng.uniform(0.1, 1.0, mesh.n_tets),
        reference=rng.uniform(0.1, 1.0, mesh.n_tets),
        provenance={"source": "test"},
        density=1e-9,
        gravity=np.array([0.0, 0.0, -9806.65]),
        unloaded=unloaded,
    )


def test_the_data_and_all_else_are_kept(tmp_path: Path) -> None:
    coarse = _complete()
    n = coarse.mesh.n_points
    refinement = refine(coarse.mesh, _local)
    fine = prolong_recording(coarse, refinement)
    assert fine.mesh is refinement.mesh
    for name in ("material", "provenance", "density"):
        assert getattr(fine, name) == getattr(coarse, name)
    np.testing.assert_array_equal(fine.gravity, coarse.gravity)
    assert coarse.truth is not None
    assert coarse.reference is not None
    np.testing.assert_array_equal(fine.truth, coarse.truth[refinement.parents])
    np.testing.assert_array_equal(fine.reference, coarse.reference[refinement.parents])
    assert fine.unloaded is not None
    np.testing.assert_array_equal(fine.unloaded[:, :n], coarse.unloaded)
    assert np.isnan(fine.unloaded[:, n:]).all()
    assert len(fine.presses) == 2
    for press, before in zip(fine.presses, coarse.presses, strict=True):
        for name in ("noise_mm", "step", "name"):
            assert getattr(press, name) == getattr(before, name)
        np.testing.assert_array_equal(press.direction, before.direction)
        np.testing.assert_array_equal(press.observed[:n], before.observed)
        np.testing.assert_array_equal(press.displacement[:n], before.displacement)
        assert press.weights is not None
        np.testing.assert_array_equal(press.weights[:n], before.weights)
        assert not press.weights[n:].any()
        assert not press.observed[n:].any()
        assert np.isnan(press.displacement[n:]).all()
    fine.save(tmp_path / "fine.h5")
    loaded = Recording.load(tmp_path / "fine.h5")
    assert loaded.mesh.content_hash() == fine.mesh.content_hash()


def test_infinite_lengths_change_nothing() -> None:
    coarse = _complete()
    same = refine_recording(coarse, _uniform(np.inf))
    for field in fields_of(Recording):
        assert getattr(same, field.name) is getattr(coarse, field.name)


def test_refuses_a_refinement_of_another_mesh() -> None:
    refinement = refine(box_mesh(10.0, 3), _local)
    with pytest.raises(RecordingError, match=r"of another mesh \(64 nodes, 162 elements\)"):
        prolong_recording(_pressed(box_mesh(10.0, 2)), refinement)
