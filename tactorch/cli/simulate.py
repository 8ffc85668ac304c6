"""`tactorch simulate`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.settings import folder, log, material_of, phantom_of, plain, plan_of
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.simulation import simulate


def run(cfg: DictConfig) -> Path:
    """Simulate a recording and write it; returns its path."""
    recording = make_recording(cfg)
    out = folder() / "recording.h5" if cfg.out is None else Path(str(cfg.out))
    recording.save(out)
    log.info("%s", recording.summary())
    log.info("recording: %s", out)
    return out


def make_recording(cfg: DictConfig) -> Recording:
    """Simulate a recording as the settings say."""
    phantom = phantom_of(cfg)
    mesh, fine = meshes_of(cfg, phantom)
    with progress("simulating", "presses") as tell:
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
            progress=tell,
        )


def meshes_of(cfg: DictConfig, phantom: Phantom) -> tuple[TetMesh, TetMesh | None]:
    """Make the mesh to invert on, and the finer one to simulate on."""
    sizes = plain(cfg.mesh)
    generator = sizes["generator"]
    mesh = phantom.mesh(
        sizes["edge_length_mm"],
        relative_edge_length=sizes["relative_edge_length"],
        generator=generator,
    )
    fine_mm, fine_relative = sizes["fine_edge_length_mm"], sizes["fine_relative"]
    if fine_mm is None and fine_relative is None:
        return mesh, None
    relative = 0.1 if fine_relative is None else fine_relative
    return mesh, phantom.mesh(fine_mm, relative_edge_length=relative, generator=generator)
