"""Components of other packages: imported only where they are chosen; a broken one costs itself."""

import importlib
import inspect
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli import doctor, plug_ins, schema
from tactorch.config import registry
from tactorch.inverse import PRIORS

SOUND = '''
from dataclasses import dataclass
from tactorch.config import option
from tactorch.inverse import Tikhonov

@dataclass(frozen=True, kw_only=True)
class plug(Tikhonov):
    """A prior of another package."""

    share: float = option(2.0, "A share")
'''
BROKEN = {
    "an_object": ("plug = object()", "plug_an_object:plug is no prior"),
    "a_class": ("class plug: pass", "plug_a_class:plug is no prior"),
    "a_function": ("def plug(): pass", "plug_a_function:plug is no prior"),
    "raises": ("raise RuntimeError('broken\\nat import')", "(RuntimeError: broken at import)"),
    "absent": ("import a_package_that_is_absent", "(ModuleNotFoundError: No module named"),
    "own_error": ("class E(BaseException): pass\nraise E('odd')", "(E: odd)"),
    "exits": ("import sys; sys.exit(3)", "(SystemExit: 3)"),
    "prints": ("print('hello'); raise ValueError('no')", "(ValueError: no)"),
    "unknown_type": (
        SOUND.replace("share: float", "share: 'Nothing'"), "has settings that cannot be read"
    ),
}  # fmt: skip
DOUBLED = "plug_doubled:plug"


def install(site: Path, name: str, body: str, choice: str = "") -> Path:
    """Write a distribution with one entry point, as pip would install it."""
    information = site / f"plug_{name}-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: plug-{name}\nVersion: 1\n")
    entry = f"[tactorch.regularization]\n{choice or name} = plug_{name}:plug\n"
    (information / "entry_points.txt").write_text(entry)
    (site / f"plug_{name}.py").write_text(body)
    return site / f"plug_{name}.py"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages, and an empty cache."""
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    registry.entry_points.cache_clear()  # other tests share one result
    monkeypatch.setattr(schema, "_code_key", inspect.unwrap(schema._code_key))
    yield folder
    registry.entry_points.cache_clear()
    for name in [name for name in sys.modules if name.startswith("plug_")]:
        del sys.modules[name]


@pytest.fixture
def broken(site: Path) -> Path:
    for name, (body, _) in BROKEN.items():
        install(site, name, body)
    install(site, "never_ends", "while True: pass")
    install(site, "doubled", SOUND, choice="smoothness")
    return site


def test_nothing_is_imported_for_other_choices(
    tactorch: Any, broken: Path, recording_file: Path
) -> None:
    done = tactorch("invert", "--help")
    assert done.status == 0, done.err
    for name in (*BROKEN, "never_ends"):
        assert f"{name}  " in done.out
        assert f"Of the package plug-{name} (plug_{name}:plug)" in done.out
    done = tactorch("invert", f"recording={recording_file}", "--cfg", "job")
    assert done.status == 0, done.err
    assert "hello" not in done.out
    assert not [name for name in sys.modules if name.startswith("plug_")]


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_one_is_named_where_it_is_chosen(
    tactorch: Any, broken: Path, recording_file: Path, name: str
) -> None:
    words = ("invert", f"recording={recording_file}", f"regularization={name}")
    for more in ((), ("regularization.share=3",)):
        done = tactorch(*words, *more)
        assert done.status == 2
        assert BROKEN[name][1] in done.err
        assert f"plug-{name}" in done.err
        assert "Traceback" not in done.err
        assert "hello" not in done.out
        assert len(done.err.strip().splitlines()) == 1 + ("hello" in done.err)
    shown = " ".join(tactorch("invert", f"regularization={name}", "--help").out.split())
    assert BROKEN[name][1] in shown


def test_a_sound_one_has_its_settings(tactorch: Any, site: Path, recording_file: Path) -> None:
    install(site, "sound", SOUND)
    words = ("invert", f"recording={recording_file}", "regularization=sound")
    done = tactorch(*words, "regularization.share=3", "--cfg", "job")
    assert done.status == 0, done.err
    assert "share: 3" in done.out
    assert "Did you mean 'regularization.share'" in tactorch(*words, "regularization.shar=3").err
    shown = tactorch("invert", "regularization=sound", "--help").out
    assert "A prior of another package" in shown
    assert "A share" in shown
    preset = site.parent / "conf" / "regularization" / "mine.yaml"
    preset.parent.mkdir(parents=True)
    preset.write_text("name: sound\nshare: 7\n")
    chosen = (*words[:2], "--config-dir", preset.parents[1], "regularization=mine", "--cfg", "job")
    assert "share: 7" in tactorch(*chosen).out


def test_it_works_once_it_is_repaired(tactorch: Any, site: Path, recording_file: Path) -> None:
    module = install(site, "sound", SOUND.replace("import Tikhonov", "import Tikhonow"))
    words = ("invert", f"recording={recording_file}", "regularization=sound")
    words = (*words, "regularization.share=3", "--cfg", "job")
    for _ in range(2):
        assert "cannot import name 'Tikhonow'" in tactorch(*words).err
    module.write_text(SOUND)
    later = module.stat().st_mtime + 5.0  # kept bytecode has the time in seconds
    os.utime(module, (later, later))
    importlib.invalidate_caches()
    done = tactorch(*words)
    assert done.status == 0, done.err
    assert "share: 3" in done.out


def test_a_name_of_tactorch_is_not_replaced(broken: Path) -> None:
    assert PRIORS["smoothness"].__module__.startswith("tactorch.")
    assert "smoothness" not in PRIORS.plugins()


def test_damaged_distributions_are_named(tactorch: Any, site: Path) -> None:
    for name in ("nameless", "damaged", "sound"):
        install(site, name, SOUND)
    nameless, damaged, sound = (
        site / f"plug_{name}-1.0.dist-info" for name in ("nameless", "damaged", "sound")
    )
    (nameless / "METADATA").write_text("Metadata-Version: 2.1\nVersion: 1\n")
    (damaged / "METADATA").write_bytes(b"\xff\xfe")
    found = plug_ins.installed()
    for place in (nameless, damaged):
        name = place.name.removesuffix("-1.0.dist-info")
        assert f"without a name in '{place}' ({name}:plug)" in found
    assert "plug-sound (plug_sound:plug)" in found
    (sound / "entry_points.txt").write_bytes(b"\xff\xfe[tactorch.regularization\n")
    registry.entry_points.cache_clear()
    done = tactorch("invert", "recording=a.h5")
    assert done.status == 2
    assert "entry_points.txt of the package plug-sound cannot be read" in done.err
    (finding,) = doctor._plug_ins()
    assert finding.works is False
    assert "plug-sound" in finding.message


@pytest.mark.slow
def test_the_doctor_imports_them_in_other_processes(broken: Path) -> None:
    install(broken, "ends_all", "import os; os._exit(4)")
    install(broken, "sound", SOUND)
    found = plug_ins.check(plug_ins.installed())
    for name, (_, reason) in BROKEN.items():
        assert reason in found[f"plug-{name} (plug_{name}:plug)"]
    assert "does not end within 5 s" in found["plug-never_ends (plug_never_ends:plug)"]
    assert "ends the process with status 4" in found["plug-ends_all (plug_ends_all:plug)"]
    assert "smoothness is the name of a component" in found[f"plug-doubled ({DOUBLED})"]
    assert found["plug-sound (plug_sound:plug)"] == ""
