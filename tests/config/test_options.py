from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.config import Options, Registry, option, settings_of, to_mapping
from tactorch.errors import ConfigError


@dataclass(frozen=True)
class Prior(Options):
    section = "priors"
    edge: float = option(0.03, "Jump of log-modulus at which the penalty turns", gt=0)
    weight: float | None = option(None, "Weight; null chooses it by the noise", ge=0)
    share: float = option(0.5, "Share", gt=0, le=1)


@dataclass(frozen=True)
class Whole(Options):
    recording: Path = option(help="Recording to invert")
    count: int = option(3, "Number of presses", ge=1)
    start_mpa: float | Literal["homogeneous"] = option(0.2, "Start", unit="MPa", gt=0)
    center: tuple[float, float, float] = option((0.0, 0.0, 0.0), "Center", unit="mm")
    names: tuple[str, ...] = option((), "Names")
    shares: dict[str, float] = option(factory=dict, help="Shares")
    flag: bool | Literal["auto"] = option("auto", "Flag")
    prior: Any = option(factory=Prior, help="Prior", section="priors")


priors = Registry("priors", {"plain": f"{__name__}:Prior"})


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Registry, "__getitem__", lambda self, name: {"plain": Prior}[name])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"count": 0}, "count=0: give a whole number, at least 1."),
        ({"count": 1.0}, "count=1.0: give a whole number, at least 1."),
        ({"count": True}, "count=True: give a whole number"),
        ({"start_mpa": "uniform"}, "start_mpa='uniform': give a number or homogeneous above 0."),
        ({"start_mpa": float("nan")}, "start_mpa=nan: give"),
        ({"center": [1, 2]}, r"center=\[1, 2\]: give a list of three numbers: \[X,Y,Z\]."),
        ({"names": "z+"}, r"names='z\+': give a list of names: \[A,B\]."),
        ({"shares": {"a": "b"}}, "give a table of numbers"),
        ({"flag": "yes"}, "flag='yes': give true, false or auto."),
        ({"counts": 1}, "unknown setting 'counts'. Did you mean 'count'?"),
        ({"qqq": 1}, "unknown setting 'qqq'. Settings of this group: recording, count,"),
        ({"prior": {"name": "plain", "edge": 0}}, "prior.edge=0: give a number above 0."),
        ({"prior": {"name": "plain", "share": 2}}, "prior.share=2: give a number above 0, up to"),
        ({"prior": {"name": "plain", "weight": "x"}}, "give a number, at least 0, or null."),
        ({"prior": {"edge": 1}}, "prior.name=None: choose one of plain."),
        ({"prior": {"name": "plain", "egde": 1}}, "Did you mean 'prior.edge'"),
    ],
)
def test_wrong_values_are_refused_by_name(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Whole.from_mapping({"recording": "a.h5", **values})


def test_a_missing_setting_is_named() -> None:
    with pytest.raises(ConfigError, match=r"'recording' is missing; give .*\(a path"):
        Whole.from_mapping({})


def test_values_are_converted_and_come_back() -> None:
    built = Whole.from_mapping({"recording": 7, "center": [1, 2, 3], "prior": {"name": "plain"}})
    assert built.recording == Path("7")
    assert built.center == (1.0, 2.0, 3.0)
    assert built.prior == Prior()
    again = to_mapping(built)
    assert again["prior"]["edge"] == 0.03
    assert Whole.from_mapping({**again, "prior": {**again["prior"], "name": "plain"}}) == built


def test_what_lists_hold_becomes_plain() -> None:
    assert to_mapping([1, (2.0, "a"), {"b": [Path("c"), None]}]) == [
        1,
        [2.0, "a"],
        {"b": ["c", None]},
    ]


def test_python_and_tables_share_the_checks() -> None:
    with pytest.raises(ConfigError, match=r"priors\.edge=-1: give a number above 0\."):
        Prior(edge=-1)


def test_settings_carry_help_unit_and_choices() -> None:
    settings = {setting.name: setting for setting in settings_of(Whole)}
    assert settings["recording"].required
    assert settings["start_mpa"].unit == "MPa"
    assert settings["flag"].choices == (True, False, "auto")
    assert settings["start_mpa"].choices == ("homogeneous",)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_numbers_out_of_range_never_pass(value: float) -> None:
    valid = 0 < value < float("inf")
    if valid:
        assert Prior(edge=value).edge == value
    else:
        with pytest.raises(ConfigError):
            Prior(edge=value)


def test_numpy_values_are_stored_as_plain_ones() -> None:
    @dataclass(frozen=True)
    class Sizes(Options):
        edge_mm: float = option(help="Edge", unit="mm", ge=0.5, le=50)
        count: int = option(1, "Count", ge=1)
        size_mm: tuple[float, float] = option((1.0, 1.0), "Size", unit="mm", ge=0.5, le=50)

    sizes = Sizes(np.float32(2.0), np.int64(3), np.array([4.0, 5.0]))
    assert sizes == Sizes(2.0, 3, (4.0, 5.0))
    assert (type(sizes.edge_mm), type(sizes.count)) == (float, int)
    with pytest.raises(ConfigError, match=r"0.5 to 50. Is it in metres\? Then give 3.$"):
        Sizes(0.003)
    with pytest.raises(ConfigError, match=r"Is it in metres\? Then give 4, 5.$"):
        Sizes(2.0, size_mm=(0.004, 0.005))
    with pytest.raises(ConfigError, match=r"edge_mm=0: give a number, 0.5 to 50.$"):
        Sizes(0)
    with pytest.raises(ConfigError, match="edge_mm=1000"):
        Sizes(10**400)
