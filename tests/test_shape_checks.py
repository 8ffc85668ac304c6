"""The checks of shapes in the tests themselves."""

import jaxtyping
import numpy as np
import pytest
import shape_checks
from beartype.roar import BeartypeCallHintViolation

from tactorch.mesh.geometry import surface_area


def test_wrong_shapes_are_noticed_until_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    points, faces = np.eye(3), np.array([[0, 1, 2]])
    with pytest.raises(jaxtyping.TypeCheckError):
        surface_area(points[:, :2], faces)
    monkeypatch.setattr(shape_checks, "MAX_CHECKS", shape_checks._count + 1)
    assert not jaxtyping.config.jaxtyping_disable
    surface_area(points, faces)
    assert jaxtyping.config.jaxtyping_disable
    shape_checks.restart()
    with pytest.raises(jaxtyping.TypeCheckError):
        surface_area(points[:, :2], faces)


def test_the_first_calls_of_each_function_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shape_checks, "MAX_CHECKS", 5000)

    @shape_checks.checker
    def same(number: int) -> int:
        return number

    for _ in range(shape_checks.MAX_EACH):
        with pytest.raises(BeartypeCallHintViolation):
            same("one")
    assert same("one") is None
    shape_checks.restart()
    with pytest.raises(BeartypeCallHintViolation):
        same("one")
