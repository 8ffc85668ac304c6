"""What TAB offers, asked of the function, and of the shells themselves where they are installed."""

import os
import pty
import select
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli import COMMANDS, GROUPS, VERBS
from tactorch.cli.completion import SHELLS, completed, script, typed
from tactorch.cli.schema import load_schema


def offered(line: str) -> list[str]:
    return list(completed(typed(f"tactorch {line}")))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with some files."""
    folder = tmp_path / "work"
    (folder / "runs" / "tnc").mkdir(parents=True)
    for name in ("ball.h5", "my ball.h5", "a (1).h5", ".hidden.h5"):
        (folder / name).touch()
    monkeypatch.chdir(folder)
    return folder


def test_verbs_and_commands_of_groups() -> None:
    assert offered("") == list(VERBS)
    assert offered("inv") == ["invert"]
    assert offered("evaluate") == ["evaluate", "evaluate-model"]
    for group, commands in GROUPS.items():
        assert offered(f"{group} ") == list(commands)
    assert offered("help si") == ["simulate"]
    assert offered("completion ") == list(SHELLS)
    assert offered("--v") == ["--version"]
    assert offered("nonsense ") == []


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_setting_can_be_reached(verb: str) -> None:
    schema = load_schema(verb)
    top = [entry["name"] for entry in schema.settings if "." not in entry["name"]]
    assert {f"{key}=" for key in (*top, *schema.defaults)} <= set(offered(f"{verb} "))
    for key in schema.entries(schema.choices(())):
        table = key.rpartition(".")[0]
        assert f"{key}=" in offered(f"{verb} {table + '.' if table else ''}")


def test_tables_are_listed_in_the_order_of_the_settings() -> None:
    tables = [key for key in offered("live ") if key.endswith(".")]
    assert tables[:6] == ["suggest.", "robot.", "stop.", "bounds.", "noise.", "newton."]


def test_settings_of_the_chosen_option_and_not_twice() -> None:
    assert "optimizer.max_evaluations=" in offered("invert optimizer=tnc optimizer.")
    assert "optimizer.max_evaluations=" not in offered("invert optimizer.")
    assert offered("invert recor") == ["recording="]
    assert offered("invert recording=x.h5 recor") == []
    assert offered("invert bounds.") == ["bounds.lower=", "bounds.upper="]


def test_choices_of_groups_in_lists_and_sweeps_too() -> None:
    assert offered("invert optimizer=") == [
        f"optimizer={name}" for name in load_schema("invert").options("optimizer")
    ]
    assert offered("simulate phantom=cube_sp") == ["phantom=cube_sphere"]
    assert offered("invert -m optimizer=tnc,ne") == ["optimizer=tnc,newton_cg"]
    assert offered("train experiment=") == [
        f"experiment={name}" for name in ("recognizer", "surrogate")
    ]
    description = completed(["invert", "optimizer=tnc"])["optimizer=tnc"]
    assert description == load_schema("invert").options("optimizer")["tnc"]["help"]


def test_values_of_settings_with_choices() -> None:
    assert offered("invert element=") == ["element=tet4", "element=tet10"]
    assert offered("invert misfit=") == ["misfit=squares", "misfit=huber", "misfit=adaptive"]
    assert offered("sensor record untouched=") == [
        f"untouched={name}" for name in ("unseen", "sensor", "auto")
    ]
    assert offered("invert plots=") == ["plots=true", "plots=false"]
    assert offered("invert --cfg ") == ["job", "hydra", "all"]
    assert offered("invert --h") == ["--help"]


def test_a_value_alone_where_a_command_takes_one() -> None:
    assert offered("reproduce tab") == ["table1", "table2"]
    assert offered("reproduce exhibit=tab") == ["exhibit=table1", "exhibit=table2"]
    assert offered("reproduce table1 tab") == []


def test_files_where_a_path_is_wanted(place: Path) -> None:
    # Hydra would want quotes about the name with brackets.
    files = ["recording=ball.h5", "recording=my ball.h5", "recording=runs/"]
    assert offered("invert recording=") == files
    assert offered("invert recording=.h") == ["recording=.hidden.h5"]
    assert offered("invert recording=runs/") == ["recording=runs/tnc/"]
    assert offered(f"evaluate run={place}/ru") == [f"run={place}/runs/"]
    assert offered("invert compare=[runs/") == ["compare=[runs/tnc/"]
    assert offered("invert recording=absent/") == []
    assert offered("invert seed=") == []
    assert offered("sensor track sensor=gelsight_mi") == ["sensor=gelsight_mini"]


def test_line_is_read_as_a_shell_does(place: Path) -> None:
    assert typed("tactorch invert ") == ["invert", ""]
    assert typed("tactorch invert re") == ["invert", "re"]
    assert offered("invert recording=my\\ ") == ["recording=my ball.h5"]
    assert typed("tactorch invert 'recording=my") == []


def test_command_prints_candidates_and_scripts(tactorch: Any) -> None:
    assert tactorch("completion", "words", "inv").out.split("\t")[0] == "invert"
    assert tactorch("completion", "line", "tactorch inv").out.split("\t")[0] == "invert"
    for shell in SHELLS:
        assert tactorch("completion", shell).out == script(shell)
    for words in (("tcsh",), (), ("bash", "zsh")):
        done = tactorch("completion", *words)
        assert done.status == 2
        assert "choose one of bash, zsh, fish" in done.err
        assert len(done.err.splitlines()) == 1


# ---------------------------------------------------------------- in the shells


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Return an environment with the command in its path."""
    command = tmp_path / "bin" / "tactorch"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m tactorch "$@"\n')
    command.chmod(0o755)
    path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
    home = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    return {**os.environ, **home, "PATH": path, "TERM": "dumb", "COLUMNS": "400"}


