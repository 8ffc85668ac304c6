"""What a new user meets: usage, help, typing errors; and that it comes at once."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from tactorch.cli import COMMANDS, GROUPS, VERBS
from tactorch.cli.presets import EXPERIMENT, conf_folder, read_table
from tactorch.cli.schema import load_schema


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
    schema = load_schema(verb)
    for entry in schema.settings:
        assert f"  {entry['name'].rpartition('.')[2]}: " in done.out
    for group, chosen in schema.defaults.items():
        for option in schema.options(group):
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
def test_every_option_and_setting_has_help(verb: str) -> None:
    schema = load_schema(verb)
    for group in schema.defaults:
        for option, described in schema.options(group).items():
            assert len(described["help"]) > 10, (group, option)
            settings = [] if group == EXPERIMENT else described["settings"]
            for entry in (*settings, *schema.settings):
                assert len(entry["help"]) > 3, (group, option, entry["name"])
                assert not entry["help"].endswith("."), (group, option, entry["name"])


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
        (("simulate", "phantm.radius=1"), ("Did you mean 'phantom.radius'?",)),
        (("simulate", "phantom.depth=5"), ("phantom.depth=5: give a number above 0, below 1",)),
        (("simulate", "steps=3"), ("'steps'", "Did you mean 'press.steps'?")),
        (("simulate", "+sed=3"), ("unknown setting 'sed'", "'seed'?")),
        (("simulate", "phantom=cube_box", "phantom.depth=1"), ("phantom=cube_box: side_mm,",)),
        (("simulate", "phantom=cube_spere"), ("cube_spere is unknown", "Did you mean 'cube_sphe")),
        (("simulate", "seed"), ("'seed' is not a setting", "KEY=VALUE")),
        (("simulate", "seed=1,2"), ("several values", "add -m")),
        (("simulate", "out=a (1).h5"), ("cannot be read", "\"out='a (1).h5'\"")),
        (("simulate", "snr_db=${nothing}"), ("refers to a value that does not exist", "nothing")),
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
        (("completion", "line", "tactorch train data.folder="), (*HEAVY, *SETTINGS)),
        (("invert", "recrding=x"), HEAVY),
        (("invert",), HEAVY),
        (("sensor", "force"), HEAVY),
    ],
    ids=lambda value: " ".join(value) if value and value[0] != HEAVY[0] else "",
)
def test_what_is_quick_loads_nothing_slow(
    typed: tuple[str, ...], unwanted: tuple[str, ...], tmp_path: Path
) -> None:
    for command in COMMANDS:  # the first use of a command describes its components
        if " ".join(typed).removeprefix("completion ").split("tactorch ")[-1].startswith(command):
            load_schema(command)
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


def test_presets_are_read_as_hydra_reads_them() -> None:
    for path in conf_folder().rglob("*.yaml"):
        assert read_table(path) == OmegaConf.to_container(OmegaConf.load(path)), path


def test_the_schema_is_stored_and_renewed_when_the_code_changes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tactorch.cli import schema

    calls: list[str] = []
    content = schema.describe_command("evaluate")
    monkeypatch.setenv("TACTORCH_CACHE", str(tmp_path))
    monkeypatch.setattr(schema, "describe_command", lambda c: calls.append(c) or content)
    assert load_schema("evaluate").settings == load_schema("evaluate").settings
    assert calls == ["evaluate"]
    monkeypatch.setattr(schema, "_code_key", lambda: "0" * 16)
    load_schema("evaluate")
    assert calls == ["evaluate"] * 2
    assert len(list((tmp_path / "schema").iterdir())) == 1


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
