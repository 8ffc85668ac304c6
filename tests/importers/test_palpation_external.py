"""Real palpations by a robot: contacts, noise and the places that are stiff."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.importers import import_palpation
from tactorch.recording import Recording

pytestmark = pytest.mark.external


@pytest.fixture(scope="module", params=["two-nodules", "kidney-line"])
def palpation(request: pytest.FixtureRequest, shared_data: Path) -> tuple[str, Recording]:
    path = shared_data / "robot-palpation" / f"{request.param}.csv"
    return request.param, import_palpation(path)


def test_nearly_all_probes_are_used(palpation: tuple[str, Recording]) -> None:
    name, recording = palpation
    known = {"two-nodules": (590, 0.05), "kidney-line": (728, 0.08)}
    count, most_noise = known[name]
    assert recording.provenance["probes"] >= count - 2
    assert 0.005 < recording.provenance["noise_n"] < most_noise
    assert recording.provenance["ball_radius_mm"] == pytest.approx(3.16, abs=0.02)
    assert recording.mesh.volumes.min() > 0.0


def test_the_forces_are_those_of_balls_on_a_soft_body(palpation: tuple[str, Recording]) -> None:
    _, recording = palpation
    forces = np.array([press.force.values[0] for press in recording.presses])
    steps = np.array([press.step for press in recording.presses])
    medians = [np.median(forces[steps == step]) for step in range(4)]
    assert (np.diff(medians) > 0.0).all()
    depths = [
        recording.presses[k].probe.depths(recording.mesh.points).max()
        for k in np.flatnonzero(steps == 3)[::50]
    ]
    assert 1.0 < np.median(depths) < 4.0


def test_the_stiffest_probes_are_on_the_two_nodules(shared_data: Path) -> None:
    recording = import_palpation(shared_data / "robot-palpation" / "two-nodules.csv")
    last = [press for press in recording.presses if press.step == 3]
    stiff = sorted(last, key=lambda press: -press.force.values[0])[:20]
    places = np.array([press.probe.position_mm[:2] for press in stiff])
    nearest = np.linalg.norm(places[:, None] - [[-6.0, 57.0], [-6.0, 28.0]], axis=2)
    assert nearest.min(axis=1).max() < 6.0
