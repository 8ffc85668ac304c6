"""The end of the presses."""

from typing import Any

import pytest
from robot_fakes import entry

from tactorch.robot import StopRule, position_width_mm


def test_the_width_is_that_of_a_90_percent_interval_along_the_widest_axis() -> None:
    assert position_width_mm({"center_deviation_mm": [0.1, 0.3, 0.2]}) == pytest.approx(0.987, 1e-3)


def test_a_narrow_lump_ends_the_run() -> None:
    reason = StopRule(width_mm=1.0).decide(entry(5, 0.9))
    assert "0.9 mm wide after 5 presses" in reason


@pytest.mark.parametrize(
    "going_on",
    [
        entry(5, 1.1),  # too wide
        entry(5, 0.9, 1.3),  # one of two
        entry(2, 0.9),  # too early
        entry(5, 0.9, probability=0.94),  # not probable enough
        entry(5, 0.9, searched=False),  # of fewer presses
        entry(7),  # nothing yet
    ],
)
def test_it_goes_on(going_on: dict[str, Any]) -> None:
    assert StopRule().decide(going_on) == ""


@pytest.mark.parametrize("last", [entry(8), entry(8, 0.5, probability=0.92), entry(9)])
def test_nothing_probable_ends_the_run_too(last: dict[str, Any]) -> None:
    assert "nothing was found" in StopRule().decide(last)


def test_what_cannot_be_told_is_not_called_nothing() -> None:
    reason = StopRule().decide(entry(8, reasons=["the best model leaves 20 %"]))
    assert "cannot tell" in reason


def test_a_wide_lump_does_not_end_as_nothing() -> None:
    assert StopRule().decide(entry(12, 1.5)) == ""
