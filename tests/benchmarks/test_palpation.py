"""Predictions at probes that are left out."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.fem.contact.pressures import ball_force
from tactorch.importers import import_palpation

NAME = "palpation"
RADIUS, MODULUS = 3.0, 0.05


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Probes on a half-space, from their contact."""
    names = "probe,step,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n,contact_x_mm,contact_y_mm,contact_z_mm"
    lines = [f"{names},normal_x,normal_y,normal_z"]
    axis = np.arange(0.0, 17.0, 4.0)
    for probe, (x, y) in enumerate((a, b) for a in axis for b in axis):
        for step, depth in enumerate(np.arange(0.4, 1.7, 0.3)):
            force = MODULUS * ball_force(np.array([depth]), RADIUS)[0]
            values = [x, y, RADIUS - depth, 0.0, 0.0, force, x, y, -0.4, 0.0, 0.0, 1.0]
            lines.append(f"{probe},{step}," + ",".join(f"{value:.6f}" for value in values))
    path = tmp_path / "palpation.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_probes_and_subsets_are_read(benchmark, file: Path, tmp_path: Path) -> None:
    probes = benchmark.read_probes(file, RADIUS)
    assert len(probes) == 25
    assert probes[3].depths == pytest.approx(np.arange(0.0, 1.3, 0.3))
    some = benchmark.write_subset(file, {2, 5}, tmp_path / "some.csv")
    assert sorted(benchmark.read_probes(some, RADIUS)) == [2, 5]


def test_a_uniform_map_predicts_the_forces_of_a_uniform_body(benchmark, file: Path) -> None:
    recording = import_palpation(file, radius_mm=RADIUS, depth_mm=30.0, edge_mm=4.0)
    probes = list(benchmark.read_probes(file, RADIUS).values())
    youngs = np.full(recording.mesh.n_tets, MODULUS * (1.0 - 0.45**2))
    first = float(np.mean([probe.forces[0] for probe in probes]))
    predicted = benchmark.by_map(recording, youngs, probes, first)
    score = benchmark.errors(probes, predicted)
    # A block of 30 mm instead of a half-space.
    assert score["rms_n"] < 0.05 * max(probe.forces.max() for probe in probes)
    assert score["by_step_n"][0] < 1e-3


def test_errors_are_those_of_the_forces(benchmark, file: Path) -> None:
    probes = list(benchmark.read_probes(file, RADIUS).values())
    wrong = [probe.forces + 0.1 * (-1.0) ** k for k, probe in enumerate(probes)]
    score = benchmark.errors(probes, wrong)
    assert score["rms_n"] == pytest.approx(0.1)
    assert score["mean_n"] == pytest.approx(0.1)
    assert len(score["by_step_n"]) == 5


def test_processes_predict_what_is_uniform(benchmark, file: Path) -> None:
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    probes = list(benchmark.read_probes(file, RADIUS).values())
    train, test = probes[::2], probes[1::2]
    first = float(np.mean([probe.forces[0] for probe in train]))
    for predicted in benchmark.by_processes(train, test, RADIUS, first).values():
        assert len(predicted) == len(test)
    half_space = benchmark.by_processes(train, test, RADIUS, first)["half-space"]
    assert benchmark.errors(test, half_space)["rms_n"] < 0.01
