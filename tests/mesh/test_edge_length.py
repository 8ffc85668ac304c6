"""Median edge lengths of meshes of surfaces, and what surfaces are refused."""

import logging

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactorch.errors import MeshError
from tactorch.mesh import Box, Cylinder, Ellipsoid, Sphere, TetMesh, box_mesh, tetrahedralize
from tactorch.mesh.closest import closest_points
from tactorch.mesh.edge_length import fit_edge_length, mean_ratios
from tactorch.mesh.intersections import crossing_triangles
from tactorch.mesh.snap import onto_surface
from tactorch.mesh.solids import solid_surface
from tactorch.mesh.surfaces import marching_cubes

ROTATION = Rotation.from_rotvec((0.3, 0.5, 0.2)).as_matrix()
CUBE = Box((0.0, 0.0, 0.0), 20.0).surface()


def bumpy() -> tuple[np.ndarray, np.ndarray]:
    """Ball of 20 mm with bumps of 1.2 mm, in tens of thousands of triangles."""

    def distance(points: np.ndarray) -> np.ndarray:
        radius = np.linalg.norm(points, axis=1)
        height = points[:, 2] / np.maximum(radius, 1e-9)
        turn = 5.0 * np.arctan2(points[:, 1], points[:, 0])
        return radius - 20.0 - 1.2 * np.sin(turn) * np.sqrt(1.0 - height**2) * np.cos(8 * height)

    return marching_cubes(distance, np.array([[-23.0] * 3, [23.0] * 3]), "bumpy")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "length_mm"),
    [
        (CUBE, 6.0),
        (CUBE, 3.0),
        (Sphere((0, 0, 0), 12.0).surface(), 4.0),
        (Cylinder((0, 0, 0), 10.0, 15.0).surface(), 4.0),
        (Cylinder((0, 0, 0), 4.0, 80.0, (1, 0, 0)).surface(24), 3.0),
        (Ellipsoid((0, 0, 0), (30.0, 15.0, 8.0)).surface(), 5.0),
        (bumpy(), 6.0),
    ],
    ids=["cube", "fine cube", "ball", "cylinder", "rod", "ellipsoid", "bumpy"],
)
def test_the_edge_length_is_kept(surface: tuple, length_mm: float) -> None:
    mesh = tetrahedralize(*surface, edge_length_mm=length_mm, cache=False)
    assert np.median(mesh.edge_lengths) == pytest.approx(length_mm, rel=0.2)
    nodes = mesh.points[mesh.surface.nodes()]
    assert closest_points(*surface, nodes).distances.max() < 0.15 * length_mm
    assert mean_ratios(mesh).min() > 0.05


class Meshes:
    """Stands for fTetWild: edges are `share` of the length asked, at most those of the envelope."""

    def __init__(self, share: float, widest: float = np.inf) -> None:
        self.share, self.widest = share, widest
        self.calls: list[tuple[float, float]] = []

    def __call__(self, length_mm: float, envelope_mm: float) -> TetMesh:
        self.calls.append((length_mm, envelope_mm))
        edge = min(self.share * length_mm, self.widest * envelope_mm)
        divisions = max(round(20.0 * 1.21 / edge), 1)
        return box_mesh(20.0, divisions, center_mm=(0, 0, 0), tets_per_cell=5)


@pytest.mark.parametrize("share", [0.4, 0.7, 1.0, 1.6])
def test_the_search_finds_the_length(share: float) -> None:
    meshes, shown = Meshes(share), []
    mesh = fit_edge_length(meshes, *CUBE, 3.0, lambda *progress: shown.append(progress))
    expected = 3.0 if share > 0.6 else 3.0 * 1.5 * share
    assert np.median(mesh.edge_lengths) == pytest.approx(expected, rel=0.2)
    assert len(meshes.calls) <= 6
    assert [number for number, *_ in shown] == [*range(1, len(shown) + 1)]


@pytest.mark.slow
def test_small_features_widen_the_envelope_up_to_a_limit_and_are_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    meshes = Meshes(1.4, widest=8.0)  # 8 x 0.06 < 1 edge length
    fit_edge_length(meshes, *CUBE, 3.0)
    assert "smaller elements" not in caplog.text
    assert max(envelope for _, envelope in meshes.calls) > 0.1 * 3.0
    with caplog.at_level(logging.WARNING):
        fit_edge_length(Meshes(1.4, widest=3.0), *CUBE, 3.0)
    assert "not 3 mm: curvature and small features" in caplog.text


