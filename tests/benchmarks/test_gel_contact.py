"""The benchmark of contact forces: its exact solution, its fine simulation, and what it says."""

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tactorch.sensor.description import GelLayer, load_sensor

NAME = "gel_contact"

# Force on a flat punch in a bonded layer over that in a half space, by a/h and Poisson's ratio:
# Hayes, Keer, Herrmann and Mockros, Journal of Biomechanics 5:541 (1972), table 1.
HAYES = {
    0.30: {0.2: 1.207, 0.4: 1.472, 0.6: 1.784, 0.8: 2.124, 1.0: 2.480},
    0.40: {0.2: 1.232, 0.4: 1.542, 0.6: 1.917, 0.8: 2.337, 1.0: 2.789},
    0.45: {0.2: 1.252, 0.4: 1.599, 0.6: 2.031, 0.8: 2.532, 1.0: 3.085},
    0.50: {0.2: 1.281, 0.4: 1.683, 0.6: 2.211, 0.8: 2.855, 1.0: 3.609},
}


@pytest.mark.parametrize("poisson", sorted(HAYES))
def test_a_punch_in_a_layer_is_as_published(benchmark: ModuleType, poisson: float) -> None:
    layer = benchmark.Layer(1.0, 0.435, min(poisson, 0.49999))
    for radius, ratio in HAYES[poisson].items():
        found = benchmark.flat_punch(layer, radius, 0.01).force_n
        half_space = benchmark.half_space_punch_n(layer, radius, 0.01)
        assert found / half_space == pytest.approx(ratio, rel=3e-3)


@pytest.mark.parametrize(
    "chi", [0.1, *(pytest.param(chi, marks=pytest.mark.slow) for chi in (0.05, 0.3, 0.5))]
)
def test_a_sphere_in_a_layer_is_as_published(benchmark: ModuleType, chi: float) -> None:
    from layer_contact import dimitriadis, garcia

    layer = benchmark.Layer(1.0, 0.435, 0.49999)
    depth = chi**2 / 50.0
    found = benchmark.sphere(layer, 50.0, depth).force_n / benchmark.hertz_n(layer, 50.0, depth)
    assert found == pytest.approx(garcia(chi), rel=0.01)
    if chi <= 0.1:
        assert found == pytest.approx(dimitriadis(chi), rel=0.003)


def test_a_deep_layer_is_a_half_space(benchmark: ModuleType) -> None:
    layer = benchmark.Layer(1e4, 0.2, 0.3)
    ball = benchmark.sphere(layer, 8.0, 0.02)
    assert ball.force_n == pytest.approx(benchmark.hertz_n(layer, 8.0, 0.02), rel=1e-3)
    assert ball.radius_mm == pytest.approx(0.4, rel=1e-3)
    punch = benchmark.flat_punch(layer, 1.0, 0.02)
    assert punch.force_n == pytest.approx(benchmark.half_space_punch_n(layer, 1.0, 0.02), rel=1e-3)
    away = np.array([1.2, 2.0, 5.0])
    expected = 0.02 * 2 / np.pi * np.arcsin(1.0 / away)
    np.testing.assert_allclose(punch.sinks_mm(away), expected, rtol=5e-3)


@pytest.mark.slow
def test_the_simulation_is_as_exact(benchmark: ModuleType) -> None:
    """A punch and a sphere on a coarse mesh; beside them the face sinks as it should."""
    gel = GelLayer(4.0, 0.435, 0.45, size_mm=(25.25, 20.75))
    for indenter in (benchmark.Indenter(punch_mm=2.0), benchmark.Indenter(sphere_mm=20.0)):
        case = benchmark.Case("x", gel, indenter, 0.1)
        _, exact = case.forces_n()
        pressed = benchmark.simulated(case, 0.6)
        assert -pressed.force_n[2] == pytest.approx(exact, rel=0.025)
        assert pressed.edge_mm == pytest.approx(case.contact_mm, rel=0.12)
        if indenter.punch_mm is not None:
            away = np.array([2.6, 3.5])
            beside = pressed.at(np.column_stack([-away * 0.6, away * 0.8]))
            sinks = benchmark.flat_punch(case.layer, 2.0, 0.1).sinks_mm(away)
            np.testing.assert_allclose(-beside[:, 2], sinks, atol=0.003)


@pytest.mark.slow
def test_totals_are_within_five_percent(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """Against the simulation, with and without noise; and that against the exact solution."""
    benchmark.main(["--quick"])
    found = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert [case["indenter"] for case in found["cases"]] == ["punch", "sphere"]
    for case in found["cases"]:
        assert abs(case["fine_off"]) < 0.02
        assert case["exact_n"] > 1.5 * case["half_space_n"]  # the layer is thin
        assert abs(case["direct_off"]) < 0.05
        assert abs(case["smooth_off"]) < 0.03
        assert abs(case["noisy_mean_off"]) < 0.03
        assert case["noisy_worst_off"] < 0.05
        assert case["noisy_deviation"] > 0
    modulus = found["modulus"]
    assert modulus["youngs_mpa"] == pytest.approx(modulus["true_mpa"], rel=0.05)
    assert abs(modulus["youngs_mpa"] - modulus["true_mpa"]) < 3 * modulus["deviation_mpa"]


@pytest.fixture
def published(shared_data: Path) -> Path:
    return shared_data / "feats-mini-gel"


@pytest.mark.external
def test_the_shipped_gel_is_the_published_one(benchmark: ModuleType, published: Path) -> None:
    """Outline, thickness and material (neo-Hookean, C10; E = 6 C10 where the volume stays)."""
    gel = load_sensor("gelsight_mini").gel
    fine = benchmark.published_gel(published, float(gel.youngs_mpa), float(gel.poisson))
    size = np.ptp(fine.mesh.points, axis=0)
    np.testing.assert_allclose(size, (*gel.size_mm, gel.thickness_mm), atol=1e-3)
    assert np.ptp(fine.mesh.points[fine.held[:, 0], 2]) < 1e-6
    lines = (published / "materials.inp").read_text().splitlines()
    c10, d1 = (float(x) for x in lines[lines.index("*HYPERELASTIC, NEO HOOKE") + 1].split(","))
    assert float(gel.youngs_mpa) == pytest.approx(6.0 * c10)
    assert d1 == 0.0  # the volume stays


@pytest.mark.external
@pytest.mark.slow
def test_the_published_gel_is_told_within_five_percent(
    benchmark: ModuleType, published: Path
) -> None:
    """Curved and rounded as it is, where the model takes it for a flat box."""
    case = next(c for c in benchmark.CASES if c.gel is benchmark.MINI and c.indenter.sphere_mm)
    gel = load_sensor("gelsight_mini").gel
    fine = benchmark.published_gel(published, float(gel.youngs_mpa), float(gel.poisson))
    row = benchmark.judged(case, benchmark.pressed_on(fine, case), {}, range(2))
    assert abs(row["smooth_off"]) < 0.05
    assert row["noisy_worst_off"] < 0.05
