"""Simulation of a recording from a phantom and a press plan, and of wrong assumptions in it."""

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.fem import STANDARD_GRAVITY, SoftBody, make_material
from tactorch.linalg import SOLVERS, SolverOptions, map_cases
from tactorch.mesh import TetMesh
from tactorch.mesh.values import Real, Vector, positive, vector
from tactorch.phantoms import Phantom
from tactorch.progress import progress_line
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.recording.plausibility import MODULUS_MPA
from tactorch.simulation.plan import PressPlan
from tactorch.simulation.solve import PressSimulator
from tactorch.versions import versions

_DEFAULT_MATERIAL = MaterialSpec("neo_hookean", 0.45)
_DEFAULT_PLAN = PressPlan()
# Of a pressure over Young's modulus E: a column under a dead load of 5 E keeps a fourth of its
# height (compressible neo-Hookean law, Poisson's ratio 0.45).
_MAX_STRAIN = 5.0


def simulate(
    phantom: Phantom,
    plan: PressPlan = _DEFAULT_PLAN,
    *,
    material: MaterialSpec = _DEFAULT_MATERIAL,
    mesh: TetMesh | None = None,
    fine_mesh: TetMesh | None = None,
    samples: int = 1,
    element: str = "tet4",
    solver: str | SolverOptions = "auto",
    snr_db: Real | None = None,
    seed: int = 0,
    density: Real | None = None,
    gravity: Vector = STANDARD_GRAVITY,
    check_units: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Simulate a recording of presses on a phantom.

    Without `fine_mesh` the presses are solved on the recording's mesh, so that an inversion with
    the same element has no model error (inverse crime); the provenance states it. With `fine_mesh`
    they are solved on that mesh and interpolated to the recording's nodes. Pressures are integrated
    exactly on both meshes, so total forces agree, and the total stiffness of springs is the same,
    distributed evenly over the supported face. Quadratic elements have such consistent loads and
    springs on any mesh, whereas a recording has them on vertices only.

    Sites are solved in parallel, the load steps of a site in sequence with warm starts.

    Args:
        phantom: Object to press.
        plan: Locations, pressures and supports.
        material: Constitutive law without Young's modulus.
        mesh: The recording's mesh, used for the inversion; default: `phantom.mesh()`.
        fine_mesh: Mesh to solve on, such as `phantom.mesh(0.5)`.
        samples: Number of sampling points for the modulus of elements, see `Phantom.on_mesh`. With
            more than one, quadratic elements of `fine_mesh` have moduli at their quadrature points,
            see `Phantom.at_quadrature`.
        element: "tet4" or "tet10".
        solver: Linear solver, see `tactorch.linalg`.
        snr_db: Signal-to-noise ratio 20 log10(rms(u) / sigma), over the observed degrees of
            freedom of each press; None for no noise.
        seed: Seed of the noise. Each press has a separate generator, so that its noise does not
            depend on the number of presses.
        density: Mass density, tonne/mm^3; None for no weight. Displacements are relative to the
            unloaded shape, as for all presses.
        gravity: Gravitational acceleration, mm/s^2; used with a density only.
        check_units: Whether moduli and pressures that suggest Pa or kPa are refused.
        progress: Called with the number of solved presses and their total, from several threads
            but one call at a time. By default progress is shown as by
            `tactorch.progress.progress_line`.

    Returns:
        The recording: presses ordered by site and pressure, with all three components of the
        pressed nodes observed, `noise_mm` (None without noise), the true modulus of each element,
        and the phantom, the plan and the settings in the provenance.

    Raises:
        ConfigError: A setting cannot be used, or suggests a wrong unit.
        ConvergenceError: The load collapses the object.
    """
    if snr_db is not None:
        noise_level(np.ones(1), snr_db)  # refuses an invalid value before the computation
    if seed < 0:
        raise ConfigError(f"seed={seed} must not be negative.")
    acceleration = np.zeros(3) if density is None else np.array(vector("gravity", gravity))
    density = None if density is None else positive("density", density)
    mesh = phantom.mesh() if mesh is None else mesh
    truth = phantom.on_mesh(mesh, samples)
    if check_units:
        _check_pressure(plan.p_max_mpa, float(np.median(truth)))
    if fine_mesh is None or fine_mesh.content_hash() == mesh.content_hash():
        fine_mesh = mesh
    law = make_material(material.name, material.poisson, **material.parameters)
    body = SoftBody(fine_mesh, law, element=element, solver=solver)
    weight = np.zeros((body.n_nodes, 3))
    if density is not None:
        weight = body.gravity(density, acceleration.tolist()).numpy()
    youngs = truth if fine_mesh is mesh else _moduli(phantom, body, samples)
    simulator = PressSimulator(body, youngs, mesh, plan, weight)
    sites = [simulator.conditions(site) for site in plan.sites_on(mesh)]
    lock, solved = threading.Lock(), itertools.count(1)
    total = len(sites) * len(plan.pressures)

    with progress_line("simulation", None if progress is None else False) as update:

        def on_solved() -> None:
            with lock:
                count = next(solved)
                update(f"{count} of {total} presses")
                if progress is not None:
                    progress(count, total)

        displacements = map_cases(lambda i: simulator.solve(sites[i], on_solved), len(sites))
    presses: list[Press] = []
    for conditions, steps in zip(sites, displacements, strict=True):
        for step, (pressure, displacement) in enumerate(zip(plan.pressures, steps, strict=True)):
            noise_mm = None
            if snr_db is not None:
                rng = np.random.default_rng([seed, len(presses)])
                displacement, noise_mm = add_noise(displacement, conditions.observed, snr_db, rng)
            press = Press(
                pressure * conditions.forces,
                conditions.observed,
                displacement,
                springs=conditions.springs,
                fixed=conditions.fixed,
                noise_mm=noise_mm,
                step=step,
                direction=conditions.site.direction,
                name=f"{conditions.site.name}, {1e3 * pressure:g} kPa",
            )
            presses.append(press)
    provenance = {
        "simulator": "tactorch.simulation",
        "phantom": phantom.to_config(),
        "plan": to_mapping(plan),
        "element": element,
        "solver": solver if isinstance(solver, str) else SOLVERS.name_of(type(solver)),
        "samples": samples,
        "modulus": "per element" if youngs.ndim == 1 else "at quadrature points",
        "snr_db": snr_db,
        "seed": seed,
        "inverse_crime": simulator.same_mesh,
        "fine_mesh": None if simulator.same_mesh else _summarize(fine_mesh),
        "versions": versions(),
    }
    return Recording(
        mesh,
        tuple(presses),
        material,
        truth=truth,
        provenance=provenance,
        density=density,
        gravity=acceleration,
        check_units=check_units,
    )


def _check_pressure(pressure: float, youngs: float) -> None:
    """Refuse a pressure and a modulus (MPa) that suggest Pa or kPa."""
    if youngs > MODULUS_MPA[1]:
        raise ConfigError(
            f"phantom: its Young's modulus is {youngs:.4g} MPa (median); Pa or kPa given for MPa? "
            "200 kPa is 0.2 MPa. check_units=false accepts it."
        )
    if pressure > _MAX_STRAIN * youngs:
        unit, factor = ("kPa", 1e3) if pressure < 1e3 * youngs else ("Pa", 1e6)
        raise ConfigError(
            f"press.p_max_mpa={pressure:.6g} is {pressure / youngs:.3g} times Young's modulus of "
            f"the object ({youngs:.3g} MPa); {unit} given for MPa? {pressure:.6g} {unit} is "
            f"{pressure / factor:.6g}. check_units=false accepts it."
        )


def _moduli(phantom: Phantom, body: SoftBody, samples: int) -> Float[np.ndarray, "m *q"]:
    """Return Young's modulus of each element, or quadrature point of quadratic ones, MPa."""
    element = body.discretisation.element
    if element.quadratic and samples > 1:
        return phantom.at_quadrature(body.mesh, element.points)
    return phantom.on_mesh(body.mesh, samples)


def noise_level(signal: Float[np.ndarray, " k"], snr_db: Real) -> float:
    """Return the standard deviation sigma with 20 log10(rms(signal) / sigma) = `snr_db`."""
    if not np.isfinite(snr_db):
        raise ConfigError(f"snr_db={snr_db!r} must be a finite number of decibels, or None.")
    return float(np.sqrt(np.mean(np.square(signal))) * 10.0 ** (-float(snr_db) / 20.0))


def add_noise(
    displacement: Float[np.ndarray, "n 3"],
    observed: Bool[np.ndarray, "n 3"],
    snr_db: Real,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Add white Gaussian noise to the observed degrees of freedom; return its deviation too, mm."""
    sigma = noise_level(displacement[observed], snr_db)
    noisy = displacement.copy()
    noisy[observed] += sigma * rng.standard_normal(int(observed.sum()))
    return noisy, sigma


def perturb_recording(
    recording: Recording,
    *,
    poisson: float = 0.0,
    force_scale: Real = 1.0,
    size: Real | Sequence[Real] = 1.0,
) -> Recording:
    """Return the recording of the same deformed positions under wrong assumptions (Fig. 9).

    The assumed size is relative to the support of each press, whose position is known. The
    displacement from the wrong rest shape includes the difference of the shapes (Section V-C2).

    Args:
        recording: Recording with the correct assumptions.
        poisson: Error of Poisson's ratio: assumed minus true value.
        force_scale: Ratio of the reported to the true force.
        size: Ratio of the assumed to the true size, one value or one for each axis.
    """
    factors = np.broadcast_to(np.asarray(size, dtype=np.float64), (3,))
    if not (np.all(np.isfinite(factors)) and np.all(factors > 0)):
        raise ConfigError(f"size={size}: give factors above 0, such as 1.1.")
    if not force_scale > 0:
        raise ConfigError(f"force_scale={force_scale}: give a factor above 0, such as 1.2.")
    mesh, material = recording.mesh, recording.material
    presses = tuple(
        replace(
            press,
            forces=press.forces * force_scale,
            displacement=press.displacement - _shape_difference(press, mesh.points, factors),
        )
        for press in recording.presses
    )
    errors = {"poisson": poisson, "force_scale": force_scale, "size": factors.tolist()}
    return replace(
        recording,
        mesh=TetMesh.create(mesh.points * factors, mesh.tets, regions=mesh.regions),
        presses=presses,
        material=replace(material, poisson=material.poisson + poisson),
        provenance={**recording.provenance, "perturbation": errors},
        check_units=False,
    )


def _shape_difference(
    press: Press, points: Float[np.ndarray, "n 3"], factors: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Assumed minus true rest positions, relative to the supported nodes along each axis."""
    origin = points.min(axis=0) / 2 + points.max(axis=0) / 2
    for axis, supported in enumerate((press.fixed | (press.springs > 0)).T):
        if supported.any():
            origin[axis] = points[supported, axis].mean()
    return (points - origin) * (factors - 1.0)


def _summarize(mesh: TetMesh) -> dict[str, Any]:
    return {
        "points": mesh.n_points,
        "tets": mesh.n_tets,
        "mean_edge_mm": float(mesh.edge_lengths.mean()),
        "hash": mesh.content_hash(),
    }
