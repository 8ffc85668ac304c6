"""What a sound mesh answers, whatever the order of its nodes and elements."""

import copy
import itertools
import pickle
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.mesh import TetMesh, box_mesh, compact
from tactorch.mesh.topology import LOCAL_EDGES

SEEDS = st.integers(0, 2**32 - 1)
quick = settings(deadline=None, max_examples=25)


def shuffled(mesh: TetMesh, seed: int, swap: bool = False) -> tuple[TetMesh, np.ndarray]:
    """Renumber nodes and elements at random; with `swap`, turn random elements inside out."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(mesh.n_points)
    renumber = np.argsort(order)
    tets = renumber[mesh.tets][rng.permutation(mesh.n_tets)]
    # Even permutations of the four vertices keep the orientation.
    tets = tets[:, rng.permutation([(0, 1, 2, 3), (1, 2, 0, 3), (3, 1, 0, 2)])[0]]
    if swap:
        flip = rng.random(mesh.n_tets) < 0.5
        tets[flip] = tets[flip][:, ::-1][:, [1, 0, 2, 3]]
        tets[~flip] = tets[~flip][:, [1, 0, 2, 3]]
    return TetMesh.create(mesh.points[order], tets), order


def triangles_by_position(mesh: TetMesh) -> set[frozenset[tuple[float, ...]]]:
    corners = mesh.points[mesh.surface.triangles].tolist()
    return {frozenset(map(tuple, triangle)) for triangle in corners}


@quick
@given(seed=SEEDS, swap=st.booleans())
def test_numbering_changes_nothing(mesh: TetMesh, seed: int, swap: bool) -> None:
    other, order = shuffled(mesh, seed, swap)
    np.testing.assert_allclose(np.sort(other.volumes), np.sort(mesh.volumes), rtol=1e-12)
    assert triangles_by_position(other) == triangles_by_position(mesh)
    assert len(other.adjacency.pairs) == len(mesh.adjacency.pairs)
    np.testing.assert_allclose(
        np.sort(other.adjacency.distances), np.sort(mesh.adjacency.distances), rtol=1e-12
    )
    np.testing.assert_allclose(other.vertex_areas, mesh.vertex_areas[order], atol=1e-14)
    assert len(other.edges) == len(mesh.edges)


@quick
@given(seed=SEEDS, stretch=st.tuples(*[st.floats(0.2, 5.0)] * 3), shift=st.floats(-100, 100))
def test_divergence_theorem(
    mesh: TetMesh, seed: int, stretch: tuple[float, float, float], shift: float
) -> None:
    other, _ = shuffled(mesh, seed, swap=True)
    other = TetMesh(other.points * np.array(stretch) + shift, other.tets)
    vectors = other.surface.normals * other.surface.areas[:, None]
    middles = other.points[other.surface.triangles].mean(axis=1)
    volume = 6.0 * np.prod(stretch)
    np.testing.assert_allclose(vectors.sum(axis=0), 0.0, atol=1e-11 * other.surface.areas.sum())
    np.testing.assert_allclose((middles * vectors).sum() / 3, volume, rtol=1e-9)
    np.testing.assert_allclose(other.volumes.sum(), volume, rtol=1e-9)
    assert other.volumes.min() > 0


def test_repair_swaps_two_vertices_of_inverted_elements_only(mesh: TetMesh) -> None:
    tets = np.array(mesh.tets)
    tets[5] = tets[5, [0, 1, 3, 2]]
    repaired = TetMesh.create(mesh.points, tets)
    np.testing.assert_array_equal(repaired.tets, mesh.tets)
    np.testing.assert_array_equal(repaired.points, mesh.points)


def test_surface_against_brute_force(mesh: TetMesh) -> None:
    seen: dict[tuple[int, ...], list[int]] = {}
    for t, tet in enumerate(mesh.tets.tolist()):
        for face in itertools.combinations(sorted(tet), 3):
            seen.setdefault(face, []).append(t)
    boundary = {face: owners[0] for face, owners in seen.items() if len(owners) == 1}
    found = map(tuple, np.sort(mesh.surface.triangles, axis=1).tolist())
    assert dict(zip(found, mesh.surface.owners.tolist(), strict=True)) == boundary
    assert (np.diff(mesh.surface.owners) >= 0).all()
    shared = sorted(tuple(owners) for owners in seen.values() if len(owners) == 2)
    assert list(map(tuple, mesh.adjacency.pairs.tolist())) == shared


def test_normals_point_away_from_their_owner(mesh: TetMesh) -> None:
    surface = mesh.surface
    away = mesh.points[surface.triangles].mean(axis=1) - mesh.centroids[surface.owners]
    assert (np.einsum("ki,ki->k", away, surface.normals) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    a, b, c = (mesh.points[surface.triangles[:, i]] for i in range(3))
    np.testing.assert_allclose(
        np.cross(b - a, c - a) / 2, surface.normals * surface.areas[:, None], atol=1e-14
    )


def test_adjacency_areas_and_distances(mesh: TetMesh) -> None:
    adjacency = mesh.adjacency
    for (i, j), area, distance in zip(
        adjacency.pairs[::7], adjacency.areas[::7], adjacency.distances[::7], strict=True
    ):
        a, b, c = mesh.points[np.intersect1d(mesh.tets[i], mesh.tets[j])]
        assert i < j
        assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a)) / 2)
        apart = mesh.points[mesh.tets[i]].mean(axis=0) - mesh.points[mesh.tets[j]].mean(axis=0)
        assert distance == pytest.approx(np.linalg.norm(apart))


def test_every_face_is_counted_once(mesh: TetMesh) -> None:
    touching = np.bincount(mesh.adjacency.pairs.ravel(), minlength=mesh.n_tets)
    touching += np.bincount(mesh.surface.owners, minlength=mesh.n_tets)
    assert (touching == 4).all()


def test_edges(mesh: TetMesh) -> None:
    pairs = {
        tuple(sorted(pair)) for tet in mesh.tets.tolist() for pair in itertools.combinations(tet, 2)
    }
    assert list(map(tuple, mesh.edges.tolist())) == sorted(pairs)
    ends = np.sort(mesh.tets[:, LOCAL_EDGES], axis=-1)
    np.testing.assert_array_equal(mesh.edges[mesh.tet_edges], ends)


def test_vertex_areas(mesh: TetMesh) -> None:
    assert mesh.vertex_areas.sum() == pytest.approx(22.0)
    node = mesh.surface.triangles[3, 1]
    around = (mesh.surface.triangles == node).any(axis=1)
    assert mesh.vertex_areas[node] == pytest.approx(mesh.surface.areas[around].sum() / 3)
    inner = np.setdiff1d(np.arange(mesh.n_points), mesh.surface.nodes())
    assert inner.size == 12
    assert not mesh.vertex_areas[inner].any()


def test_size() -> None:
    mesh = box_mesh((3.0, 4.0, 12.0), 2, origin_mm=(1.0, 2.0, 3.0))
    assert mesh.diagonal == pytest.approx(13.0)
    np.testing.assert_allclose(mesh.bounds, [(1, 2, 3), (4, 6, 15)])
    np.testing.assert_allclose(
        (mesh.centroids * mesh.volumes[:, None]).sum(axis=0) / mesh.volumes.sum(), (2.5, 4, 9)
    )
    assert repr(mesh) == "TetMesh(27 nodes, 48 tets, 13 mm across)"


def test_arrays_are_read_only_copies(mesh: TetMesh) -> None:
    points, tets = np.array(mesh.points), np.array(mesh.tets)
    own = TetMesh(points, tets)
    points[:] = 0.0
    tets[:] = 0
    np.testing.assert_array_equal(own.points, mesh.points)
    np.testing.assert_array_equal(own.tets, mesh.tets)
    arrays = [own.points, own.tets, own.volumes, own.centroids, own.bounds, own.vertex_areas]
    arrays += [own.edges, own.tet_edges]
    arrays += [*vars(own.surface).values(), *vars(own.adjacency).values()]
    assert len(arrays) == 15
    assert not any(array.flags.writeable for array in arrays)
    assert own.points.dtype == np.float64
    assert own.tets.dtype == np.int64


def test_accepts_lists_and_small_integers() -> None:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    mesh = TetMesh.create(corners, np.array([[0, 1, 2, 3]], np.uint8))
    assert mesh.volumes.tolist() == [pytest.approx(1 / 6)]
    assert len(mesh.surface.triangles) == 4
    assert mesh.adjacency.pairs.shape == (0, 2)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_are_equal_and_read_only(mesh: TetMesh, copied) -> None:
    _ = mesh.surface
    other = copied(mesh)
    assert other.content_hash() == mesh.content_hash()
    assert not other.points.flags.writeable


def test_content_hash_tells_meshes_apart(mesh: TetMesh) -> None:
    moved = np.array(mesh.points)
    moved[0, 0] += 1e-12
    renumbered = np.array(mesh.tets)[::-1]
    hashes = {
        mesh.content_hash(),
        TetMesh(moved, mesh.tets).content_hash(),
        TetMesh(mesh.points, renumbered).content_hash(),
    }
    assert len(hashes) == 3
    assert TetMesh(np.array(mesh.points), mesh.tets).content_hash() in hashes
    negative_zero = np.where(mesh.points == 0, -0.0, mesh.points)
    assert TetMesh(negative_zero, mesh.tets).content_hash() == mesh.content_hash()


def test_content_hash_is_the_same_everywhere() -> None:
    tet = TetMesh.create(np.concatenate((np.zeros((1, 3)), np.eye(3))), [[0, 1, 2, 3]])
    assert tet.content_hash()[:16] == "48d17d42298990c6"


@quick
@given(seed=SEEDS, extra=st.integers(1, 10))
def test_compact_drops_exactly_the_unused(mesh: TetMesh, seed: int, extra: int) -> None:
    rng = np.random.default_rng(seed)
    total = mesh.n_points + extra
    used = np.sort(rng.permutation(total)[: mesh.n_points])
    points = rng.random((total, 3))
    points[used] = mesh.points
    nodes, tets, kept = compact(points, used[mesh.tets])
    np.testing.assert_array_equal(nodes, mesh.points)
    np.testing.assert_array_equal(tets, mesh.tets)
    np.testing.assert_array_equal(kept, used)


def test_a_large_mesh_is_quick() -> None:
    start = time.perf_counter()
    mesh = box_mesh(10.0, 22)
    _ = mesh.surface, mesh.adjacency, mesh.edges, mesh.vertex_areas
    assert mesh.n_tets == 63888
    assert time.perf_counter() - start < 3.0  # 0.2 s where nothing else runs
