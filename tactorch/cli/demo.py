"""`tactorch demo`: from presses to a map of stiffness.

    tactorch demo                                  a soft cube with a stiff ball, simulated on a
                                                   finer mesh and with noise, then inverted
    tactorch demo source=published path=FOLDER     a published case

The run folder gets recording.h5 and the same files as that of `tactorch invert`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.invert import InversionOptions, invert_recording
from tactorch.cli.options import CommandOptions
from tactorch.cli.settings import log, run_folder
from tactorch.cli.simulate import SimulationOptions, simulate_recording
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.importers import FORMATS  # noqa: F401  (the registry of the section)
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording


@dataclass(frozen=True, kw_only=True)
class DemoOptions(SimulationOptions, InversionOptions, CommandOptions):
    """Settings of the command."""

    source: Literal["simulated", "published"] = option("simulated", "Source of the recording")
    path: Path | None = option(None, "Folder of the published case, for source=published")
    format: Any = option("published", "Format of the published case", section="format")
    run_dir: str = option("outputs/demo", "Folder of the results and the log")


def run(options: DemoOptions) -> Reconstruction:
    """Simulate or read a recording, and invert it."""
    recording = _recording(options)
    path = run_folder() / "recording.h5"
    recording.save(path)
    log.info("%s\n", recording.summary())
    return invert_recording(options, recording, path)


def _recording(options: DemoOptions) -> Recording:
    if options.source == "simulated":
        log.info("Simulating noisy presses on a finer mesh than that of the inversion ...")
        return simulate_recording(options)
    if options.path is None:
        raise ConfigError("source=published needs path=FOLDER, the folder of a published case.")
    recording: Recording = options.format(folder=options.path)
    return recording
