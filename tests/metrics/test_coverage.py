import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.metrics.coverage import calibration_curve, coverage

ZERO, ONE = np.zeros(2), np.ones(2)


def test_counts_by_hand() -> None:
    objects = [(np.array([0.5, 3.0]), ZERO, ONE), (np.array([-1.0, 1.0]), ZERO, ONE)]
    found = coverage(objects, 0.9)
    np.testing.assert_allclose(found.per_object, [0.5, 1.0])
    assert found.fraction == 0.75
    np.testing.assert_allclose(
        calibration_curve(objects, np.array([0.1, 0.5, 0.9])), [0, 0.25, 0.75]
    )


def test_weights_count_elements_by_their_size() -> None:
    objects = [(np.array([0.5, 3.0]), ZERO, ONE), (np.array([-1.0, 1.0]), ZERO, ONE)]
    found = coverage(objects, 0.9, [np.array([3.0, 1.0]), np.array([2.0, 2.0])])
    np.testing.assert_allclose(found.per_object, [0.75, 1.0])
    assert found.fraction == 0.875
    for wrong in ([ONE], [ONE, -ONE], [ONE, ZERO], [ONE, np.ones(3)]):
        with pytest.raises(ConfigError, match="weights"):
            coverage(objects, 0.9, wrong)


def test_refusals() -> None:
    with pytest.raises(ConfigError, match="object 0: every deviation"):
        coverage([(ZERO, ZERO, ZERO)])
    with pytest.raises(ConfigError, match="empty"):
        coverage([])
    with pytest.raises(ConfigError, match="level"):
        coverage([(ZERO, ZERO, ONE)], 1.0)
    with pytest.raises(ConfigError, match="one shape"):
        coverage([(np.zeros(3), ZERO, ONE)])
