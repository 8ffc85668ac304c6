"""`tactorch reproduce`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.settings import log, plain
from tactorch.reproduce import reproduce
from tactorch.reproduce.cases import ProgressCallback


def run(cfg: DictConfig) -> list[Path]:
    """Write the selected exhibits."""
    sizes = plain(cfg.size)
    size = sizes.pop("name")
    out = Path("outputs") / "reproduce" / size if cfg.out is None else Path(str(cfg.out))
    written = reproduce(cfg.exhibit, sizes, out, workers=cfg.workers, progress=_progress)
    for path in written:
        log.info("%s", path)
    return written


@contextmanager
def _progress(study: str) -> Iterator[ProgressCallback]:
    with progress(study, "cases") as update:
        yield lambda done, total, note: update(done, total, note)
