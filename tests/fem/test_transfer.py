from collections.abc import Callable

import numpy as np
import pytest

from tactorch.errors import MeshError
from tactorch.fem import ELEMENTS, Discretisation
from tactorch.fem.transfer import Transfer
from tactorch.mesh import box_mesh

Field = Callable[[np.ndarray], np.ndarray]
RNG = np.random.default_rng(5)
SLOPE, BEND = RNG.normal(size=(3, 3)), RNG.normal(size=(3, 3, 3))


def linear(x: np.ndarray) -> np.ndarray:
    return 1.0 + x @ SLOPE


def quadratic(x: np.ndarray) -> np.ndarray:
    return linear(x) + np.einsum("pi,pj,ijk->pk", x, x, BEND)


@pytest.mark.parametrize(("element", "field"), [("tet4", linear), ("tet10", quadratic)])
def test_fields_of_the_elements_degree_are_exact(element: str, field: Field) -> None:
    source = Discretisation(box_mesh(10.0, 3), ELEMENTS[element])
    targets = RNG.uniform(0.0, 10.0, (100, 3))
    moved = Transfer.between(source, targets)(field(source.positions))
    np.testing.assert_allclose(moved, field(targets), rtol=1e-9)


def test_own_nodes_keep_their_values() -> None:
    mesh = box_mesh(10.0, 3)
    values = RNG.normal(size=(mesh.n_points, 3))
    transfer = Transfer.between(Discretisation(mesh, ELEMENTS["tet4"]), mesh.points)
    np.testing.assert_allclose(transfer(values), values, atol=1e-12)


def test_points_just_outside_continue_the_field() -> None:
    source = Discretisation(box_mesh(10.0, 3), ELEMENTS["tet4"])
    targets = np.array([(5.0, 4.0, 10.02), (-0.05, 3.0, 3.0), (10.01, 10.01, 10.01)])
    moved = Transfer.between(source, targets)(linear(source.positions))
    np.testing.assert_allclose(moved, linear(targets), rtol=1e-9)


def test_points_far_outside_are_refused() -> None:
    source = Discretisation(box_mesh(10.0, 3), ELEMENTS["tet4"])
    with pytest.raises(MeshError, match="mm outside the fine mesh"):
        Transfer.between(source, np.array([(5.0, 5.0, 11.0)]))
