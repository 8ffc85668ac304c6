import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.mesh import (
    Box,
    Cone,
    Cylinder,
    Ellipsoid,
    Hemisphere,
    Hyperboloid,
    Lathe,
    Rotated,
    Shape,
    Sphere,
    Torus,
    Union,
)
from tactorch.mesh.checks import closed_surface, enclosed_volume

quick = settings(deadline=None, max_examples=30)
SEEDS = st.integers(0, 2**32 - 1)
SHAPES: list[Shape] = [
    Sphere((1, 2, 3), 2.0),
    Box((1, 2, 3), (2, 3, 4)),
    Cylinder((1, 2, 3), 1.5, 4.0, (1, 2, 2)),
    Cylinder((1, 2, 3), 1.5, 1.0),
    Ellipsoid((1, 2, 3), (1.0, 2.0, 3.0)),
    Ellipsoid((1, 2, 3), (2.0, 2.0, 0.3)),
    Torus((1, 2, 3), 2.0, 0.7, (1, 2, 2)),
    Cone((1, 2, 3), 2.0, 3.0, (1, 2, 2)),
    Cone((1, 2, 3), 2.0, 3.0, (0, 0, -1), 0.5),
    Hemisphere((1, 2, 3), 2.0, (-1, 2, 0)),
    Hyperboloid((1, 2, 3), 0.6, 1.5, 3.0, (0, 1, 0)),
    Lathe((1, 2, 2), ((0, 0), (1, 0), (1.5, 1), (0.5, 1.5), (0.7, 2), (0, 2.5))),
    Rotated(Box((1, 2, 3), (2, 3, 4)), (20, 30, 40)),
]
#: Inside, distances are those to the nearest surface of a part.
JOINED = Union((Sphere((1, 2, 3), 1.5), Box((2, 2, 3), (2, 3, 1))))


def around(shape: Shape, seed: int, k: int = 200) -> np.ndarray:
    low, high = shape.bounds()
    rng = np.random.default_rng(seed)
    return low - 1.0 + rng.random((k, 3)) * (high - low + 2.0)


def volume_by_sampling(shape: Shape) -> float:
    low, high = shape.bounds()
    grid = [np.linspace(a, b, 81)[:-1] + (b - a) / 160 for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    return float(shape.contains(points).mean() * np.prod(high - low))


@pytest.mark.parametrize("shape", SHAPES, ids=repr)
@quick
@given(seed=SEEDS)
def test_distance_is_euclidean(shape: Shape, seed: int) -> None:
    """Lipschitz with constant 1, and walking against the gradient ends on the surface."""
    points = around(shape, seed)
    distance = shape.signed_distance(points)
    moved = points + np.random.default_rng(seed + 1).normal(size=points.shape)
    change = np.abs(shape.signed_distance(moved) - distance)
    assert (change <= np.linalg.norm(moved - points, axis=1) * (1 + 1e-9) + 1e-12).all()
    step = 1e-6
    gradient = np.column_stack(
        [
            (shape.signed_distance(points + d) - shape.signed_distance(points - d)) / (2 * step)
            for d in step * np.eye(3)
        ]
    )
    # Where two surface points are equally near there is no gradient: such points are rare.
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1) < 1e-5
    assert smooth.mean() > 0.9
    ends = points[smooth] - distance[smooth, None] * gradient[smooth]
    assert np.abs(shape.signed_distance(ends)).max() < 1e-3


