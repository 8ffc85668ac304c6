import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, Discretisation
from tactorch.mesh import FACE_NAMES, TetMesh, box_mesh
from tactorch.simulation.patch import nodes_within, patch_center, patch_forces
from tactorch.simulation.plan import PressSite

MESH = box_mesh((10.0, 10.0, 4.0), (5, 7, 2))


def forces(element: str, site: PressSite, radius: float, mesh: TetMesh = MESH) -> np.ndarray:
    return patch_forces(Discretisation(mesh, ELEMENTS[element]), site, radius)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@settings(max_examples=25)
@given(x=st.floats(3.0, 7.0), y=st.floats(3.0, 7.0), radius=st.floats(0.05, 2.9))
def test_force_and_moment_are_those_of_the_disc(
    element: str, x: float, y: float, radius: float
) -> None:
    at = forces(element, PressSite("z+", (x, y, 0.0)), radius)
    area = np.pi * radius**2
    np.testing.assert_allclose(at.sum(axis=0), [0.0, 0.0, -area], rtol=1e-12, atol=1e-12 * area)
    positions = Discretisation(MESH, ELEMENTS[element]).positions
    center = positions.T @ -at[:, 2] / area
    np.testing.assert_allclose(center, [x, y, 4.0], atol=1e-9)


def test_quadratic_loads_have_the_second_moment_too() -> None:
    at = forces("tet10", PressSite("z+", (5.2, 4.7, 0.0)), 2.0)
    offsets = Discretisation(MESH, ELEMENTS["tet10"]).positions[:, :2] - [5.2, 4.7]
    moments = (offsets**2).T @ -at[:, 2]
    # Of the polygon of 96 sides; a disc's pi r^4 / 4 within its departure from it.
    np.testing.assert_allclose(moments, np.pi * 2.0**4 / 4, rtol=1e-3)


@pytest.mark.parametrize("face", FACE_NAMES)
def test_a_patch_larger_than_the_side_is_the_whole_side(face: str) -> None:
    site = PressSite(face)
    total = forces("tet4", site, 100.0).sum(axis=0)
    area = {"x": 40.0, "y": 40.0, "z": 100.0}[face[0]]
    np.testing.assert_allclose(total, area * site.direction, atol=1e-10)


def test_total_is_the_same_on_any_mesh_even_over_the_rim() -> None:
    site = PressSite("z+", (9.0, 5.0, 0.0))
    coarse, fine = (
        forces("tet4", site, 2.0, box_mesh((10.0, 10.0, 4.0), n)).sum(axis=0) for n in (2, 9)
    )
    np.testing.assert_allclose(coarse, fine, atol=1e-12)
    assert -np.pi * 4.0 < coarse[2] < -np.pi * 2.0


def test_center_is_projected_onto_the_side() -> None:
    np.testing.assert_array_equal(patch_center(MESH, PressSite("x-", (3.0, 4.0, 1.0))), [0, 4, 1])
    np.testing.assert_array_equal(patch_center(MESH, PressSite("z+")), [5.0, 5.0, 4.0])
    with pytest.raises(ConfigError, match="outside the object"):
        patch_center(MESH, PressSite("z+", (11.0, 5.0, 4.0)))


def test_nodes_within_the_patch() -> None:
    nodes = np.flatnonzero(MESH.points[:, 2] == 4.0)
    inside = nodes_within(MESH, nodes, PressSite("z+", (4.0, 5.0, 0.0)), 1.0)
    np.testing.assert_allclose(MESH.points[inside, 0], 4.0)
    with pytest.raises(ConfigError, match=r"enlarge press\.patch_radius_mm"):
        nodes_within(MESH, nodes, PressSite("z+", (5.0, 5.0, 0.0)), 0.1)
