"""The benchmark of the sensor's speed: what it compares, in one process."""

import json
from types import ModuleType

import pytest

NAME = "sensor_speed"


@pytest.mark.slow
def test_forces_are_those_of_the_simulation_and_fast(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    benchmark.main(["--quick"])
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    times = {row["stage"]: row["processor_s"] for row in result["stages"]}
    small, large = (times[f"forces, {name} deformation"] for name in ("small", "large"))
    assert small < large
    assert small < times["slopes and depth"]
    large_frame = result["forces"][1]
    simulated, found = (large_frame[key][2] for key in ("simulated_n", "force_n"))
    assert found == pytest.approx(simulated, rel=0.1)  # on cells of 2 mm
    assert large_frame["depth_alone_n"] == pytest.approx(simulated, rel=0.15)
