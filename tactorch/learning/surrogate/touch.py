"""Input of the surrogate: dimensionless fields on a cubic grid over the object.

Displacements are divided by their root mean square, tractions by the best uniform modulus, and
lengths by the bounding box, so that the fields do not depend on size and stiffness.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from tactorch.errors import ConfigError
from tactorch.inverse import Bounds, Evaluation, InverseProblem, NoiseModel
from tactorch.inverse.linear_image import linear_image
from tactorch.inverse.uniform import uniform_fit
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.recording import Press, Recording

#: Channels of each press; a vector field is named by its components.
PRESS_CHANNELS = (
    "excess_x", "excess_y", "excess_z",  # observed less predicted by the uniform map
    "moved_x", "moved_y", "moved_z",
    "traction_x", "traction_y", "traction_z",
    "valid", "held", "stretch", "noise",
)  # fmt: skip
#: First components of the vector fields among them.
PRESS_VECTORS = (0, 3, 6)
#: Channels of the object.
SHARED_CHANNELS = ("occupancy", "image", "explained", "compressible")
VERSION = 2
_MIN_COMPRESSIBILITY = 1e-3  # of 1 - 2 nu
_MIN_COSINE = 0.9  # between loads of one way to press


@dataclass(frozen=True, eq=False)
class Touch:
    """Presses on an object, on a grid over its bounding box.

    Attributes:
        youngs_mpa: The uniform modulus that fits best, MPa.
        presses: `PRESS_CHANNELS` of each press.
        shared: `SHARED_CHANNELS`.
    """

    youngs_mpa: float
    presses: Float[np.ndarray, "k c v v v"]
    shared: Float[np.ndarray, "s v v v"]


def touch(
    recording: Recording,
    count: int = 8,
    frames: int = 1,
    *,
    noise: NoiseModel | None = None,
    bounds: Bounds | None = None,
) -> Touch:
    """Return the fields of a recording on a grid.

    Args:
        recording: Presses on an object; its truth is not read.
        count: Cells in each direction, even.
        frames: Load steps of each place to use, the strongest first.
        noise: Standard deviations for presses that do not state theirs.
        bounds: Limits of the uniform modulus.

    Raises:
        ConfigError: The count is odd or below 2, or there are no frames.
        ConvergenceError: No uniform modulus carries the presses.
    """
    if count < 2 or count % 2 or frames < 1:
        raise ConfigError(f"count={count} must be even and at least 2, frames={frames} at least 1.")
    chosen = recording.select(strongest(recording, frames))
    problem = InverseProblem(chosen, noise=noise)
    fit = uniform_fit(problem, bounds)
    evaluation = problem.evaluate(np.full(problem.n_elements, fit.youngs_mpa))
    deviations = problem.noise.deviations(chosen)
    grid = VoxelGrid(chosen.mesh, count)
    presses = [
        _press(press, evaluation, i, deviations[i], grid) for i, press in enumerate(chosen.presses)
    ]
    image, explained = linear_image(evaluation, chosen.mesh, deviations, count)
    compressible = np.full_like(image, np.log10(_compressible(chosen)))
    shared = np.stack([occupancy(chosen.mesh, count), image, explained, compressible])
    return Touch(fit.youngs_mpa, np.stack(presses), shared)


def strongest(recording: Recording, frames: int) -> list[int]:
    """Return the presses with the largest loads of each way to press, in their order.

    Presses are of one way where their loads are alike over the whole object but for the size, and
    the same is held.
    """
    loads = [_load(press) for press in recording.presses]
    sizes = [float(np.linalg.norm(load)) for load in loads]
    groups: list[list[int]] = []
    for i, press in enumerate(recording.presses):
        for group in groups:
            first = recording.presses[group[0]]
            alike = float(loads[i] @ loads[group[0]]) >= _MIN_COSINE * sizes[i] * sizes[group[0]]
            if alike and np.array_equal(press.held, first.held):
                group.append(i)
                break
        else:
            groups.append([i])
    kept = [sorted(group, key=lambda i: -sizes[i])[:frames] for group in groups]
    return sorted(i for group in kept for i in group)


def _compressible(recording: Recording) -> float:
    """1 - 2 nu: 0 of a material that keeps its volume."""
    return max(_MIN_COMPRESSIBILITY, 1.0 - 2.0 * recording.material.poisson)


def _load(press: Press) -> Float[np.ndarray, " dofs"]:
    """Return the load of a press: forces, else prescribed or observed displacements."""
    for field in (press.forces, press.prescribed):
        if field.any():
            return field.ravel()
    return np.where(press.data, press.displacement, 0.0).ravel()


def occupancy(mesh: TetMesh, count: int) -> Float[np.ndarray, "v v v"]:
    """Return the share of each cell that is in the body, from eight points in each."""
    inside = VoxelGrid(mesh, 2 * count).inside.reshape(count, 2, count, 2, count, 2)
    return inside.mean(axis=(1, 3, 5))


def _press(
    press: Press, evaluation: Evaluation, i: int, deviation: float, grid: VoxelGrid
) -> Float[np.ndarray, "c v v v"]:
    data = press.data if press.weights is None else press.data & (press.weights > 0)
    predicted = evaluation.reported[i]
    # Components that were not observed take the displacement of the uniform map.
    displacement = np.where(data, press.displacement, predicted)
    valid = np.asarray(data.any(axis=1))
    size = max(float(np.sqrt(np.mean(displacement[data] ** 2))), deviation)
    weight = grid.splat(valid.astype(float)[:, None])[0]
    there = weight > 1e-6
    share = np.where(there, 1.0 / np.maximum(weight, 1e-6), 0.0)
    # A force over the modulus and the area of a cell's side.
    area = float(np.prod(grid.size_mm)) ** (2.0 / 3.0) * float(evaluation.youngs[0])
    held = grid.splat(press.held.any(axis=1).astype(float)[:, None])[0] > 1e-6
    extent = float(np.mean(grid.size_mm)) * grid.count
    facts = (1.0, size / extent, np.log10(max(deviation / size, 1e-6)))
    valid_, stretch, noise = (there * value for value in facts)
    at = valid[:, None] / size
    return np.concatenate(
        [
            grid.splat((displacement - predicted) * at) * share,
            grid.splat(displacement * at) * share,
            grid.splat(press.forces) / area,
            np.stack([valid_, held.astype(float), stretch, noise]),
        ]
    )


def targets(
    mesh: TetMesh, truth: Float[np.ndarray, " m"], youngs_mpa: float, count: int
) -> tuple[Shaped[np.ndarray, "v v v"], Shaped[np.ndarray, "v v v"]]:
    """Return log E over a modulus on a grid, and which of its voxels are in the body."""
    grid = VoxelGrid(mesh, count)
    return np.log(grid.fill(truth) / youngs_mpa), grid.inside
