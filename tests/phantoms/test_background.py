import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import Box
from tactorch.phantoms import Gradient, Layers, Phantom, RandomField

CUBE = Box((5.0, 5.0, 5.0), (10.0, 10.0, 10.0))
LINE = np.column_stack((np.zeros(5), np.zeros(5), [-1.0, 0.0, 4.0, 8.0, 9.0]))


def test_gradient_rises_between_its_ends() -> None:
    field = Gradient((0, 0, 0), (0, 0, 8), 0.2, 1.0)
    np.testing.assert_allclose(field.at(LINE), [0.2, 0.2, 0.6, 1.0, 1.0])


def test_layers_change_at_their_levels() -> None:
    field = Layers((0.0, 5.0), (1.0, 0.5, 0.2))
    np.testing.assert_array_equal(field.at(LINE), [1.0, 1.0, 0.5, 0.2, 0.2])


def test_random_field_has_the_stated_statistics() -> None:
    """Median, spread and correlation over many draws, each at two points a length apart."""
    points = np.array([(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (40.0, 0.0, 0.0)])
    draws = [RandomField(0.3, 0.4, 4.0, seed).at(points) for seed in range(4000)]
    logs = np.log(np.array(draws) / 0.3)
    np.testing.assert_allclose(logs.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(logs.std(axis=0), 0.4, rtol=0.05)
    correlation = np.corrcoef(logs.T)
    assert correlation[0, 1] == pytest.approx(np.exp(-0.5), abs=0.04)
    assert correlation[0, 2] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(
    "field", [Gradient((0, 0, 0), (1, 2, 3)), Layers((5.0,), (1.0, 2.0)), RandomField(seed=3)]
)
def test_backgrounds_survive_their_configuration(field: object) -> None:
    phantom = Phantom(CUBE, (), field)
    again = Phantom.from_config(phantom.to_config())
    points = np.random.default_rng(0).uniform(0.0, 10.0, (50, 3))
    assert again == phantom
    np.testing.assert_array_equal(again.youngs_at(points), field.at(points))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"field": "waves"}, "field is 'waves'"),
        ({"field": "gradient"}, "lacks a field"),
        ({"field": "gradient", "start_mm": [0, 0, 0], "end_mm": [0, 0, 0]}, "no direction"),
        ({"field": "layers", "levels_mm": [2, 1], "youngs_mpa": [1, 2, 3]}, "must increase"),
        ({"field": "layers", "levels_mm": [1], "youngs_mpa": [1]}, "give 2"),
        ({"field": "random", "spread": 0}, "spread"),
        ({"field": "random", "seed": -1}, "seed=-1"),
        ({"field": "random", "sead": 1}, "unknown sead"),
    ],
)
def test_wrong_backgrounds_are_refused(config: dict, message: str) -> None:
    whole = {"body": {"shape": "box", "size_mm": [10, 10, 10]}, "youngs_mpa": config}
    with pytest.raises(ConfigError, match=message):
        Phantom.from_config(whole)
