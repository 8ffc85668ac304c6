"""Random objects of `calibration.py`: simulation, inversion and comparison with the truth."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from tactorch.inverse import (
    GaussNewton,
    InverseProblem,
    Log,
    Monitor,
    Objective,
    Quadratic,
    Settings,
    Smoothness,
    homogeneous,
    invert_map,
    make_objective,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.posterior import GaussianPosterior, LaplacePosterior, variational_posterior
from tactorch.linalg.superlu import SparseFactor
from tactorch.mesh import Box, Shape, Sphere, TetMesh, box_mesh
from tactorch.phantoms import Phantom, make_phantom
from tactorch.recording import Recording
from tactorch.simulation import PressPlan, noise_level, simulate

SIDE = 10.0
FACES = ("z+", "x+", "y+")
_SMOOTH, _MASS = 20.0, 0.3  # weights of the normal prior: correlated over some elements


@dataclass(frozen=True, eq=False)
class Case:
    """An object and its presses."""

    phantom: Phantom
    plan: PressPlan
    snr_db: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """True log-moduli of an object, and mean and deviation of each posterior by name."""

    truth: np.ndarray
    volumes: np.ndarray
    inclusions: int
    inside: np.ndarray
    posteriors: dict[str, tuple[np.ndarray, np.ndarray]]
    seconds: float


class NormalPrior(Quadratic):
    """Half the squared difference from a mean, weighted by a sparse precision."""

    def __init__(self, mesh: TetMesh, mean: float) -> None:
        """Combine smoothness and a mass term (a Matern field, in finite volumes)."""
        relative = mesh.volumes / mesh.volumes.mean()
        smooth = Smoothness().on(mesh).curvature(np.zeros(mesh.n_tets))
        self.precision = sp.csr_matrix(_SMOOTH * smooth + _MASS * sp.diags(relative))
        self.mean = mean
        super().__init__(self.precision, mean)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a field."""
        noise = rng.standard_normal((self.precision.shape[0], 1))
        return self.mean + self._factor.correlated(noise)[:, 0]

    @cached_property
    def _factor(self) -> SparseFactor:
        factor = SparseFactor.of(self.precision)
        assert factor is not None
        return factor


def draw_case(rng: np.random.Generator) -> Case:
    """Draw an object and its presses; pressures are relative to its stiffness."""
    youngs = float(np.exp(rng.uniform(np.log(0.1), np.log(0.4))))
    inclusions: list[tuple[Shape, float]] = []
    for _ in range(rng.integers(0, 3)):
        radius = float(rng.uniform(1.5, 3.0))
        centre = tuple(float(c) for c in rng.uniform(radius, SIDE - radius, 3))
        contrast = float(np.exp(rng.uniform(np.log(1 / 3), np.log(6))))
        ball, box = Sphere(centre, radius), Box(centre, (1.6 * radius,) * 3)
        inclusions.append((ball if rng.integers(2) else box, contrast * youngs))
    faces = tuple(rng.permutation(FACES)[: rng.integers(1, 4)].tolist())
    p_max = float(rng.uniform(0.05, 0.12)) * youngs
    body = Box((SIDE / 2,) * 3, (SIDE,) * 3)
    plan = PressPlan(p_max_mpa=p_max, steps=3, faces=faces)
    return Case(Phantom(body, inclusions, youngs), plan, float(rng.uniform(25.0, 50.0)))


def judge_piecewise(divisions: int, seed: int, index: int, *, same_mesh: bool) -> Outcome:
    """Simulate, invert and judge one object of balls and boxes."""
    began = time.perf_counter()
    case = draw_case(np.random.default_rng([seed, index]))
    mesh = box_mesh(SIDE, divisions, tets_per_cell=5)
    finer = box_mesh(SIDE, 2 * divisions, tets_per_cell=5)
    recording = simulate(
        case.phantom,
        case.plan,
        mesh=mesh,
        fine_mesh=None if same_mesh else finer,
        samples=4,
        snr_db=case.snr_db,
        seed=seed + index,
    )
    assert recording.truth is not None
    truth = np.log(recording.truth)
    posteriors = _infer(replace(recording, truth=None))
    inside = np.abs(truth - np.log(case.phantom.youngs_mpa)) > 0.05
    seconds = time.perf_counter() - began
    count = len(case.phantom.inclusions)
    return Outcome(truth, mesh.volumes, count, inside, posteriors, seconds)


def _infer(recording: Recording) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Invert by default settings; return mean and deviation by each posterior."""
    settings = Settings()
    found = invert_map(recording, settings, start_mpa=homogeneous, show_progress=False)
    objective = make_objective(recording, settings)
    point = objective.at(objective.start(found.youngs))
    weight = found.history[-1]["weight"]
    both: dict[str, GaussianPosterior] = {
        "laplace": LaplacePosterior.at(point, weight),
        "variational": variational_posterior(point, weight),
    }
    return {name: (posterior.mean, posterior.deviation()) for name, posterior in both.items()}


def judge_gaussian(divisions: int, seed: int, index: int) -> Outcome:
    """Simulate, invert and judge one object drawn from the prior that inverts it."""
    began, rng = time.perf_counter(), np.random.default_rng([seed, index])
    mesh = box_mesh(SIDE, divisions, tets_per_cell=5)
    prior = NormalPrior(mesh, float(np.log(0.2)))
    truth = prior.draw(rng)
    faces = FACES[: 1 + index % 3]
    plan = PressPlan(p_max_mpa=0.01, steps=2, faces=faces)
    # A uniform object gives forces and supports; the presses are then those of the drawn one.
    blank = simulate(make_phantom("uniform_cube"), plan, mesh=mesh)
    moved = InverseProblem(blank).evaluate(np.exp(truth)).displacements
    presses = []
    for press, exact in zip(blank.presses, moved, strict=True):
        sigma = noise_level(exact[press.observed], float(rng.uniform(25.0, 40.0)))
        noisy = exact + sigma * rng.standard_normal(exact.shape)
        presses.append(replace(press, displacement=noisy, noise_mm=sigma))
    problem = InverseProblem(replace(blank, presses=tuple(presses), truth=None))
    objective = Objective(problem, ElementField(Log(), prior, problem.n_elements), weight=1.0)
    monitor = Monitor()
    start = objective.start(np.full(mesh.n_tets, 0.2))
    GaussNewton(tolerance=1e-6).minimize(objective, start, monitor)
    assert monitor.point is not None
    found = LaplacePosterior.at(monitor.point, 1.0)
    posteriors = {"laplace": (found.mean, found.deviation())}
    inside = np.zeros(mesh.n_tets, dtype=bool)
    return Outcome(truth, mesh.volumes, 0, inside, posteriors, time.perf_counter() - began)


KINDS: dict[str, Callable[[int, int, int], Outcome]] = {
    "gaussian": judge_gaussian,
    "same mesh": lambda d, s, i: judge_piecewise(d, s, i, same_mesh=True),
    "other mesh": lambda d, s, i: judge_piecewise(d, s, i, same_mesh=False),
}
