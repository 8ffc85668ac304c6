import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import MeshError
from tactorch.mesh import Box, tetrahedralize
from tactorch.mesh.checks import closed_surface, enclosed_volume

quick = settings(deadline=None, max_examples=25)
VERTICES, TRIANGLES = Box(size_mm=10.0).surface()


@quick
@given(seed=st.integers(0, 2**32 - 1), inward=st.booleans())
def test_any_numbering_is_turned_outward(seed: int, inward: bool) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(8)
    faces = np.argsort(order)[TRIANGLES][rng.permutation(12)]
    faces = np.roll(faces, rng.integers(3), axis=1)
    points, outward = closed_surface(VERTICES[order], faces[:, ::-1] if inward else faces)
    assert enclosed_volume(points, outward) == pytest.approx(1000.0)


@quick
@given(missing=st.sets(st.integers(0, 11), min_size=1, max_size=6))
def test_open(missing: set[int]) -> None:
    kept = np.delete(TRIANGLES, list(missing), axis=0)
    with pytest.raises(MeshError, match=r"surface is open: \d+ of its"):
        tetrahedralize(VERTICES, kept)


@quick
@given(turned=st.integers(0, 11))
def test_inconsistent(turned: int) -> None:
    faces = TRIANGLES.copy()
    faces[turned] = faces[turned, ::-1]
    with pytest.raises(MeshError, match="not oriented consistently"):
        tetrahedralize(VERTICES, faces)


def test_not_manifold() -> None:
    with pytest.raises(MeshError, match=r"not a manifold: 3 of its 18 edges"):
        tetrahedralize(VERTICES, np.vstack((TRIANGLES, TRIANGLES[:1])))


def test_triangles_with_vertices_of_their_own() -> None:
    with pytest.raises(MeshError, match=r"surface is open: 36 of its 36 edges.*merge equal"):
        tetrahedralize(VERTICES[TRIANGLES].reshape(-1, 3), np.arange(36).reshape(12, 3))


@pytest.mark.parametrize(
    ("vertices", "triangles", "message"),
    [
        (np.vstack((VERTICES[:7], (0, np.nan, 0))), TRIANGLES, "vertices hold NaN"),
        (VERTICES[:, :2], TRIANGLES, r"vertices must have shape \(k, 3\), not \(8, 2\)"),
        (VERTICES, TRIANGLES.reshape(-1, 4), r"triangles must have shape \(k, 3\), not \(9, 4\)"),
        (VERTICES, TRIANGLES + 1, r"triangles index points outside 0\.\.7"),
        (VERTICES, TRIANGLES * 1.0, "triangles must be integer"),
        (VERTICES, np.vstack((TRIANGLES, (0, 0, 1))), r"triangles repeat a vertex .*\(12\)"),
        (VERTICES * (1, 1, 0), TRIANGLES, "encloses no volume"),
        (VERTICES, np.empty((0, 3), int), "triangles are empty"),
    ],
)
def test_wrong_arrays(vertices: np.ndarray, triangles: np.ndarray, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        tetrahedralize(vertices, triangles)