def test_lost_parts_narrow_the_envelope_and_are_refused() -> None:
    def half(length_mm: float, envelope_mm: float) -> TetMesh:
        divisions = round(24.0 / length_mm)
        lost = 10.0 if envelope_mm > 0.1 or length_mm > 5.0 else 0.0
        return box_mesh(
            (20.0, 20.0, 20.0 - lost), divisions, origin_mm=(-10, -10, -10), tets_per_cell=5
        )

    assert fit_edge_length(half, *CUBE, 3.0).volumes.sum() == pytest.approx(8000.0)
    with pytest.raises(MeshError, match=r"50% of the volume.*edge length of 9 mm"):
        fit_edge_length(half, *CUBE, 9.0)


def test_a_mesher_that_fails_always_is_reported() -> None:
    def fails(length_mm: float, envelope_mm: float) -> TetMesh:
        raise MeshError("no elements")

    with pytest.raises(MeshError, match="no elements"):
        fit_edge_length(fails, *CUBE, 3.0)


def test_nodes_are_moved_onto_faces_edges_and_corners() -> None:
    exact = box_mesh(20.0, 5, center_mm=(0, 0, 0))
    rng = np.random.default_rng(0)
    nodes, points = exact.surface.nodes(), exact.points.copy()
    points[nodes] += rng.uniform(-0.3, 0.3, (len(nodes), 3))
    mesh = onto_surface(TetMesh.create(points, exact.tets), *CUBE, 1.0)
    assert mesh.volumes.sum() == pytest.approx(8000.0, rel=1e-9)
    on_planes = np.isclose(np.abs(mesh.points[nodes]), 10.0, atol=1e-9)
    assert (on_planes == np.isclose(np.abs(exact.points[nodes]), 10.0)).all()


def test_only_nodes_that_would_spoil_elements_stay() -> None:
    """The layer below the top is 1 mm thick, and 0.35 mm below one node."""
    layered = box_mesh(20.0, (4, 4, 20), center_mm=(0, 0, 0))
    points = layered.points.copy()
    inner = np.linalg.norm(points - (0.0, 0.0, 9.0), axis=1).argmin()
    points[inner, 2] = 9.65
    lower = np.where(CUBE[0][:, 2:] > 0, CUBE[0] - (0.0, 0.0, 0.4), CUBE[0])
    moved = onto_surface(TetMesh.create(points, layered.tets), lower, CUBE[1], 0.9)
    assert (moved.volumes > 0.0).all()
    top = moved.points[layered.points[:, 2] > 9.9]
    above = np.linalg.norm(top[:, :2], axis=1) < 0.1
    assert top[above, 2] == pytest.approx(10.0)
    at_rim = np.abs(top[:, :2]).max(axis=1) > 9.9
    assert top[at_rim, 2] == pytest.approx(9.6)
    far = onto_surface(layered, lower, CUBE[1], 0.3)
    assert far.points[:, 2].max() == pytest.approx(10.0)


def test_quality_of_known_elements() -> None:
    regular = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
    mesh = TetMesh.create(regular, [(0, 1, 2, 3)])
    assert mean_ratios(mesh) == pytest.approx([1.0])
    assert mean_ratios(TetMesh.create(regular * (1, 1, 1e-3), [(0, 1, 2, 3)]))[0] < 0.02


def moved(by: tuple[float, float, float], turn: bool = False) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = Box((0.0, 0.0, 0.0), 20.0).surface()
    return vertices + np.array(by), triangles[:, ::-1] if turn else triangles


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(points) for points, _ in parts)])
    faces = [f + s for (_, f), s in zip(parts, starts, strict=False)]
    return np.concatenate([p for p, _ in parts]), np.concatenate(faces)


