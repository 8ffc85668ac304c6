import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import Box, Cylinder, Ellipsoid, Shape, Sphere, box_mesh
from tactorch.mesh.quadrature import lattice
from tactorch.phantoms import PHANTOMS, Inclusion, Phantom, make_phantom

CUBE = Box((5.0, 5.0, 5.0), (10.0, 10.0, 10.0))
SHAPES: list[Shape] = [
    Sphere((5.0, 5.0, 5.0), 2.0),
    Box((5.0, 5.0, 5.0), (4.0, 3.0, 2.0)),
    Cylinder((5.0, 5.0, 5.0), 1.5, 4.0, (1.0, 0.0, 1.0)),
    Ellipsoid((5.0, 5.0, 5.0), (3.0, 2.0, 1.0)),
]


def test_modulus_is_that_of_the_part() -> None:
    phantom = Phantom(CUBE, [(Sphere((5.0, 5.0, 7.0), 2.0), 1.0)])
    points = np.array([(5.0, 5.0, 7.0), (5.0, 5.0, 8.99), (5.0, 5.0, 9.0), (5.0, 5.0, 9.01)])
    np.testing.assert_array_equal(phantom.youngs_at(points), [1.0, 1.0, 1.0, 0.2])


def test_later_inclusion_wins() -> None:
    outer, inner = Sphere((5.0, 5.0, 5.0), 3.0), Sphere((5.0, 5.0, 5.0), 1.0)
    points = np.array([(5.0, 5.0, 5.0), (5.0, 5.0, 7.0)])
    nested = Phantom(CUBE, [(outer, 1.0), (inner, 3.0)])
    covered = Phantom(CUBE, [(inner, 3.0), (outer, 1.0)])
    np.testing.assert_array_equal(nested.youngs_at(points), [3.0, 1.0])
    np.testing.assert_array_equal(covered.youngs_at(points), [1.0, 1.0])


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_elements_take_the_value_at_their_centroid(shape: Shape) -> None:
    phantom, mesh = Phantom(CUBE, [(shape, 1.0)]), box_mesh(10.0, 8)
    expected = np.where(shape.contains(mesh.centroids), 1.0, 0.2)
    np.testing.assert_array_equal(phantom.on_mesh(mesh), expected)
    assert set(expected) == {0.2, 1.0}


def test_volume_average_finds_the_volume_of_the_inclusion() -> None:
    phantom = Phantom(CUBE, [(Sphere((4.83, 5.21, 5.07), 2.0), 1.2)])
    mesh = box_mesh(10.0, 5)
    exact = 4.0 / 3.0 * np.pi * 8.0
    found = [float(mesh.volumes @ (phantom.on_mesh(mesh, s) - 0.2)) / exact for s in (1, 8)]
    assert found[1] == pytest.approx(1.0, rel=5e-3)
    assert abs(found[0] - 1.0) > 2e-2


@pytest.mark.parametrize("samples", [1, 2, 3, 7])
def test_means_are_exact_to_their_degree(samples: int) -> None:
    shares = lattice(samples)
    assert len(shares) == samples * (samples + 1) * (samples + 2) // 6
    assert (shares > 0).all()
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(shares.mean(axis=0), 0.25, rtol=1e-14)
    if samples > 1:
        # Over a tetrahedron the mean of L_a L_b is 1/20, of L_a^2 it is 1/10.
        moments = shares.T @ shares / len(shares)
        np.testing.assert_allclose(moments, (1.0 + np.eye(4)) / 20.0, rtol=1e-13)


def test_average_of_uniform_phantom_is_uniform() -> None:
    mesh = box_mesh(10.0, 3)
    np.testing.assert_allclose(Phantom(CUBE).on_mesh(mesh, 3), 0.2, rtol=1e-14)


@pytest.mark.parametrize(
    ("inclusion", "message"),
    [
        (Sphere((5.0, 5.0, 9.0), 2.0), r"inclusions\[1\].*protrudes 1 mm out"),
        (Sphere((50.0, 5.0, 5.0), 2.0), r"inclusions\[1\].*out of the body"),
        (Box((5.0, 5.0, 5.0), (1.0, 11.0, 1.0)), "protrudes 0.5 mm out"),
        (Cylinder((5.0, 5.0, 5.0), 1.0, 14.0, (1.0, 0.0, 0.0)), "protrudes 2 mm out"),
        (Ellipsoid((5.0, 5.0, 5.0), (1.0, 1.0, 5.1)), "protrudes 0.1 mm out"),
    ],
)
def test_inclusion_outside_the_body_is_refused(inclusion: Shape, message: str) -> None:
    inside = Sphere((5.0, 5.0, 5.0), 1.0)
    with pytest.raises(ConfigError, match=message):
        Phantom(CUBE, [(inside, 1.0), (inclusion, 1.0)])