needs = {
    shell: pytest.mark.skipif(not shutil.which(shell), reason=f"there is no {shell} here")
    for shell in SHELLS
}
# What is typed, with TAB as it is, and what then stands there.
TYPED = [
    ("inve\trecordi\tba\t", "invert recording=ball.h5"),
    ("simulate phantom=cube_sp\t", "simulate phantom=cube_sphere"),
    ("sen\tcalib\tsens\tgelsight_mi\t", "sensor calibrate sensor=gelsight_mini"),
    ("invert optimizer=g\toptim\ttol\t1", "invert optimizer=gauss_newton optimizer.tolerance=1"),
    ("invert recording=my\t", "invert recording=my ball.h5"),
    ("invert -m optimizer=tnc,ne\t", "invert -m optimizer=tnc,newton_cg"),
    ("invert recording=ru\ttn\t", "invert recording=runs/tnc/"),
    ("invert optim\tx", "invert optimizerx"),
]  # fmt: skip


@needs["bash"]
def test_bash_is_given_what_it_replaces(place: Path, environment: Mapping[str, str]) -> None:
    lines = {
        "tactorch inv": ["invert "],
        "tactorch invert recordi": ["recording="],
        "tactorch invert recording=my": ["my\\ ball.h5 "],
        "tactorch sensor cal": ["calibrate "],
        "tactorch invert bounds.l": ["bounds.lower="],
    }
    begin = r"""
        COMP_WORDS=(tactorch) COMP_WORDBREAKS=$' \t\n"\'><=;|&(:'  # as at a terminal
        eval "$(tactorch completion bash)"
    """
    asked = [
        f"COMP_LINE={shlex.quote(line)}; COMP_POINT={len(line)}; _tactorch\n"
        'printf "%s|" "${COMPREPLY[@]}"; echo\n'
        for line in lines
    ]
    ask = begin + "".join(asked)
    done = subprocess.run(
        ["bash", "--norc", "-c", ask], env=environment, capture_output=True, text=True, timeout=60
    )
    assert [line.split("|")[:-1] for line in done.stdout.splitlines()] == list(lines.values())


@needs["bash"]
def test_bash_completes_what_is_typed(place: Path, environment: Mapping[str, str]) -> None:
    begin = 'eval "$(tactorch completion bash)"'
    check_typed(["bash", "--norc", "--noprofile", "-i"], begin, environment)


@needs["zsh"]
def test_zsh_completes_what_is_typed(place: Path, environment: Mapping[str, str]) -> None:
    begin = 'autoload -Uz compinit; compinit -u -D; eval "$(tactorch completion zsh)"'
    check_typed(["zsh", "-f", "-i"], begin, environment)


@needs["fish"]
def test_fish_is_offered_the_same(place: Path, environment: Mapping[str, str]) -> None:
    for line in ("inv", "invert optimizer=", "invert recording=my", "sensor cal", "invert bounds."):
        ask = f"tactorch completion fish | source; complete -C {shlex.quote(f'tactorch {line}')}"
        done = subprocess.run(
            ["fish", "--no-config", "-c", ask],
            env=environment, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        given = [answer.split("\t")[0] for answer in done.stdout.splitlines()]
        assert given == offered(line), done.stderr


def check_typed(shell: list[str], begin: str, environment: Mapping[str, str]) -> None:
    """Type into an interactive shell; let it print the lines as they then stand there."""
    keys = [begin, *(f"tactorch {text}\x01echo GOT: " for text, _ in TYPED), "exit"]
    screen = typed_into(shell, "\n".join(keys) + "\n", environment)
    lines = screen.replace("\r", "\n").splitlines()
    found = [line.removeprefix("GOT: tactorch ") for line in lines if line.startswith("GOT: ")]
    assert [line.strip() for line in found] == [after for _, after in TYPED], screen


def typed_into(shell: list[str], keys: str, environment: Mapping[str, str]) -> str:
    """Return what a shell at a terminal shows for keys typed ahead; they end it."""
    child, terminal = pty.fork()
    if child == 0:
        os.execvpe(shell[0], shell, environment)
    os.write(terminal, keys.encode())
    screen, end = b"", time.monotonic() + 60
    while time.monotonic() < end:
        if not select.select([terminal], [], [], 1.0)[0]:
            continue
        try:
            screen += os.read(terminal, 65536)
        except OSError:  # the shell has gone
            break
    else:
        os.kill(child, 9)
    os.close(terminal)
    os.waitpid(child, 0)
    return screen.decode(errors="replace")
