"""Continuing a run: its folder holds the settings it was started with.

A run folder is data that people exchange. Its settings are taken only where they are known ones of
the command, with plain values; settings of Hydra, by which a file could run any function, are
refused.
"""

import os
import sys
from pathlib import Path
from typing import Any

from tactorch.budget import check_references
from tactorch.cli.compose import build_options
from tactorch.cli.overrides import check_overrides, key_of
from tactorch.cli.presets import PROGRAM
from tactorch.cli.schema import Schema, app_name
from tactorch.config.values import leaves
from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.files import read_yaml, require_file, require_folder

CHECKPOINT = "checkpoint.npz"
# Files that show that a run of a command got as far as having a state.
_STATES = {
    "invert": (CHECKPOINT,),
    "demo": (CHECKPOINT,),
    "train": ("last.ckpt", "split-*/last.ckpt"),
}
_INPUT_PATHS = ("recording", "path", "data.folder", "initialization.weights")


def with_resume(schema: Schema, words: list[str], *, multirun: bool = False) -> list[str]:
    """Return the settings of the run in `resume=RUN`, changed by the given ones.

    A run that was stopped before its first checkpoint starts from the beginning.
    """
    chosen = [word.split("=", 1)[1] for word in words if key_of(word) == "resume"]
    if schema.command not in _STATES or not chosen or chosen[-1] in ("", "null"):
        return words
    if multirun:
        raise ConfigError("resume continues one run; leave out -m.")
    run = require_folder(chosen[-1].strip("'\""), "run to resume")
    earlier, started_in = _read_start(schema.command, run)
    if not has_state(schema.command, run):
        notice = f"'{run}' was stopped before its first checkpoint; it starts from the beginning."
        print(notice, file=sys.stderr)
        words = [word for word in words if key_of(word) != "resume"]
    typed = {*map(key_of, words), "resume"}
    repeated = [word for word in earlier if key_of(word) not in {*typed, "run_dir"}]
    path = run / ".hydra" / "overrides.yaml"
    try:
        for word in repeated:
            if PROGRAM.search(word):
                raise ConfigError(f"'{word}' is no plain value.")
        check_references(path, repeated)
        # The given settings may choose other options.
        checked = check_overrides(schema, [*repeated, *words], trusted=False)[: len(repeated)]
    except ConfigError as error:
        raise ConfigError(
            f"'{path}' holds more than plain settings of tactorch {schema.command}: {error} Remove "
            "it from that file if you trust the rest, or start the run again."
        ) from error
    here = [] if "run_dir" in typed else [f"run_dir='{run}'"]
    return [*(_moved(word, Path(started_in)) for word in checked), *words, *here]


def _read_start(command: str, run: Path) -> tuple[list[str], str]:
    """Return the settings as typed, and the folder in which a run was started."""
    place = run / ".hydra"
    words, hydra = _load(place / "overrides.yaml"), _load(place / "hydra.yaml")
    try:
        name, started_in = hydra["hydra"]["job"]["name"], hydra["hydra"]["runtime"]["cwd"]
        is_sound = isinstance(words, list) and all(isinstance(w, str) for w in (*words, started_in))
    except (KeyError, TypeError):
        is_sound = False
    if not is_sound:
        raise FileError(f"'{place}' does not hold a run's settings; start the run again.")
    if name != app_name(command):
        raise ConfigError(f"'{run}' is a run of {name}; continue it with tactorch {name}.")
    return words, started_in


def command_of(folder: Path) -> str | None:
    """Return the name of the command whose run, or sweep, a folder holds; None if it holds none."""
    paths = folder / ".hydra" / "hydra.yaml", folder / "multirun.yaml"
    path = next((path for path in paths if path.is_file()), None)
    try:
        return None if path is None else str(_load(path)["hydra"]["job"]["name"])
    except (FileError, KeyError, TypeError):
        return None


def has_state(command: str, run: Path) -> bool:
    """Return whether a run of a command got as far as having a state to go on from."""
    return any(any(run.glob(pattern)) for pattern in _STATES.get(command, ()))


def saved_options(command: str, run: Path) -> Any:
    """Return the typed options that a run folder holds."""
    from omegaconf import OmegaConf

    path = run / ".hydra" / "config.yaml"
    content = _load(path)
    if not isinstance(content, dict):
        raise FileError(f"'{path}' does not hold a run's settings; start the run again.")
    settings = [f"{name}={value}" for name, value in leaves(content)]
    check_references(path, settings)
    for setting in settings:
        if PROGRAM.search(setting):
            raise FileError(
                f"'{path}': {setting} is no plain value; write the value itself, or start the run "
                "again."
            )
    return build_options(command, OmegaConf.create(content))


def _load(path: Path) -> Any:
    from omegaconf import OmegaConf

    require_file(path, "settings of the run")
    try:
        read_yaml(path, f"'{path}'")  # bounded, as OmegaConf is not
        return OmegaConf.to_container(OmegaConf.load(path))
    except TactorchError:
        raise
    except Exception as error:  # whatever a damaged YAML file leads to
        reason = " ".join(str(error).split())
        raise FileError(f"'{path}' cannot be read ({reason}); start the run again.") from error


def _moved(word: str, started_in: Path) -> str:
    """Return a setting whose relative path, of a file that is read, points where it did before."""
    key, _, value = word.partition("=")
    path = value.strip("'\"")
    if key not in _INPUT_PATHS or os.path.isabs(path) or Path.cwd() == started_in:
        return word
    return f"{key}='{os.path.relpath(started_in / path)}'"
