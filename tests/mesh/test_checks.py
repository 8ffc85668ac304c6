"""Every unsound mesh is refused, by name."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import MeshError
from tactorch.mesh import TetMesh, box_mesh
from tactorch.mesh.topology import row_keys

quick = settings(deadline=None, max_examples=25)
TET = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)


@quick
@given(data=st.data(), value=st.sampled_from([np.nan, np.inf, -np.inf]))
def test_non_finite_points(mesh: TetMesh, data: st.DataObject, value: float) -> None:
    points = np.array(mesh.points)
    row = data.draw(st.integers(0, mesh.n_points - 1))
    points[row, data.draw(st.integers(0, 2))] = value
    with pytest.raises(MeshError, match=rf"NaN or infinite .* 1 of 80 rows \({row}\)"):
        TetMesh.create(points, mesh.tets)


@quick
@given(row=st.integers(0, 215), index=st.sampled_from([-1, 80, 2**40]))
def test_index_out_of_range(mesh: TetMesh, row: int, index: int) -> None:
    tets = np.array(mesh.tets)
    tets[row, 2] = index
    with pytest.raises(MeshError, match=rf"outside 0\.\.79 in 1 of 216 rows \({row}\)"):
        TetMesh.create(mesh.points, tets)


@quick
@given(row=st.integers(0, 215), columns=st.permutations(range(4)))
def test_repeated_vertex(mesh: TetMesh, row: int, columns: list[int]) -> None:
    tets = np.array(mesh.tets)
    tets[row, columns[0]] = tets[row, columns[1]]
    with pytest.raises(MeshError, match=rf"repeat a vertex .* \({row}\)"):
        TetMesh.create(mesh.points, tets)


@quick
@given(rows=st.sets(st.integers(0, 215), min_size=1, max_size=5))
def test_inverted_without_repair(mesh: TetMesh, rows: set[int]) -> None:
    tets = np.array(mesh.tets)
    chosen = sorted(rows)
    tets[chosen] = tets[chosen][:, [1, 0, 2, 3]]
    listed = ", ".join(map(str, chosen))
    with pytest.raises(MeshError, match=rf"inverted .* {len(rows)} of 216 elements \({listed}\)"):
        TetMesh.create(mesh.points, tets, repair=False)
    with pytest.raises(MeshError, match=r"TetMesh\.create"):
        TetMesh(mesh.points, tets)


@quick
@given(row=st.integers(0, 215), vertices=st.permutations(range(4)))
def test_duplicate_elements(mesh: TetMesh, row: int, vertices: list[int]) -> None:
    tets = np.vstack((mesh.tets, mesh.tets[row, vertices]))
    with pytest.raises(MeshError, match=r"repeats elements: 1 of 217 elements \(216\)"):
        TetMesh.create(mesh.points, tets)


@pytest.mark.parametrize("height", [0.0, 1e-12, -1e-11])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_degenerate_at_any_scale(height: float, scale: float) -> None:
    points = TET.copy()
    points[3] = (0.3, 0.3, height)
    with pytest.raises(MeshError, match="degenerate"):
        TetMesh.create(points * scale, [[0, 1, 2, 3]])


def test_small_or_thin_but_sound_elements_pass() -> None:
    thin = TET * (1.0, 1.0, 1e-6)
    assert TetMesh.create(thin, [[0, 1, 2, 3]]).n_tets == 1
    # A tower whose floors halve: the last elements are small against the box, but well shaped.
    tower = box_mesh(1.0, (1, 1, 16))
    shrink = 0.5 ** np.round(16 * tower.points[:, 2:])
    points = np.hstack((tower.points[:, :2], np.ones((tower.n_points, 1)))) * shrink
    mesh = TetMesh.create(points, tower.tets)
    assert mesh.volumes.min() < 1e-14 * mesh.diagonal**3


def test_rounding_far_from_the_origin_counts_as_degenerate() -> None:
    points = TET * (1.0, 1.0, 1e-7)
    assert TetMesh.create(points, [[0, 1, 2, 3]]).n_tets == 1
    with pytest.raises(MeshError, match="degenerate"):
        TetMesh.create(points + 1e9, [[0, 1, 2, 3]])


def test_unreferenced_nodes(mesh: TetMesh) -> None:
    points = np.vstack((mesh.points, [(9, 9, 9), (8, 8, 8)]))
    with pytest.raises(MeshError, match=r"2 of 82 nodes \(80, 81\).*compact"):
        TetMesh.create(points, mesh.tets)


@pytest.mark.parametrize("shared", [0, 1, 2])
def test_parts_that_share_no_face(shared: int) -> None:
    """Parts joined at a node or an edge only would hinge freely."""
    first = [0, 1, 2, 3]
    second = [3, 2, 5, 6][: min(shared, 2)]
    second += list(range(4, 8 - len(second)))
    points = np.vstack((TET, TET + np.array((3.0, 3.0, 3.3))))[: max(second) + 1]
    with pytest.raises(MeshError, match=r"2 disconnected parts \(of 1, 1 elements\)"):
        TetMesh.create(points, [first, second])


def test_face_shared_by_three() -> None:
    points = np.vstack((TET, (1, 1, 1), (2, 2, 2.5)))
    with pytest.raises(MeshError, match="shared by three or more"):
        TetMesh.create(points, [[0, 1, 2, 3], [1, 2, 3, 4], [1, 2, 3, 5]])


def test_tangled_mesh_is_not_made_sound_by_swapping() -> None:
    """A node pushed through the opposite face leaves its element on the neighbour's side."""
    points = np.vstack((TET, (1, 1, 1)))
    tets = [[0, 1, 2, 3], [1, 2, 3, 4]]
    assert TetMesh.create(points, tets).n_tets == 2
    points[0] = (0.5, 0.5, 0.5)
    with pytest.raises(MeshError, match=r"folds over itself: 2 of 2 elements \(0, 1\)"):
        TetMesh.create(points, tets)


