"""`tactorch demo`: from presses to a map in one command."""

from omegaconf import DictConfig

from tactorch.cli.import_ import read_case
from tactorch.cli.invert import invert_recording
from tactorch.cli.settings import folder, log
from tactorch.cli.simulate import make_recording
from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction
from tactorch.recording import Recording


def run(cfg: DictConfig) -> Reconstruction:
    """Simulate or import a recording, invert it, and report the inclusion."""
    recording = _recording(cfg)
    path = folder() / "recording.h5"
    recording.save(path)
    log.info("%s\n", recording.summary())
    return invert_recording(cfg, recording, path)


def _recording(cfg: DictConfig) -> Recording:
    if cfg.source == "simulated":
        log.info("Simulating noisy presses on a finer mesh than that of the inversion ...")
        return make_recording(cfg)
    if cfg.source != "published":
        raise ConfigError(f"source={cfg.source} is unknown; choose simulated or published.")
    if cfg.path is None:
        raise ConfigError("source=published needs path=FOLDER, the folder of a published case.")
    return read_case(cfg, str(cfg.path))
