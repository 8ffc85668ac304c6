"""Forces of probes on a bonded layer against the exact solution."""

import pytest

NAME = "probe_contact"


@pytest.mark.slow
@pytest.mark.parametrize("case", ["ball, thick layer", "ball, thin layer"])
def test_the_force_of_a_ball_is_that_on_a_bonded_layer(benchmark, case: str) -> None:
    (chosen,) = [one for one in benchmark.CASES if one.name == case]
    found = benchmark.run(chosen)
    assert found["ratio"] == pytest.approx(1.0, abs=0.02)
    assert found["over_hertz"] > 1.05
    assert found["steps"] == 1


@pytest.mark.slow
def test_a_press_on_linear_elements_converges_at_once(benchmark) -> None:
    found = benchmark.timed()
    assert found["elements"] == 5000
    assert found["steps"] == 1
    assert found["iterations"] <= 12