@pytest.mark.parametrize("shape", [*SHAPES, JOINED], ids=repr)
def test_sign_and_bounds(shape: Shape) -> None:
    assert isinstance(shape, Shape)
    points = around(shape, 0, 4000)
    inside = shape.contains(points)
    low, high = shape.bounds()
    assert 0 < inside.sum() < len(points)
    assert ((points[inside] >= low) & (points[inside] <= high)).all()
    np.testing.assert_array_equal(inside, shape.signed_distance(points) <= 0)
    assert shape.contains(np.array([[1.0, 2.0, 3.0]])).all() != isinstance(shape, Torus)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Sphere((1, 2, 3), 2.0), 4 / 3 * np.pi * 8),
        (Box((1, 2, 3), (2, 3, 4)), 24.0),
        (Cylinder((1, 2, 3), 1.5, 4.0, (1, 2, 2)), np.pi * 9),
        (Ellipsoid((1, 2, 3), (1.0, 2.0, 3.0)), 8 * np.pi),
        (Torus((1, 2, 3), 2.0, 0.7, (1, 2, 2)), 2 * np.pi**2 * 2.0 * 0.49),
        (Cone((1, 2, 3), 2.0, 3.0, (1, 2, 2)), 4 * np.pi),
        (Cone((1, 2, 3), 2.0, 3.0, (1, 2, 2), 1.0), 7 * np.pi),
        (Hemisphere((1, 2, 3), 2.0, (-1, 2, 0)), 16 / 3 * np.pi),
        (Hyperboloid((1, 2, 3), 0.6, 1.5, 3.0), np.pi * 3 * (0.36 + (2.25 - 0.36) / 3)),
        (Rotated(Box((1, 2, 3), (2, 3, 4)), (20, 30, 40)), 24.0),
        (Union((Sphere((0, 0, 0), 1.0), Sphere((3, 0, 0), 1.0))), 8 / 3 * np.pi),
    ],
)
def test_volume(shape: Shape, volume: float) -> None:
    assert volume_by_sampling(shape) == pytest.approx(volume, rel=0.01)


def test_known_distances() -> None:
    box = Box(size_mm=(2, 4, 6))
    points = np.array([(0, 0, 0), (4, 6, 3), (1, 1, 0), (0.9, 0, 0), (2, 0, 0)], float)
    np.testing.assert_allclose(box.signed_distance(points), [-1, 5, 0, -0.1, 1])
    rod = Cylinder(radius_mm=1, height_mm=4, axis=(0, 5, 0))
    points = np.array([(0, 0, 0), (0, 6, 0), (4, 6, 0), (0, 1.5, 0.2), (0, 0, 3)], float)
    np.testing.assert_allclose(rod.signed_distance(points), [-1, 4, 5, -0.5, 2])


def test_ellipsoid_on_its_symmetry_planes() -> None:
    egg = Ellipsoid(radii_mm=(3, 2, 1))
    points = np.array([(0, 0, 0), (5, 0, 0), (0, 0, 4), (0, 2, 0), (0, 0, 0.5), (0, -3, 0)], float)
    np.testing.assert_allclose(egg.signed_distance(points), [-1, 2, 3, 0, -0.5, 1], atol=1e-10)
    # On the long axis, inside the evolute, the nearest point is off the axis.
    t = 1.0 * 3 / (9 - 1)
    off = np.linalg.norm([3 * t - 1, 0, np.sqrt(1 - t**2)])
    assert egg.signed_distance(np.array([[1.0, 0, 0]]))[0] == pytest.approx(-off)


