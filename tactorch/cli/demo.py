"""`tactorch demo`: from presses to the map of Young's modulus and the lumps in it.

    tactorch demo                                  a soft cube with a stiff ball, simulated on a
                                                   finer mesh and with noise, then inverted
    tactorch demo source=published path=FOLDER     a published case

The run folder gets recording.h5 and the same files as those of `tactorch invert`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.cli import invert
from tactorch.cli.console import log
from tactorch.cli.settings import CommandOptions, run_folder, select
from tactorch.cli.simulate import SimulationOptions, simulate_recording
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.importers import FORMATS  # noqa: F401  (the registry of the section)
from tactorch.inverse import Reconstruction


@dataclass(frozen=True, kw_only=True)
class DemoOptions(SimulationOptions, invert.InversionOptions, CommandOptions):
    """Settings of the command."""

    source: Literal["simulated", "published"] = option("simulated", "Source of the recording")
    path: Path | None = option(None, "Folder of the published case, for source=published")
    format: Any = option("published", "Format of the published case", section="format")


def run(options: DemoOptions) -> Reconstruction:
    """Simulate or read a recording, and invert it."""
    if options.source == "simulated":
        log.info("Simulating noisy presses on a finer mesh than that of the inversion ...")
        recording = simulate_recording(options)
    elif options.path is None:
        raise ConfigError("source=published needs path=FOLDER, the folder of a published case.")
    else:
        recording = options.format(path=options.path)
    path = run_folder() / "recording.h5"
    recording.save(path)
    log.info("%s\n", recording.summary())
    return invert.run(select(options, invert.InvertOptions, recording=path, check_units=False))
