"""Places of a small sensor on curved bodies."""

from types import ModuleType

import numpy as np
import pytest

NAME = "sensor_bodies"


@pytest.mark.parametrize("name", ["cylinder", "hemisphere"])
def test_the_sensor_looks_into_the_body(benchmark: ModuleType, name: str) -> None:
    session = benchmark.SESSIONS[name]
    for place in benchmark.places_on(session.body, session.middle_mm, session.directions):
        pose = place.pose()
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        along = pose[:3, 3] + np.array([-1.0, 0.0, 1.0])[:, None] * pose[:3, 2]
        np.testing.assert_allclose(session.body.signed_distance(along), [1, 0, -1], atol=1e-3)


def test_balls_are_in_their_bodies(benchmark: ModuleType) -> None:
    for session in benchmark.SESSIONS.values():
        if session.body is not None:
            center = np.array([session.ball.center_mm])
            assert session.body.signed_distance(center)[0] < -session.ball.radius_mm
