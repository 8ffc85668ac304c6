import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.sampling.candidates import InferredCandidates, Patch, candidate_patches


@pytest.fixture(scope="module")
def dome() -> TetMesh:
    """A cube whose upper part is rounded, standing on z = 0."""
    cube = box_mesh(10.0, 6, tets_per_cell=5)
    points = cube.points - np.array([5.0, 5.0, 0.0])
    points[:, 2] *= 1.0 - (points[:, 0] ** 2 + points[:, 1] ** 2) / 100.0
    return TetMesh.create(points, cube.tets)


def test_force_and_moment_are_those_of_the_sensor(dome: TetMesh) -> None:
    patch = Patch(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, -1.0]), 2.5)
    forces = patch.forces(dome)
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, -np.pi * 2.5**2], atol=1e-9)
    moment = np.cross(dome.points, forces).sum(axis=0)
    np.testing.assert_allclose(moment[:2], 0.0, atol=0.02 * np.pi * 2.5**3)
    assert (dome.points[forces.any(axis=1), 2] > 5.0).all()


def test_candidates_fit_and_push_inward(dome: TetMesh) -> None:
    held = dome.points[:, 2] < 1e-9
    found = candidate_patches(dome, held, 1.5, 12)
    assert len(found) == 12
    middle = np.array([0.0, 0.0, 4.0])
    for patch in found:
        assert np.linalg.norm(patch.inward) == pytest.approx(1.0)
        assert patch.inward @ (middle - patch.center) > 0
        assert not patch.forces(dome)[held].any()


def test_each_candidate_is_the_farthest_from_those_before(dome: TetMesh) -> None:
    centers = np.array(
        [p.center for p in candidate_patches(dome, dome.points[:, 2] < 1e-9, 1.5, 10)]
    )
    gaps = [np.linalg.norm(centers[:i] - centers[i], axis=1).min() for i in range(1, 10)]
    assert (np.diff(gaps) <= 1e-12).all()
    assert gaps[-1] > 1.0


def test_what_cannot_be_is_refused(dome: TetMesh) -> None:
    held = dome.points[:, 2] < 1e-9
    with pytest.raises(ConfigError, match="no patch of this radius avoids the fixed nodes"):
        candidate_patches(dome, held | True, 1.5, 3)
    with pytest.raises(ConfigError, match="count is 0"):
        candidate_patches(dome, held, 1.5, 0)
    with pytest.raises(ConfigError, match="held marks no fixed node"):
        candidate_patches(dome, held & False, 1.5, 3)
    with pytest.raises(ConfigError, match="no surface within"):
        Patch(np.full(3, 90.0), np.array([0.0, 0.0, -1.0]), 1.0).forces(dome)


def test_the_load_of_a_press_is_unknown_where_motions_are_prescribed(dome: TetMesh) -> None:
    held = np.repeat(dome.points[:, 2:] < 1e-9, 3, axis=1)
    moved = np.linalg.norm(dome.points - [0.0, 0.0, 10.0], axis=1) < 1e-9
    prescribed = np.where(moved[:, None], [0.0, 0.0, -0.1], 0.0)
    observed = np.repeat(dome.points[:, 2:] > 8.0, 3, axis=1) & ~moved[:, None]
    press = Press(
        np.zeros_like(prescribed), observed, 0.01 * observed, prescribed=prescribed,
        fixed=held | moved[:, None], noise_mm=1e-3,
    )  # fmt: skip
    recording = Recording(dome, (press,), MaterialSpec("neo_hookean", 0.45), check_units=False)
    candidates = InferredCandidates(1.5, 4)(recording)
    with pytest.raises(ConfigError, match=r"no net force.*rule=largest_uncertainty"):
        candidates.plan(candidates.patches[0])