@quick
@given(seed=SEEDS, radii=st.tuples(*[st.floats(0.05, 20.0)] * 3))
def test_ellipsoid_nearest_points_lie_on_it(seed: int, radii: tuple[float, float, float]) -> None:
    """Points made by walking a known way along the normal have that distance."""
    rng = np.random.default_rng(seed)
    sphere = rng.normal(size=(50, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    surface = sphere * radii
    normals = sphere / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Walk outward any way, inward less than the smallest radius of curvature.
    way = rng.uniform(-0.9 * min(radii) ** 2 / max(radii), 10.0, 50)
    found = Ellipsoid(radii_mm=radii).signed_distance(surface + way[:, None] * normals)
    np.testing.assert_allclose(found, way, atol=1e-8 * max(radii))


def test_fields_accept_lists_and_become_tuples() -> None:
    sphere = Sphere([1, 2, 3], 4)  # type: ignore[arg-type]
    assert sphere == Sphere((1.0, 2.0, 3.0), 4.0)
    assert hash(sphere) == hash(Sphere((1.0, 2.0, 3.0), 4.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere((0, 0, 0), 0.0), "radius_mm=0.0 must be a positive number"),
        (lambda: Sphere((0, 0, np.nan), 1.0), "center_mm.*finite"),
        (lambda: Sphere((0, 0), 1.0), "center_mm.*three"),
        (lambda: Box(size_mm=(1, -1, 1)), "size_mm.*positive"),
        (lambda: Cylinder(height_mm=-1), "height_mm=-1"),
        (lambda: Cylinder(axis=(0, 0, 0)), "axis.*no direction"),
        (lambda: Ellipsoid(radii_mm=(1, 0, 1)), "radii_mm.*positive"),
        (lambda: Cylinder().surface(2), "segments=2"),
        (lambda: Cylinder(radius_mm=-1.0), "radius_mm"),
        (lambda: Torus().surface(4), r"segments=\(4, 2\)"),
    ],
)
def test_unusable_values(make, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


@quick
@given(size=st.tuples(*[st.floats(0.1, 50)] * 3), center=st.tuples(*[st.floats(-100, 100)] * 3))
def test_box_surface(size: tuple[float, ...], center: tuple[float, ...]) -> None:
    vertices, triangles = Box(center, size).surface()
    _, outward = closed_surface(vertices, triangles)
    np.testing.assert_array_equal(outward, triangles)
    assert enclosed_volume(vertices, triangles) == pytest.approx(np.prod(size), rel=1e-6)
    np.testing.assert_allclose(vertices.mean(axis=0), center, atol=1e-9)


@quick
@given(
    radius=st.floats(0.1, 50), height=st.floats(0.1, 50), seed=SEEDS, segments=st.integers(3, 60)
)
def test_cylinder_surface(radius: float, height: float, seed: int, segments: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    solid = Cylinder((1, 2, 3), radius, height, axis)
    vertices, triangles = solid.surface(segments)
    _, outward = closed_surface(vertices, triangles)
    np.testing.assert_array_equal(outward, triangles)
    prism = segments / 2 * radius**2 * np.sin(2 * np.pi / segments) * height
    assert enclosed_volume(vertices, triangles) == pytest.approx(prism)
    assert np.abs(solid.signed_distance(vertices[: 2 * segments])).max() < 1e-9 * (radius + height)


@pytest.mark.parametrize("shape", [*SHAPES, JOINED], ids=repr)
def test_skin_is_the_surface_outward(shape: Shape) -> None:
    """Closed, on the shape's surface, and of its volume."""
    vertices, triangles = shape.surface(72)
    closed_surface(vertices, triangles)
    assert enclosed_volume(vertices, triangles) == pytest.approx(
        volume_by_sampling(shape), rel=0.015
    )
    # Marching cubes is linear between its cells: it rounds edges off.
    rounding = 0.05 if isinstance(shape, Union) else 1e-9
    assert np.abs(shape.signed_distance(vertices)).max() < rounding


def test_ring_needs_a_hole_and_a_hyperboloid_a_waist() -> None:
    with pytest.raises(ConfigError, match="no hole"):
        Torus(radius_mm=1.0, tube_mm=1.0)
    with pytest.raises(ConfigError, match="narrowest at its waist"):
        Hyperboloid(waist_mm=2.0, rim_mm=1.0)
    with pytest.raises(ConfigError, match="begin and end on the axis"):
        Lathe(outline_mm=((1, 0), (1, 1), (0, 1)))
    with pytest.raises(ConfigError, match=r"parts\[0\]"):
        Union(("ball",))
    with pytest.raises(ConfigError, match="empty"):
        Union(())
    with pytest.raises(ConfigError, match="top_mm"):
        Cone(top_mm=-1.0)
