"""`tactorch simulate`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.settings import folder, log, material_of, phantom_of, plain, plan_of
from tactorch.config import build
from tactorch.phantoms import MeshSize
from tactorch.recording import Recording
from tactorch.simulation import simulate


def run(cfg: DictConfig) -> Path:
    """Simulate a recording, write it and return its path."""
    recording = make_recording(cfg)
    out = folder() / "recording.h5" if cfg.out is None else Path(str(cfg.out))
    recording.save(out)
    log.info("%s", recording.summary())
    log.info("recording: %s", out)
    return out


def make_recording(cfg: DictConfig) -> Recording:
    """Simulate a recording with the given settings."""
    phantom = phantom_of(cfg)
    mesh, fine = build(MeshSize, plain(cfg.mesh), "mesh").build(phantom)
    with progress("simulating", "presses") as on_progress:
        return simulate(
            phantom,
            plan_of(cfg),
            material=material_of(cfg),
            mesh=mesh,
            fine_mesh=fine,
            samples=cfg.samples,
            element=cfg.element,
            solver=cfg.solver.name,
            snr_db=cfg.snr_db,
            seed=cfg.seed,
            progress=on_progress,
        )
