"""Code in the documents runs as it stands: Python as one script a page, commands as typed.

Python runs in this process, all of a page in one namespace. Commands are composed by Hydra and
their settings checked; those marked `run` are run.
"""

import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from tactorch.cli import COMMANDS, VERBS
from tactorch.cli.compose import compose_options
from tactorch.cli.overrides import expanded, named

from .blocks import DOCS, LANGUAGES, README, ROOT, Block, blocks, commands, pages

ALL = [README, *pages()]


def label(path: Path) -> str:
    return path.name if path == README else path.relative_to(DOCS).as_posix()


def of_all(*languages: str) -> list[Path]:
    return [path for path in ALL if blocks(path, *languages)]


@pytest.mark.parametrize("path", ALL, ids=label)
def test_every_block_says_what_it_is(path: Path) -> None:
    """None escapes the tests below; what is printed is text."""
    text = path.read_text()
    assert text.count("```") == 2 * len(blocks(path)), "a fence is open, or marked in another way"
    assert {block.language for block in blocks(path)} <= {*LANGUAGES}
    assert {mark for block in blocks(path) for mark in block.marks} <= {"slow", "run"}


def has(path: Path, slow: bool) -> bool:
    if path.parent.name == "stories":  # their Python needs their commands: see test_stories
        return False
    return path != README and any(block.slow == slow for block in blocks(path, "python"))


@pytest.mark.parametrize("path", [p for p in ALL if has(p, slow=False)], ids=label)
def test_python_of_a_page_runs(path: Path, folder: Path) -> None:
    run_page(path, folder, [block for block in blocks(path) if not block.slow])


@pytest.mark.slow
@pytest.mark.parametrize("path", [p for p in ALL if has(p, slow=True)], ids=label)
def test_python_of_a_page_runs_with_what_takes_long(path: Path, folder: Path) -> None:
    run_page(path, folder, blocks(path))


def run_page(path: Path, folder: Path, found: list[Block]) -> None:
    """Run a page from top to bottom; files that it shows are there."""
    names: dict[str, Any] = {"__name__": "__main__"}
    if "object.msh" in path.read_text():
        names |= measured(folder)
    for block in found:
        if block.title and block.language == "yaml":
            (folder / block.title).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.title).write_text(block.text)
        if block.language == "python":
            exec(compile(block.text, label(path), "exec"), names)


def measured(folder: Path) -> dict[str, Any]:
    """What pages call the user's own: a mesh file, and the arrays of a press."""
    from tactorch.mesh import box_mesh, write_mesh
    from tactorch.phantoms import make_phantom
    from tactorch.simulation import PressPlan, simulate

    plan = PressPlan(["z+"], [0.01], support="fixed")
    recording = simulate(make_phantom("cube_sphere"), plan, mesh=box_mesh(10.0, 2))
    write_mesh(folder / "object.msh", recording.mesh)
    (press,) = recording.presses
    fields = ("forces", "observed", "displacement", "fixed")
    return {name: np.array(getattr(press, name)) for name in fields}


# ---------------------------------------------------------------- README


OWN_DATA = "forces=forces"
README_PYTHON = blocks(README, "python")
ALONE = [block.text for block in README_PYTHON if OWN_DATA not in block.text]


def test_the_block_for_ones_own_data_runs(folder: Path) -> None:
    (own,) = (block for block in README_PYTHON if OWN_DATA in block.text)
    exec(compile(own.text, "README.md", "exec"), {"__name__": "__main__", **measured(folder)})
    assert (folder / "mine.h5").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(ALONE)))
def test_a_block_of_the_readme_runs_alone(index: int, folder: Path) -> None:
    command = [sys.executable, "-c", ALONE[index]]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert index != 0 or ("A stiff lump at" in run.stdout and (folder / "map.vtu").is_file())


# ---------------------------------------------------------------- commands


@pytest.mark.parametrize("path", of_all("sh"), ids=label)
def test_commands_can_be_given(path: Path) -> None:
    for block in blocks(path, "sh"):
        for words in commands(block):
            check(words)


def check(words: list[str]) -> None:
    """Check a command as far as it can be without running it."""
    match words:
        case ["tactorch", "--help" | "--version"]:
            pass
        case ["tactorch", *rest]:
            check_tactorch(rest)
        case ["make", target, *_]:
            assert f"\n{target}:" in (ROOT / "Makefile").read_text(), target
        case ["python", script, *_]:
            assert (ROOT / script).is_file(), script
        case ["tensorboard", "--logdir", _]:
            pass
        case ["pip", "install", *_] | ["python3", "-m", "venv", *_]:
            pass
        case _:
            pytest.fail(f"nothing is known of the command {' '.join(words)}")


def check_tactorch(words: list[str]) -> None:
    """Compose the settings as Hydra does, and check each value's kind."""
    verb = " ".join(words[:2]) if " ".join(words[:2]) in COMMANDS else words[0]
    assert verb in (*COMMANDS, *VERBS), f"tactorch {verb}"
    if verb not in COMMANDS:
        return
    typed = expanded(verb, named(verb, words[len(verb.split()) :]))
    # A folder of settings has options that are not known here.
    end = typed.index("--config-dir") if "--config-dir" in typed else len(typed)
    given = [word for word in typed[:end] if word not in ("-m", "--help")]
    for settings in zip(*combinations(given), strict=True):
        resumed = any(word.startswith("resume=") for word in settings) and verb == "invert"
        if "--help" not in words:
            compose(verb, *settings, *(["recording=of_the_run"] if resumed else []))


@cache
def compose(verb: str, *settings: str) -> None:
    """Compose a command, which stands on many pages, once."""
    compose_options(verb, [*settings])


def combinations(given: list[str]) -> list[list[str]]:
    """Each setting's values in a sweep, as many as the longest has."""
    parsed = OverridesParser.create().parse_overrides(given)
    values = [
        [f"{o.key_or_group}={v}" for v in o.sweep_string_iterator()]
        if o.is_sweep_override()
        else [word]
        for word, o in zip(given, parsed, strict=True)
    ]
    longest = max((len(v) for v in values), default=1)
    return [[v[min(i, len(v) - 1)] for i in range(longest)] for v in values] or [[]]


def runnable(path: Path) -> list[Block]:
    return [block for block in blocks(path, "sh") if "run" in block.marks]


@pytest.mark.slow
@pytest.mark.parametrize("path", [path for path in ALL if runnable(path)], ids=label)
def test_commands_run(path: Path, folder: Path) -> None:
    for block in blocks(path, "yaml"):
        if block.title:
            (folder / block.title).write_text(block.text)
    for block in runnable(path):
        for words in commands(block):
            run_command(words)


def run_command(words: list[str]) -> str:
    """Run `tactorch ...` here; return what it said."""
    run = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True)
    assert run.returncode == 0, f"{' '.join(words)}\n{run.stdout}\n{run.stderr}"
    return run.stdout + run.stderr


@pytest.mark.slow
def test_a_newcomers_path(folder: Path) -> None:
    """Twenty samples, two epochs, an inversion with the warm start; then what they leave."""
    (path,) = (
        commands(block)
        for block in blocks(DOCS / "howto" / "datasets.md", "sh")
        if block.text.startswith("tactorch generate dataset=warmstart")
    )
    assert [words[1] for words in path] == ["generate", "train", "simulate", "invert"]
    said = [run_command(words) for words in path]
    assert "surrogate's map is taken" in said[-1]
    (found,) = (folder / "outputs" / "invert").glob("*/summary.json")
    assert '"start_mpa": "surrogate"' in found.read_text()
