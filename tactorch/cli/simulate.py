"""`tactorch simulate`: press a phantom and record how its surface moves.

    tactorch simulate                                   a cube with a ball, pressed on three sides
    tactorch simulate phantom=cube_cylinder snr_db=20 out=cylinder.h5
    tactorch simulate press.faces=[z+] press.steps=8 mesh=same snr_db=null
    tactorch simulate -m phantom.depth=0.3,0.4,0.5 seed=1,2

The recording is written to recording.h5 in the run folder, or to `out`.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.console import log, progress
from tactorch.cli.existing import check_file
from tactorch.cli.settings import CommandOptions, UnitCheck, material_spec, run_folder
from tactorch.config import option, to_mapping
from tactorch.errors import ConfigError
from tactorch.fem import MATERIALS  # noqa: F401  (the registry of the section)
from tactorch.linalg import SOLVERS
from tactorch.linalg.solver import AutoSolver
from tactorch.phantoms import MeshSize
from tactorch.phantoms.library import PHANTOMS  # noqa: F401
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, simulate


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(UnitCheck):
    """Settings of a simulated recording."""

    phantom: Any = option("cube_sphere", "Object and its inclusions", section="phantom")
    press: PressPlan = option(factory=PressPlan, help="Presses", preset="three_sides")
    mesh: MeshSize = option(factory=MeshSize, help="Meshes", preset="default")
    material: Any = option("neo_hookean", "Material of the object", section="material")
    solver: Any = option("auto", "Linear solver", section="solver")
    element: Literal["tet4", "tet10"] = option("tet4", "Element type")
    fine_element: Literal["tet4", "tet10"] | None = option(
        None, "Element type of the simulation; null: tet10 on a separate mesh, else element"
    )
    samples: int = option(
        4,
        "Samples per edge that average the modulus over cut elements of the recording's mesh;"
        " 1: centroid, in the simulation too",
        ge=1,
    )
    snr_db: float | None = option(40.0, "Signal-to-noise ratio; null: no noise", unit="dB")
    seed: int = option(0, "Seed of the noise", ge=0)


@dataclass(frozen=True, kw_only=True)
class SimulateOptions(SimulationOptions, CommandOptions):
    """Settings of the command."""

    out: Path | None = option(None, "Recording to write; null: recording.h5 in the run folder")


def run(options: SimulateOptions) -> Path:
    """Simulate a recording and write it; returns its path."""
    out = options.out or run_folder() / "recording.h5"
    if options.out is None:
        check_file(out, options.overwrite)
    recording = simulate_recording(options)
    recording.save(out)
    log.info("%s", recording.summary())
    log.info("recording: %s", out)
    return out


def simulate_recording(options: SimulationOptions) -> Recording:
    """Simulate a recording."""
    try:
        phantom = options.phantom.build()
    except ConfigError as error:  # of shapes, which do not name the setting
        raise ConfigError(f"phantom: {error}") from error
    mesh, fine = options.mesh.build(phantom)
    # Linear elements are too stiff to stand for the object on a separate mesh.
    element = options.fine_element or (options.element if fine is None else "tet10")
    solver = options.solver
    if element == "tet10" and isinstance(SOLVERS.build(solver), AutoSolver):
        solver = "p_multigrid"
    with progress("simulating", "presses") as update:
        recording = simulate(
            phantom,
            options.press,
            material=material_spec(options.material),
            mesh=mesh,
            fine_mesh=fine,
            samples=options.samples,
            element=element,
            solver=solver,
            snr_db=options.snr_db,
            seed=options.seed,
            check_units=options.check_units,
            progress=update,
        )
    provenance = {**recording.provenance, "mesh": to_mapping(options.mesh)}
    return replace(recording, provenance=provenance)
