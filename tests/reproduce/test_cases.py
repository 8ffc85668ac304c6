"""Cases: stored one by one, never made twice, and told apart by their settings."""

import sys
from types import ModuleType

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.reproduce.cases import CaseResult, run_cases


class Study(ModuleType):
    """A study that counts what it makes; "bad" fails until it is mended."""

    def __init__(self) -> None:
        super().__init__("tactorch.reproduce.counting")
        self.made: list[str] = []
        self.mended = False

    def run_case(self, settings, scratch):
        name = settings["name"]
        self.made.append(name)
        scratch.mkdir(parents=True, exist_ok=True)
        (scratch / "half").write_text("what a kill would leave")
        if name == "bad" and not self.mended:
            raise ConfigError("this one\ncannot be made")
        if name == "worse":
            raise RuntimeError("nobody foresaw this")
        return CaseResult({"double": 2 * settings["x"]}, {"row": np.arange(3.0)})


@pytest.fixture
def study(monkeypatch):
    made = Study()
    monkeypatch.setitem(sys.modules, made.__name__, made)
    return made


def cases(**values):
    return {name: {"name": name, "x": x} for name, x in values.items()}


def run(wanted, folder):
    told = []
    found = run_cases("counting", wanted, folder, 1, lambda *how: told.append(how))
    return *found, told


def test_cases_are_made_once(study, tmp_path):
    found, failed, told = run(cases(a=1, b=2), tmp_path)
    assert failed == {}
    assert found["b"].figures == {"double": 4}
    assert np.array_equal(found["a"].arrays["row"], np.arange(3.0))
    assert told == [(0, 2, ""), (1, 2, ""), (2, 2, "")]
    again, _, told = run(cases(a=1, b=2, c=3), tmp_path)
    assert study.made == ["a", "b", "c"]
    assert set(again) == {"a", "b", "c"}
    assert told[0] == (2, 3, "")
    assert not list(tmp_path.rglob("*.unfinished"))


def test_other_settings_are_another_case(study, tmp_path):
    run(cases(a=1), tmp_path)
    found, _, _ = run(cases(a=5), tmp_path)
    assert study.made == ["a", "a"]
    assert found["a"].figures == {"double": 10}


def test_a_case_that_fails_hinders_no_other_and_is_tried_again(study, tmp_path):
    found, failed, told = run(cases(a=1, bad=2, c=3), tmp_path)
    assert failed == {"bad": "this one cannot be made"}
    assert set(found) == {"a", "c"}
    assert told[-1] == (3, 3, ", 1 failed")
    assert list(tmp_path.rglob("half"))  # it may go on from there
    study.mended = True
    found, failed, _ = run(cases(a=1, bad=2, c=3), tmp_path)
    assert failed == {}
    assert study.made == ["a", "bad", "c", "bad"]
    assert not list(tmp_path.rglob("half"))


def test_errors_that_nobody_foresaw_hinder_no_other_case(study, tmp_path):
    found, failed, _ = run(cases(worse=1, a=2), tmp_path)
    assert failed == {"worse": "RuntimeError: nobody foresaw this"}
    assert set(found) == {"a"}


def test_damaged_outcomes_are_named(study, tmp_path):
    run(cases(a=1), tmp_path)
    (path,) = tmp_path.rglob("*.npz")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(FileError, match=path.name):
        run(cases(a=1), tmp_path)
