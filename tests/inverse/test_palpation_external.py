"""Shapes of real palpations by a robot: two nodules, and a line in a kidney."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.importers import import_palpation
from tactorch.inverse import Reconstruction, find_shapes
from tactorch.inverse.result.build import of_inclusions
from tactorch.recording import Recording

pytestmark = [pytest.mark.external, pytest.mark.slow]


def find(shared_data: Path, name: str) -> tuple[Recording, Reconstruction]:
    recording = import_palpation(shared_data / "robot-palpation" / f"{name}.csv", depth_mm=8.0)
    return recording, of_inclusions(recording, find_shapes(recording), {}, 0.0)


def test_two_nodules_are_two_stiff_lumps_below_the_stiffest_probes(shared_data: Path) -> None:
    recording, finding = find(shared_data, "two-nodules")
    assert len(finding.lumps) == 2
    last = [press for press in recording.presses if press.step == 3]
    places = np.array([press.probe.position_mm[:2] for press in last])
    forces = np.array([press.force.values[0] for press in last])
    for lump, side in zip(
        sorted(finding.lumps, key=lambda lump: lump.inclusion.center_mm[1]),
        (places[:, 1] < 42.0, places[:, 1] > 42.0),
        strict=True,
    ):
        stiffest = np.argsort(-np.where(side, forces, -np.inf))[:5]
        center = places[stiffest].mean(axis=0)
        assert np.linalg.norm(lump.inclusion.center_mm[:2] - center) < 2.0
        assert lump.inclusion.contrast > 2.0


def test_the_line_in_the_kidney_is_one_long_lump(shared_data: Path) -> None:
    _, finding = find(shared_data, "kidney-line")
    (lump,) = finding.lumps
    assert lump.elongation is not None
    # From about (-32, 46) to (22, 50) mm by the stiffness of single probes.
    assert abs(lump.elongation.direction[0]) > 0.98
    assert 35.0 < lump.elongation.length_mm < 65.0
    assert lump.elongation.widths_mm[0] < 12.0
    assert lump.inclusion.center_mm[:2] == pytest.approx([-5.0, 47.0], abs=5.0)
    assert lump.inclusion.contrast > 1.3
