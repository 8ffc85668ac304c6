"""The memory of a recorded session does not grow with its length."""

import json
from pathlib import Path
from types import ModuleType

import pytest

NAME = "sensor_memory"


def test_a_cycle_presses_once(benchmark: ModuleType):
    radii = [benchmark._cycle_contact(k) for k in range(100)]
    assert sum(radius > 0 for radius in radii) == 80
    assert max(radii) == pytest.approx(13.0, abs=0.01)
    assert benchmark.surface(13.0).height_mm.min() == pytest.approx(-0.42, abs=0.1)


@pytest.mark.slow
def test_memory_of_a_session_four_times_as_long(
    benchmark: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    benchmark.main(["--frames", "500", "2000", "--out", str(tmp_path)])
    short, long = json.loads(capsys.readouterr().out.splitlines()[-1])["sessions"]
    assert (short["contacts"], long["contacts"]) == (5, 20)
    assert long["peak_gib"] < 1.05 * short["peak_gib"]
    assert long["peak_gib"] < benchmark.LIMIT_GIB
    assert (tmp_path / "sensor_memory.md").is_file()
