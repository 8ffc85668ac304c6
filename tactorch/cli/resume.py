"""Continuing a run: its folder remembers the settings it was started with."""

import os
import sys
from pathlib import Path
from typing import Any

from tactorch.errors import ConfigError, FileError
from tactorch.files import require_file, require_folder

CHECKPOINT = "checkpoint.npz"
# Files that show that a run of a command got as far as having a state.
_STATES = {
    "invert": (CHECKPOINT,),
    "demo": (CHECKPOINT,),
    "train": ("last.ckpt", "split-*/last.ckpt"),
}


def with_resume(verb: str, settings: list[str]) -> list[str]:
    """Let `resume=RUN` repeat that run's settings in its folder; the given ones win.

    A run that was stopped before its first checkpoint starts anew.

    Raises:
        FileError: it is not a run folder.
        ConfigError: it is a run of another command, or several runs are asked for.
    """
    chosen = [s.split("=", 1)[1] for s in settings if s.startswith("resume=")]
    if verb not in _STATES or not chosen or chosen[-1] in ("", "null"):
        return settings
    if {"-m", "--multirun"} & set(settings):
        raise ConfigError("resume continues one run; leave out -m.")
    return _repeated(verb, Path(chosen[-1].strip("'\"")), settings)


def _repeated(verb: str, run: Path, settings: list[str]) -> list[str]:
    require_folder(run, "run to resume")
    earlier = _load(run, "overrides.yaml")
    hydra = _load(run, "hydra.yaml")
    if not isinstance(earlier, list) or not isinstance(hydra, dict):
        raise FileError(f"'{run / '.hydra'}' does not hold a run's settings; start the run anew.")
    made_by = hydra["hydra"]["job"]["name"]
    if made_by != verb:
        raise ConfigError(f"'{run}' is a run of {made_by}; continue it with tactorch {made_by}.")
    if not has_state(verb, run):
        notice = f"'{run}' was stopped before its first checkpoint; it starts anew."
        print(notice, file=sys.stderr)
        settings = [s for s in settings if _key(s) != "resume"]
    given = {_key(setting) for setting in settings}
    kept = [s for s in earlier if _key(s) not in {*given, "resume", "run_dir"}]
    kept = [_moved(s, Path(hydra["hydra"]["runtime"]["cwd"])) for s in kept]
    here = [] if "run_dir" in given else [f"run_dir='{run}'"]
    return [*kept, *settings, *here]


def has_state(verb: str, run: Path) -> bool:
    """Whether a run of a command got as far as having a state to go on from."""
    return any(any(run.glob(pattern)) for pattern in _STATES.get(verb, ()))


def _load(run: Path, name: str) -> Any:
    from omegaconf import OmegaConf

    path = require_file(run / ".hydra" / name, "settings of the run to resume")
    try:
        return OmegaConf.to_container(OmegaConf.load(path))
    except Exception as error:  # whatever a damaged YAML file leads to
        raise FileError(f"'{path}' cannot be read ({error}); start the run anew.") from error


def _moved(setting: str, started_in: Path) -> str:
    """Keep a relative path of what is read pointing where it did when the run was started."""
    key, value = setting.split("=", 1) if "=" in setting else (setting, "")
    path = value.strip("'\"")
    if (
        key not in ("recording", "path", "data.folder", "initialization.weights")
        or os.path.isabs(path)
        or Path.cwd() == started_in
    ):
        return setting
    return f"{key}='{os.path.relpath(started_in / path)}'"


def _key(setting: str) -> str:
    return setting.split("=", 1)[0].lstrip("+~")


def checkpoint_of(run: str | Path) -> Path:
    """Return the checkpoint in a run folder."""
    return Path(run) / CHECKPOINT
