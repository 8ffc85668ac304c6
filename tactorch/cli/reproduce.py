"""`tactorch reproduce`: reproduce the paper's tables and figures beside its own numbers.

    tactorch reproduce table1
    tactorch reproduce all
    tactorch reproduce all size=full
    tactorch reproduce fig10 size.depths.places=5 size.depths.snr_db=20

A run that was stopped or killed continues where it was when the same command is given again. Each
exhibit gets a CSV file, a Markdown file and a picture.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from tactorch.cli.console import log, progress
from tactorch.cli.settings import CommandOptions
from tactorch.config import option, to_mapping
from tactorch.reproduce import reproduce
from tactorch.reproduce.options import StudySizes


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions(CommandOptions):
    """Settings of the command."""

    exhibit: Literal[
        "all", "table1", "table2", "fig3", "fig4", "fig5", "fig7", "fig8", "fig9", "fig10",
        "fig11", "fig12",
    ] = option("all", "Exhibit of the paper")  # fmt: skip
    size: StudySizes = option(factory=StudySizes, help="Size of the studies", preset="quick")
    out: Path | None = option(None, "Folder of the files; null: outputs/reproduce/SIZE")
    workers: int | None = option(None, "Processes, of one thread each; null: one per core", ge=1)
    run_dir: str = option("outputs/reproduce/log/${now:%Y-%m-%d_%H-%M-%S}", "Folder of the log")


def run(options: ReproduceOptions) -> list[Path]:
    """Make the exhibits."""
    sizes = to_mapping(options.size)
    out = options.out or Path("outputs") / "reproduce" / sizes.pop("name")
    bar = partial(progress, items="cases")
    written = reproduce(options.exhibit, sizes, out, workers=options.workers, progress=bar)
    for path in written:
        log.info("%s", path)
    return written
