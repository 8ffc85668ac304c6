import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.learning.recognizer import class_scores


def test_scores_of_a_worked_example() -> None:
    probabilities = np.array([[0.9, 0.1, 0.0], [0.6, 0.4, 0.0], [0.2, 0.8, 0.0], [0.55, 0.45, 0.0]])
    found = class_scores(probabilities, np.array([0, 0, 1, 1]))
    np.testing.assert_array_equal(found.confusion, [[2, 0, 0], [1, 1, 0], [0, 0, 0]])
    assert found.accuracy == 0.75
    np.testing.assert_allclose(found.precision, [2 / 3, 1.0, np.nan])
    np.testing.assert_allclose(found.recall, [1.0, 0.5, np.nan])
    np.testing.assert_allclose(found.f1, [0.8, 2 / 3, np.nan])
    # Tenths: 0.9 right, 0.8 right, 0.6 right, 0.55 wrong.
    assert found.calibration_error == pytest.approx((0.1 + 0.2 + 0.4 + 0.55) / 4)


def test_answers_as_right_as_stated_are_calibrated() -> None:
    rng = np.random.default_rng(0)
    first = rng.uniform(0.5, 1.0, 40_000)
    truth = (rng.random(40_000) > first).astype(int)
    found = class_scores(np.column_stack((first, 1 - first)), truth)
    assert found.calibration_error < 0.01


def test_what_cannot_be_scored_is_refused() -> None:
    with pytest.raises(ConfigError, match="0 answers"):
        class_scores(np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
    with pytest.raises(ConfigError, match="do not fit"):
        class_scores(np.full((1, 2), 0.5), np.array([2]))
