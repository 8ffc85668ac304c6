"""`tactorch import`: convert files of other formats into a recording.

    tactorch import format=published path=FOLDER out=FILE.h5
    tactorch import path=box-torus out=torus.h5 "format.relabel_truth={3.0: 1.5}"
    tactorch import format=palpation path=palpation.csv out=palpation.h5
    tactorch import format=ros2 path=session.mcap out=palpation.h5 format.radius_mm=3

Presses, supports and truth of the files are checked before the recording is written.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactorch.cli.console import log
from tactorch.cli.settings import CommandOptions
from tactorch.config import option
from tactorch.importers import FORMATS  # noqa: F401  (the registry of the section)


@dataclass(frozen=True, kw_only=True)
class ImportOptions(CommandOptions):
    """Settings of the command."""

    path: Path = option(help="File or folder to import")
    out: Path = option(help="Recording to write (.h5)")
    format: Any = option("published", "Format of the files", section="format")


def run(options: ImportOptions) -> Path:
    """Import a recording and write it; returns its path."""
    recording = options.format(path=options.path)
    recording.save(options.out)
    log.info("%s", recording.summary())
    log.info("recording: %s", options.out)
    return options.out