def flipped(surface: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    faces = surface[1].copy()
    faces[3] = faces[3, ::-1]
    return surface[0], faces


SMALL = (0.3 * moved((0, 0, 0))[0], CUBE[1])
WRONG = {
    "hole": ((CUBE[0], CUBE[1][1:]), "open: 3 of its 18 edges"),
    "two holes": ((CUBE[0], CUBE[1][[0, 1, 2, 4, 5, 6, 8, 9, 10, 11]]), "open: 6 of its 18"),
    "one triangle turned": (flipped(CUBE), "not oriented consistently"),
    "two bodies": (joined(CUBE, moved((30, 0, 0))), "1 parts beside the largest.*largest=true"),
    "crossing bodies": (joined(CUBE, moved((9, 8, 7))), "beside the largest"),
    "crossing cavity": (joined(CUBE, (SMALL[0] + (8, 0, 0), SMALL[1][:, ::-1])), "beside"),
    "body within": (joined(CUBE, SMALL), "beside the largest"),
    "doubled triangle": ((CUBE[0], np.vstack((CUBE[1], CUBE[1][:1]))), "not a manifold"),
    "NaN": ((np.where(CUBE[0] == CUBE[0][3, 2], np.nan, CUBE[0]), CUBE[1]), "NaN or infinite"),
    "flat": ((CUBE[0] * (1, 1, 0), CUBE[1]), "encloses no volume"),
    "points only": ((CUBE[0] * 0, CUBE[1]), "encloses no volume"),
    "index beyond": ((CUBE[0][:7], CUBE[1]), "index points outside"),
    "empty": ((CUBE[0][:0], CUBE[1][:0]), "empty"),
}


@pytest.mark.parametrize("given", WRONG)
def test_surfaces_that_bound_no_body_are_refused(given: str) -> None:
    surface, words = WRONG[given]
    with pytest.raises(MeshError, match=words):
        solid_surface(*surface)


def test_a_body_that_crosses_itself_is_refused() -> None:
    vertices, triangles = Sphere((0, 0, 0), 5.0).surface(24)
    folded = vertices.copy()
    folded[vertices[:, 2] > 4.9, 2] = -9.0
    with pytest.raises(MeshError, match=r"intersects itself: \d+ of \d+ triangles"):
        solid_surface(folded, triangles)
    assert not len(crossing_triangles(vertices, triangles))


def test_crossing_triangles_are_those_of_a_search_of_all_pairs() -> None:
    points = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (1, 1, -1), (1, 1, 1), (1, 5, 0.5),
                       (0, 0, 3), (4, 0, 3), (0, 4, 3)], float)  # fmt: skip
    pairs = crossing_triangles(points, np.array([(0, 1, 2), (3, 4, 5), (6, 7, 8)]))
    assert [sorted(pair) for pair in pairs.tolist()] == [[0, 1]]
    # Rounding far from the origin makes no crossings of triangles that share a vertex.
    tiny, faces = Sphere((0, 0, 0), 1e-4).surface(24)
    assert not len(crossing_triangles(tiny @ ROTATION + 1e3, faces))
    # Triangles that share a vertex or an edge, or lie in one plane, do not cross.
    fan = np.array([(0, 1, 2), (0, 1, 6), (0, 6, 7)])
    assert not len(crossing_triangles(points, fan))


def test_inward_normals_are_turned_cavities_and_the_largest_part_are_kept(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        _, faces = solid_surface(*moved((0, 0, 0), turn=True))
    assert "point inward" in caplog.text
    assert (faces == CUBE[1]).all()
    hollow = joined(CUBE, (SMALL[0], SMALL[1][:, ::-1]))
    assert len(solid_surface(*hollow)[1]) == 24
    debris = joined(SMALL, (CUBE[0] + (40, 0, 0), CUBE[1]))
    points, faces = solid_surface(*debris, largest=True)
    assert np.ptp(points, axis=0) == pytest.approx([20.0] * 3)
    assert len(faces) == 12


def test_tetrahedralize_refuses_a_surface_that_crosses_itself() -> None:
    """Two cubes that overlap by 3 mm: their common part would be meshed once."""
    vertices, triangles = CUBE
    both = np.concatenate([vertices, vertices + np.array([17.0, 1.0, 2.0])])
    with pytest.raises(MeshError, match=r"intersects itself: .* in \d+ places, one near"):
        tetrahedralize(both, np.concatenate([triangles, triangles + len(vertices)]), 5.0)