@pytest.mark.parametrize(
    ("points", "tets", "message"),
    [
        (TET[:, :2], [[0, 1, 2, 3]], r"points must have shape \(k, 3\), not \(4, 2\)"),
        (TET.ravel(), [[0, 1, 2, 3]], r"points must have shape \(k, 3\), not \(12,\)"),
        (TET, [[0, 1, 2]], r"tets must have shape \(k, 4\), not \(1, 3\)"),
        (TET, [[0.0, 1.0, 2.0, 3.0]], "tets must be integer indices, not float64"),
        (TET.astype(complex), [[0, 1, 2, 3]], "points must be real numbers, not complex128"),
        (TET.astype(str), [[0, 1, 2, 3]], "points must be real numbers, not <U"),
        (TET, np.empty((0, 4), int), "tets are empty"),
        (np.empty((0, 3)), [[0, 1, 2, 3]], "points are empty"),
        (TET, [[0, 1, 2, 3], [0, 1]], r"tets must form an array of shape \(k, 4\)"),
    ],
)
def test_wrong_arrays(points: object, tets: object, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        TetMesh.create(points, tets)  # type: ignore[arg-type]


@quick
@given(
    rows=st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=40),
    n_points=st.sampled_from([6, 3_000_000]),
)
def test_row_keys_order_rows_with_and_without_overflow(
    rows: list[tuple[int, int, int]], n_points: int
) -> None:
    keys = row_keys(np.array(rows), n_points)
    for row, key in zip(rows, keys, strict=True):
        for other, other_key in zip(rows, keys, strict=True):
            assert (row < other) == (key < other_key)


def test_long_listings_are_cut(mesh: TetMesh) -> None:
    with pytest.raises(MeshError, match=r"216 of 216 elements \(0, 1, 2, 3, 4, \.\.\.\)"):
        TetMesh(mesh.points, mesh.tets[:, [1, 0, 2, 3]])


def test_generated_meshes_are_not_repaired() -> None:
    box = box_mesh(1.0, 2, tets_per_cell=5)
    assert TetMesh.create(box.points, box.tets, repair=False).n_tets == 40
