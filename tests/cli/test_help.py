"""What a new user meets: usage, help, typing errors; and that it comes at once."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tactorch.cli import COMMANDS, GROUPS, VERBS
from tactorch.cli.catalog import Catalog, _parse, conf_folder
from tactorch.cli.kinds import KINDS
from tactorch.reproduce.studies import STUDIES


def test_usage_names_every_command(tactorch: Any) -> None:
    for arguments in ((), ("--help",)):
        done = tactorch(*arguments)
        assert done.status == 0
        assert all(f"tactorch {verb}" in done.out for verb in VERBS)


@pytest.mark.parametrize("group", GROUPS)
def test_commands_of_a_verb_are_listed(tactorch: Any, group: str) -> None:
    for arguments in ((group,), (group, "--help"), (group, "help"), ("--help",)):
        done = tactorch(*arguments)
        assert done.status == 0
        for command, text in GROUPS[group].items():
            assert f"tactorch {group} {command} " in done.out
            assert text in done.out
    assert not list(Path().iterdir())


def test_versions_are_told(tactorch: Any) -> None:
    out = tactorch("--version").out
    assert "tactorch" in out
    assert "torch" in out
    for arguments in (("version",), ("-V",), ("invert", "--version")):
        assert tactorch(*arguments).out == out


@pytest.mark.parametrize("verb", COMMANDS)
def test_help_teaches(tactorch: Any, verb: str) -> None:
    done = tactorch(*verb.split(), "--help")
    assert done.status == 0
    catalog = Catalog(verb)
    for name in catalog.settings:
        assert f"  {name}:" in done.out
    for group, chosen in catalog.defaults.items():
        for option in catalog.options(group):
            assert f" {option}" in done.out
        assert chosen is None or f"* {chosen}" in done.out
    assert "hydra:" not in done.out
    assert max(map(len, done.out.splitlines())) <= 110


def test_help_follows_the_chosen_option(tactorch: Any) -> None:
    out = tactorch("invert", "optimizer=tnc", "--help").out
    assert "max_evaluations" in out
    assert "* scaled" in out  # which this optimizer chooses
    assert not Path("outputs").exists()


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_option_says_what_it_is(verb: str) -> None:
    catalog = Catalog(verb)
    for group in catalog.defaults:
        for option in catalog.options(group):
            assert len(catalog.about(group, option)) > 10, (group, option)


@pytest.mark.parametrize("verb", COMMANDS)
def test_kind_of_every_setting_is_known(verb: str) -> None:
    catalog = Catalog(verb)
    tables = {"bounds", "noise", "family", "presses", "sizes", "suggest"}
    tables |= {*STUDIES, *catalog.defaults}
    keys = set(catalog.settings)
    for group in catalog.defaults:
        for option in catalog.options(group):
            keys |= set(catalog.keys({group: option}))
    # What belongs to a name beside it is checked there.
    keys = {k for k in keys if ".parameters." not in k and not k.startswith("dataset.family.")}
    unknown = {key for key in keys if not {key, key.split(".")[-1]} & set(KINDS)}
    assert {key.split(".")[-1] for key in unknown} <= tables


def test_optimizer_of_the_paper_brings_its_own_choices(tactorch: Any) -> None:
    for choice in ("optimizer=tnc", "experiment=paper"):
        out = tactorch("invert", "recording=x.h5", choice, "--cfg", "job").out
        assert "parameterization:\n  name: scaled" in out
        assert "regularization:\n  name: none" in out
    out = tactorch("invert", "recording=x", "optimizer=tnc", "parameterization=log", "--cfg", "job")
    assert "parameterization:\n  name: log" in out.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("simlate",), ("'simlate' is not a command", "Did you mean 'simulate'?")),
        (("INVERT",), ("Did you mean 'invert'?",)),
        (("--versio",), ("Did you mean '--version'?",)),
        (("calibrate",), ("Did you mean 'sensor calibrate'?",)),
        (("phantom=cube_box",), ("a command comes first", "tactorch simulate phantom=cube_box")),
        (("simulate", "--verbose"), ("--verbose", "KEY=VALUE", "tactorch simulate --help")),
        (("simulate", "--cfg", "nothing"), ("--cfg", "'nothing'", "'job'")),
        (("invert", "."), ("'.' is not a setting", "perhaps recording=.")),
        (("invert", "recording="), ("recording=''", "give a path")),
        (("sensor", "calibrat"), ("'calibrat' is not one of", "Did you mean 'calibrate'?")),
        (("sensor", "sensor=x"), ("'sensor=x' is not one of", "choose one of calibrate, check")),
        (("sensor", "track", "frame=x"), ("unknown setting 'frame'", "Did you mean 'frames'?")),
        (("sensor", "track"), ("'sensor' is missing", "tactorch sensor track --help")),
        (("simulate", "phantm=x"), ("unknown setting 'phantm'", "'phantom'?", "--help")),
        (("simulate", "phantom.raduis=1"), ("'phantom.raduis'", "Did you mean 'phantom.radius'?")),
        (("simulate", "steps=3"), ("'steps'", "Did you mean 'press.steps'?")),
        (("simulate", "+sed=3"), ("unknown setting 'sed'", "'seed'?")),
        (("simulate", "phantom=cube_box", "phantom.depth=1"), ("cube_box: center, size",)),
        (("simulate", "phantom=cube_spere"), ("cube_spere is unknown", "Did you mean 'cube_sphe")),
        (("simulate", "seed"), ("'seed' is not a setting", "KEY=VALUE")),
        (("simulate", "seed=1,2"), ("several values", "add -m")),
        (("simulate", "out=a (1).h5"), ("cannot be read", "\"out='a (1).h5'\"")),
        (("simulate", "snr_db=${nothing}"), ("refers to what is not there", "nothing")),
        (("simulate", "--config-name", "nothing"), ("nothing",)),
        (("invert", "-m", "resume=x"), ("leave out -m",)),
    ],
)
def test_mistyped_command_gets_one_line(
    tactorch: Any, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    done = tactorch(*arguments)
    assert done.status == 2
    assert done.err.startswith("tactorch")
    assert len(done.err.splitlines()) == 1
    for word in words:
        assert word in done.err


def test_nothing_is_left_of_a_command_that_did_not_begin(tactorch: Any) -> None:
    tactorch("simulate", "phantm=x")
    tactorch("simulate", "--help")
    assert not list(Path().iterdir())


# By the modules that are loaded, as a time would depend on the machine.
HEAVY = (
    *("torch", "numpy", "scipy", "numba", "h5py", "matplotlib", "lightning", "cv2", "skimage"),
    *("tensorboard", "rich", "pyvista", "vtk", "meshio", "pyamg", "dask", "pytetwild", "pypardiso"),
)
SETTINGS = ("hydra", "omegaconf", "antlr4")


@pytest.mark.parametrize(
    ("typed", "unwanted"),
    [
        ((), (*HEAVY, *SETTINGS, "yaml", "logging")),
        (("--help",), (*HEAVY, *SETTINGS, "yaml", "logging")),
        (("--version",), (*HEAVY, *SETTINGS, "yaml")),
        (("simlate",), (*HEAVY, *SETTINGS, "yaml")),
        (("sensor",), (*HEAVY, *SETTINGS, "yaml")),
        (("doctor", "--help"), (*HEAVY, *SETTINGS, "yaml")),
        (("invert", "--help"), (*HEAVY, *SETTINGS)),
        (("sensor", "force", "--help"), (*HEAVY, *SETTINGS)),
        (("completion", "bash"), (*HEAVY, *SETTINGS)),
        (("completion", "line", "tactorch invert optimizer.tol"), (*HEAVY, *SETTINGS)),
        (("completion", "words", "train", "data.folder="), (*HEAVY, *SETTINGS)),
        (("invert", "recrding=x"), HEAVY),
        (("invert",), HEAVY),
        (("sensor", "force"), HEAVY),
    ],
    ids=lambda value: " ".join(value) if value and value[0] != HEAVY[0] else "",
)
def test_what_is_quick_loads_nothing_slow(
    typed: tuple[str, ...], unwanted: tuple[str, ...], tmp_path: Path
) -> None:
    code = (
        "import sys\n"
        "from tactorch.cli import main\n"
        f"try: main({list(typed)!r})\n"
        "except SystemExit: pass\n"
        f"loaded = set({list(unwanted)!r}) & set(sys.modules)\n"
        "assert not loaded, loaded\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr


def test_help_of_a_verb_may_be_asked_for_either_way(tactorch: Any) -> None:
    for verb in ("invert", "sensor", "sensor track", "doctor", "completion"):
        words = verb.split()
        done = tactorch("help", *words)
        assert done.status == 0
        assert done.out == tactorch("--help", *words).out
        assert done.out == tactorch(*words, "--help").out
        assert f"tactorch {verb}" in done.out
    assert tactorch("help", "invrt").status == 2


def test_settings_are_read_as_hydra_reads_them() -> None:
    # The catalog has its own way, which is quicker.
    for path in conf_folder().rglob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        assert _parse(text) == OmegaConf.to_container(OmegaConf.create(text)), path


def test_module_is_the_command(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tactorch", "invert"],
        capture_output=True, text=True, timeout=60, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert "recording=..." in done.stderr
    assert "Traceback" not in done.stderr


def test_reader_that_leaves_early_is_no_error(tmp_path: Path) -> None:
    command = f"{sys.executable} -m tactorch demo --help | head -1"
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert done.stdout.startswith("tactorch demo")
    assert done.stderr == ""
