"""`tactorch reproduce`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.settings import log, plain
from tactorch.reproduce import make
from tactorch.reproduce.cases import Told


def run(cfg: DictConfig) -> list[Path]:
    """Make the exhibits that are asked for."""
    sizes = plain(cfg.size)
    size = sizes.pop("name")
    out = Path("outputs") / "reproduce" / size if cfg.out is None else Path(str(cfg.out))
    written = make(cfg.exhibit, sizes, out, workers=cfg.workers, progress=_progress)
    for path in written:
        log.info("%s", path)
    return written


@contextmanager
def _progress(study: str) -> Iterator[Told]:
    with progress(study, "cases") as tell:
        yield lambda done, total, note: tell(done, total, note)