def test_sphere_in_a_cylinder_must_fit_its_round_side() -> None:
    body = Cylinder((0.0, 0.0, 0.0), 5.0, 10.0)
    Phantom(body, [(Sphere((2.0, 2.0, 0.0), 2.1), 1.0)])
    with pytest.raises(ConfigError, match="out of the body"):
        Phantom(body, [(Sphere((3.0, 3.0, 0.0), 2.0), 1.0)])


def test_a_layer_flush_with_the_sides_is_an_inclusion() -> None:
    layer = Box((5.0, 5.0, 9.5), (10.0, 10.0, 1.0))
    assert Phantom(CUBE, [(layer, 1.0)]).inclusions == (Inclusion(layer, 1.0),)


@pytest.mark.parametrize("youngs", [0.0, -1.0, float("nan"), float("inf")])
def test_moduli_must_be_positive(youngs: float) -> None:
    with pytest.raises(ConfigError, match="youngs_mpa"):
        Phantom(CUBE, (), youngs)
    with pytest.raises(ConfigError, match=r"inclusions\[0\].youngs_mpa"):
        Phantom(CUBE, [(Sphere((5.0, 5.0, 5.0), 1.0), youngs)])


def test_body_must_have_flat_sides() -> None:
    with pytest.raises(ConfigError, match="body is a Sphere"):
        Phantom(Sphere())


def test_mesh_of_another_body_is_refused() -> None:
    with pytest.raises(MeshError, match="phantom's body"):
        Phantom(CUBE).on_mesh(box_mesh(11.0, 3))
    with pytest.raises(MeshError, match="position"):
        Phantom(CUBE).on_mesh(box_mesh(10.0, 3, center_mm=(0.0, 0.0, 0.0)))


def test_samples_below_one_are_refused() -> None:
    with pytest.raises(ConfigError, match="samples=0"):
        Phantom(CUBE).on_mesh(box_mesh(10.0, 3), 0)


OF_FILES = {"mesh", "labelled"}


@pytest.mark.parametrize("name", [name for name in PHANTOMS if name not in OF_FILES])
def test_named_phantoms_survive_their_configuration(name: str) -> None:
    phantom = make_phantom(name)
    assert Phantom.from_config(phantom.to_config()) == phantom


@settings(max_examples=40)
@given(
    place=st.tuples(*[st.floats(4.0, 6.0)] * 3),
    size=st.floats(0.1, 3.0),
    youngs=st.floats(1e-3, 100.0),
    kind=st.sampled_from(["sphere", "box", "cylinder", "ellipsoid"]),
)
def test_any_phantom_survives_its_configuration(
    place: tuple[float, float, float], size: float, youngs: float, kind: str
) -> None:
    shape: Shape = {
        "sphere": Sphere(place, size),
        "box": Box(place, (size, size, 1.0)),
        "cylinder": Cylinder(place, size, 1.0, (1.0, 2.0, 0.5)),
        "ellipsoid": Ellipsoid(place, (size, 1.0, 2.0)),
    }[kind]
    phantom = Phantom(CUBE, [(shape, youngs)], youngs)
    again = Phantom.from_config(phantom.to_config())
    points = np.random.default_rng(0).uniform(0.0, 10.0, (200, 3))
    np.testing.assert_array_equal(again.youngs_at(points), phantom.youngs_at(points))


BODY = {"shape": "box", "size_mm": [10, 10, 10]}
BALL = {"shape": "sphere", "radius_mm": 1, "youngs_mpa": 1}


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({}, "body is missing"),
        ({"body": 3}, "phantom.body is 3"),
        ({"body": {"shape": "blob"}}, "phantom.body: shape is 'blob'"),
        ({"body": {"shape": ["box"]}}, r"phantom.body: shape is \['box'\]"),
        ({"body": BODY, "young_mpa": 1}, "unknown young_mpa"),
        ({"body": BODY, "youngs_mpa": "soft"}, "phantom.youngs_mpa is 'soft'"),
        ({"body": {**BODY, "radius": 1}}, "phantom.body: unknown radius"),
        ({"body": {**BODY, "size_mm": [1, 2]}}, "phantom.body: size_mm"),
        ({"body": BODY, "inclusions": BALL}, "phantom.inclusions is"),
        ({"body": BODY, "inclusions": [{"shape": "sphere"}]}, r"inclusions\[0\]: youngs_mpa"),
        ({"body": BODY, "inclusions": [BALL, {**BALL, "radius_mm": -1}]}, r"\[1\]: radius_mm"),
        ({"body": BODY, "inclusions": [{**BALL, "diameter_mm": 1}]}, "unknown diameter_mm"),
    ],
)
def test_wrong_configurations_are_refused_by_name(config: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Phantom.from_config(config)
