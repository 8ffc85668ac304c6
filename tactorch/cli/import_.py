"""`tactorch import`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.settings import log, plain
from tactorch.errors import ConfigError
from tactorch.importers import import_published
from tactorch.recording import Recording


def run(cfg: DictConfig) -> Path:
    """Import a recording and write it; returns its path."""
    out = Path(str(cfg.out))
    recording = read_case(cfg, str(cfg.path))
    recording.save(out)
    log.info("%s", recording.summary())
    log.info("recording: %s", out)
    return out


def read_case(cfg: DictConfig, path: str) -> Recording:
    """Read files of others in the chosen format.

    Raises:
        ConfigError: the format or one of its options is unknown.
    """
    options = plain(cfg.format)
    name = options.pop("name")
    if name != "published":
        raise ConfigError(f"format '{name}' is unknown; the one known is 'published'.")
    relabel = options.pop("relabel_truth") or {}
    pairs = {float(old): float(new) for old, new in relabel.items()}
    return import_published(path, relabel_truth=pairs, **options)
