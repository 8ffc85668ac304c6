"""Components of user-defined modules that a folder of settings names by `_target_`."""

import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from tactorch.config import targets
from tactorch.inverse import PRIORS

MODULE = '''
from dataclasses import dataclass

from tactorch.config import option
from tactorch.inverse import Tikhonov

print("imported")


@dataclass(frozen=True, kw_only=True)
class Mine(Tikhonov):
    """A prior of a laboratory."""

    share: float = option(1.0, "Weight of something", gt=0)


class Other:
    """No prior."""
'''


@pytest.fixture
def conf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of settings that names a prior of the package `mylab_priors`."""
    monkeypatch.setattr(targets, "_trusted", {"tactorch"})
    monkeypatch.setattr(PRIORS, "_added", {})
    package = tmp_path / "modules" / "mylab_priors"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "priors.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path / "modules")
    folder = tmp_path / "conf"
    write(folder, "_target_: mylab_priors.priors.Mine\nshare: 2.5\n")
    yield folder
    for name in [name for name in sys.modules if name.startswith("mylab_priors")]:
        del sys.modules[name]


def write(folder: Path, text: str, group: str = "regularization") -> None:
    (folder / group).mkdir(parents=True, exist_ok=True)
    (folder / group / "mine.yaml").write_text(text)


def test_a_trusted_package_adds_a_component_with_its_settings_and_checks(
    tactorch: Any, recording_file: Path, conf: Path
) -> None:
    words = ("invert", f"recording={recording_file}", "--config-dir", conf)
    chosen = (*words, "--trust", "mylab_priors", "regularization=mine")
    done = tactorch(*chosen, "--cfg", "job")
    assert done.status == 0, done.err
    assert "name: mine" in done.out
    assert "share: 2.5" in done.out
    done = tactorch(*chosen, "regularization.share=-1")
    assert "regularization.share=-1: give a number above 0" in done.err
    assert "unknown setting 'regularization.shar'" in tactorch(*chosen, "regularization.shar=1").err
    done = tactorch(*chosen, "method=map", "optimizer.max_iterations=1", "run_dir=run")
    assert done.status == 0, done.err
    assert Path("run/reconstruction.h5").is_file()


def test_nothing_of_other_packages_is_imported(
    tactorch: Any, recording_file: Path, conf: Path
) -> None:
    words = ("invert", f"recording={recording_file}", "--config-dir", conf)
    for trust in ((), ("--trust", "mylab"), ("--trust", "other,another")):
        done = tactorch(*words, *trust, "regularization=mine")
        assert "the package 'mylab_priors' is not trusted; add --trust mylab_priors" in done.err
        assert "imported" not in done.out
        assert "mylab_priors.priors" not in sys.modules


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("_target_: mylab_priors.nowhere.Mine\n", "cannot be imported (ModuleNotFoundError"),
        ("_target_: mylab_priors.priors.Nobody\n", "cannot be imported (AttributeError"),
        ("_target_: mylab_priors.priors.Other\n", "is no regularization; derive the class from"),
        ("_target_: mylab_priors\n", "'mylab_priors': give MODULE.CLASS"),
        ("_target_: [1, 2]\n", "[1, 2]: give MODULE.CLASS"),
        ("_target_: mylab_priors.priors.Mine\nshar: 1\n", "unknown setting 'shar'"),
        ("_target_: mylab_priors.priors.Mine\nshare: ${oc.env:HOME}\n", "can run programs"),
        ("share:\n  _target_: os.system\n", "can run programs"),
    ],
)
def test_errors_name_the_file_and_the_path(
    tactorch: Any, recording_file: Path, conf: Path, text: str, message: str
) -> None:
    write(conf, text)
    words = ("invert", f"recording={recording_file}", "--config-dir", conf)
    done = tactorch(*words, "--trust", "mylab_priors", "regularization=mine")
    assert done.status == 2
    assert message in done.err
    assert "mine.yaml" in done.err
    assert "Traceback" not in done.err


def test_groups_without_components_have_no_targets(tactorch: Any, conf: Path) -> None:
    write(conf, "_target_: mylab_priors.priors.Mine\n", group="mesh")
    done = tactorch("simulate", "--config-dir", conf, "--trust", "mylab_priors")
    assert "mesh has no components; remove _target_" in done.err


def test_a_target_without_a_name_is_explained(
    tactorch: Any, recording_file: Path, conf: Path
) -> None:
    words = ("invert", f"recording={recording_file}", "--config-dir", conf)
    (conf / "regularization" / "mine.yaml").rename(conf / "regularization" / "unnamed.yaml")
    done = tactorch(*words, "--trust-config-dir", "regularization=unnamed")
    assert "with --trust PACKAGE instead of --trust-config-dir" in done.err
    assert "Traceback" not in done.err


def test_colons_separate_the_class_too(conf: Path) -> None:
    targets.trust("mylab_priors")
    found = targets.load_target("mylab_priors.priors:Mine", PRIORS, "mine.yaml")
    assert found is import_module("mylab_priors.priors").Mine


def test_installed_packages_with_entry_points_are_trusted(
    conf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = EntryPoint("mine", "mylab_priors.priors:Mine", "tactorch.regularization")
    monkeypatch.setattr(targets, "entry_points", lambda: [entry])
    assert targets.load_target("mylab_priors.priors.Mine", PRIORS, "x").__name__ == "Mine"
