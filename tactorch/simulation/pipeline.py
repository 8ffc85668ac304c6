"""From a phantom and a plan of presses to a recording."""

import threading
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.fem import STANDARD_GRAVITY, SoftBody, make_material
from tactorch.linalg import map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real, Vector, positive, vector
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.simulation.noise import add_noise, noise_level
from tactorch.simulation.plan import PressPlan
from tactorch.simulation.stage import Setup, Stage

_DEFAULT_MATERIAL = MaterialSpec("neo_hookean", 0.45)
_DEFAULT_PLAN = PressPlan()


def simulate(
    phantom: Phantom,
    plan: PressPlan = _DEFAULT_PLAN,
    *,
    material: MaterialSpec = _DEFAULT_MATERIAL,
    mesh: TetMesh | None = None,
    fine_mesh: TetMesh | None = None,
    samples: int = 1,
    element: str = "tet4",
    solver: str = "auto",
    snr_db: Real | None = None,
    seed: int = 0,
    density: Real | None = None,
    gravity: Vector = STANDARD_GRAVITY,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Press a phantom and record how its pressed surface moves.

    Without `fine_mesh` the presses are solved on the recording's own mesh with its own forces: an
    inversion with the same element then has a model without error (the inverse crime), which the
    provenance says. With it they are solved on the fine mesh and interpolated to the recording's
    nodes with the element's shape functions; pressure and patch are integrated exactly on either
    mesh, so total forces agree, and springs keep their total stiffness, on both meshes spread
    evenly over the held side.
    Quadratic elements get such consistent loads and springs on any mesh, for a recording has them
    on vertices only.

    Places are solved side by side on the machine's cores, the pressures of one place in turn,
    each from the one before.

    Args:
        phantom: The object.
        plan: Where and how hard it is pressed, and what holds it.
        material: The constitutive law but for Young's modulus.
        mesh: The recording's mesh, on which it will be inverted; by default `phantom.mesh()`.
        fine_mesh: The mesh to solve on, such as `phantom.mesh(0.5)`.
        samples: How elements get their modulus, see `Phantom.on_mesh`; on both meshes.
        element: "tet4" or "tet10".
        solver: Linear solver, see `tactorch.linalg`.
        snr_db: Signal-to-noise ratio 20 log10(rms(u) / sigma), over the observed degrees of
            freedom of each press; None for no noise.
        seed: Of the noise. Each press draws from a generator of its own, so that its noise does
            not change when presses are appended.
        density: Mass density, tonne/mm^3; None for no weight. Displacements then count from the
            unloaded shape, as with all presses.
        gravity: Acceleration of gravity, mm/s^2; used with a density only.
        progress: Called with the number of presses solved and their total, one call at a time
            but from several threads.

    Returns:
        The recording: presses place by place, lightest first, all three components of the pressed
        nodes observed, `noise_mm` as drawn (None without noise), the truth per element, and the
        phantom, the plan and the settings in the provenance.

    Raises:
        ConfigError: A setting cannot be used, or a patch misses the object.
        MeshError: A mesh is not of the phantom, or a side is not flat.
        ConvergenceError: A press collapses the object.
        RecordingError: The result is implausible, for instance in its units.
    """
    if snr_db is not None:
        noise_level(np.ones(1), snr_db)  # refuses a bad value before the work
    if seed < 0:
        raise ConfigError(f"seed={seed} must not be negative.")
    mesh = phantom.mesh() if mesh is None else mesh
    truth = phantom.on_mesh(mesh, samples)
    pull = np.zeros(3) if density is None else np.array(vector("gravity", gravity))
    heavy = None if density is None else positive("density", density)
    stage = _stage(
        phantom, plan, material, mesh, fine_mesh, (samples, element, solver), heavy, pull
    )
    setups = [Setup.on(mesh, s, plan, even=not stage.as_recorded) for s in plan.series]
    count = _counter(plan.n_presses, progress)
    moved = map_cases(lambda i: stage.press(setups[i], count), len(setups))
    rows = [(s, step, u) for s, us in zip(setups, moved, strict=True) for step, u in enumerate(us)]
    presses = [
        _press(setup, step, float(plan.pressures_mpa[step]), u, snr_db, [seed, i])
        for i, (setup, step, u) in enumerate(rows)
    ]
    settings = {"element": element, "solver": solver, "samples": samples, "snr_db": snr_db}
    return Recording(
        mesh,
        tuple(presses),
        material,
        truth=truth,
        provenance=_provenance(phantom, plan, stage, {**settings, "seed": seed}),
        density=heavy,
        gravity=pull,
    )


def _stage(
    phantom: Phantom,
    plan: PressPlan,
    material: MaterialSpec,
    mesh: TetMesh,
    fine_mesh: TetMesh | None,
    numerics: tuple[int, str, str],
    density: float | None,
    gravity: Float[np.ndarray, "3"],
) -> Stage:
    """Build the body to press, on the mesh to solve on."""
    samples, element, solver = numerics
    other = fine_mesh is not None and fine_mesh.content_hash() != mesh.content_hash()
    solved = fine_mesh if other and fine_mesh is not None else mesh
    law = make_material(material.name, material.poisson, **material.parameters)
    body = SoftBody(solved, law, element=element, solver=solver)
    weight = np.zeros((body.n_nodes, 3))
    if density is not None:
        weight = body.gravity(density, gravity.tolist()).numpy()
    return Stage(body, phantom.on_mesh(solved, samples), mesh, plan, weight)


def _press(
    setup: Setup,
    step: int,
    pressure: float,
    displacement: Float[np.ndarray, "n 3"],
    snr_db: Real | None,
    seed: list[int],
) -> Press:
    """Record one solved press, with noise if wanted."""
    noise_mm = None
    if snr_db is not None:
        rng = np.random.default_rng(seed)
        displacement, noise_mm = add_noise(displacement, setup.observed, snr_db, rng)
    return Press(
        pressure * setup.forces,
        setup.observed,
        displacement,
        springs=setup.springs,
        fixed=setup.fixed,
        noise_mm=noise_mm,
        step=step,
        direction=setup.series.push,
        name=f"{setup.series.name}, {1e3 * pressure:g} kPa",
    )


def _counter(total: int, progress: Callable[[int, int], None] | None) -> Callable[[], None]:
    """Return a function that counts its calls, from whatever thread, and reports them."""
    lock, solved = threading.Lock(), 0

    def count() -> None:
        nonlocal solved
        with lock:
            solved += 1
            if progress is not None:
                progress(solved, total)

    return count


def _provenance(
    phantom: Phantom, plan: PressPlan, stage: Stage, settings: dict[str, Any]
) -> dict[str, Any]:
    return {
        "simulator": "tactorch.simulation",
        "phantom": phantom.to_config(),
        "plan": plan.to_config(),
        **settings,
        "inverse_crime": stage.same_mesh,
        "fine_mesh": None if stage.same_mesh else _mesh_facts(stage.body.mesh),
        "versions": {name: _version(name) for name in ("tactorch", "numpy", "scipy", "torch")},
    }


def _mesh_facts(mesh: TetMesh) -> dict[str, Any]:
    ends = mesh.points[mesh.edges]
    return {
        "points": mesh.n_points,
        "tets": mesh.n_tets,
        "mean_edge_mm": float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean()),
        "hash": mesh.content_hash(),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
