"""Continuing a run: its folder remembers the settings it was started with."""

from pathlib import Path

from tactorch.errors import FileError
from tactorch.files import require_file, require_folder

CHECKPOINT = "checkpoint.npz"


def settings_of(run: Path, settings: list[str]) -> list[str]:
    """Return the settings of a run folder followed by the given ones, set to go on in it.

    Raises:
        FileError: it is not a run folder, or holds no checkpoint.
    """
    from omegaconf import OmegaConf

    require_folder(run, "run to resume")
    require_file(run / CHECKPOINT, "checkpoint of the run to resume")
    saved = require_file(run / ".hydra" / "overrides.yaml", "settings of the run to resume")
    earlier = OmegaConf.to_container(OmegaConf.load(saved))
    if not isinstance(earlier, list):
        raise FileError(f"'{saved}' holds no list of settings; start the run anew.")
    given = {s.split("=", 1)[0].lstrip("+~") for s in settings}
    kept = [s for s in earlier if s.split("=", 1)[0].lstrip("+~") not in {*given, "resume"}]
    here = [] if "run_dir" in given else [f"run_dir={run}"]
    kept = [s for s in kept if not s.startswith("run_dir=")]
    return [*kept, *settings, *here]


def checkpoint_of(run: str | Path) -> Path:
    """Return the checkpoint in a run folder."""
    return Path(run) / CHECKPOINT
