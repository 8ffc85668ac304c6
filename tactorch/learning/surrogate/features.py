"""Features of a recording for the surrogate: dimensionless fields on a grid over the object.

Displacements are divided by their root mean square, tractions by the best uniform modulus, and
lengths by the bounding box, so that the features do not depend on size and stiffness.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from tactorch.errors import ConfigError
from tactorch.inverse import Bounds, InverseProblem, NoiseModel
from tactorch.inverse.fit.linear_image import linear_image
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.recording import Press, Recording

#: Channels of each press; a vector field is named by its components.
PRESS_CHANNELS = (
    "residual_x", "residual_y", "residual_z",  # observed minus predicted by the uniform map
    "displacement_x", "displacement_y", "displacement_z",
    "traction_x", "traction_y", "traction_z",
    "observed", "supported", "strain", "noise",
)  # fmt: skip
#: Indices of the first components of the vector fields in `PRESS_CHANNELS`.
PRESS_VECTORS = (0, 3, 6)
#: Channels of the object.
SHARED_CHANNELS = ("occupancy", "image", "explained", "compressibility")
VERSION = 2
_MIN_COMPRESSIBILITY = 1e-3  # lower limit of 1 - 2 nu
_MIN_COSINE = 0.9  # between loads of the same press location
_MIN_WEIGHT = 1e-6  # of the nodes in a cell


class Features(NamedTuple):
    """Features of an object and its presses, on a grid over its bounding box.

    `youngs_mpa` is the uniform modulus that fits best; `presses` are the `PRESS_CHANNELS` of each
    press, `shared` the `SHARED_CHANNELS`.
    """

    youngs_mpa: float
    presses: Float[np.ndarray, "k c v v v"]
    shared: Float[np.ndarray, "s v v v"]


def compute_features(
    recording: Recording,
    count: int = 8,
    frames: int = 1,
    *,
    noise: NoiseModel | None = None,
    bounds: Bounds | None = None,
) -> Features:
    """Return the features of a recording.

    Its truth is not used. The grid has `count` cells in each direction; of each press location,
    the `frames` load steps of largest load are used. `ConvergenceError` is raised if the
    presses have an equilibrium with no uniform modulus.
    """
    if count < 2 or count % 2 or frames < 1:
        raise ConfigError(f"count={count} must be even and at least 2, frames={frames} at least 1.")
    selected = recording.select(select_strongest(recording, frames))
    problem = InverseProblem(selected, noise=noise)
    fit = uniform_fit(problem, bounds)
    evaluation = problem.evaluate(np.full(problem.n_elements, fit.youngs_mpa))
    deviations = problem.noise.deviations(selected)
    grid = VoxelGrid(selected.mesh, count)
    presses = [
        _press_features(press, evaluation.reported[i], deviations[i], grid, fit.youngs_mpa)
        for i, press in enumerate(selected.presses)
    ]
    image, explained = linear_image(evaluation, selected.mesh, deviations, count)
    compressibility = max(_MIN_COMPRESSIBILITY, 1.0 - 2.0 * recording.material.poisson)
    uniform = np.full_like(image, np.log10(compressibility))
    shared = np.stack([occupancy(selected.mesh, count), image, explained, uniform])
    return Features(fit.youngs_mpa, np.stack(presses), shared)


def select_strongest(recording: Recording, frames: int) -> list[int]:
    """Return the indices of the `frames` presses of largest load at each location, ascending.

    Presses have the same location if their loads are proportional (cosine of at least 0.9 over all
    nodes) and their supports are the same.
    """
    loads = [_load(press) for press in recording.presses]
    norms = [float(np.linalg.norm(load)) for load in loads]
    groups: list[list[int]] = []
    for i, press in enumerate(recording.presses):
        for group in groups:
            first = recording.presses[group[0]]
            parallel = loads[i] @ loads[group[0]] >= _MIN_COSINE * norms[i] * norms[group[0]]
            if parallel and np.array_equal(press.held, first.held):
                group.append(i)
                break
        else:
            groups.append([i])
    strongest = [sorted(group, key=lambda i: -norms[i])[:frames] for group in groups]
    return sorted(i for group in strongest for i in group)


def _load(press: Press) -> Float[np.ndarray, " dofs"]:
    """Return the load of a press: forces, else prescribed or observed displacements."""
    for field in (press.forces, press.prescribed):
        if field.any():
            return field.ravel()
    return np.where(press.data, press.displacement, 0.0).ravel()


def occupancy(mesh: TetMesh, count: int) -> Float[np.ndarray, "v v v"]:
    """Return the fraction of each cell inside the body, from eight points per cell."""
    inside = VoxelGrid(mesh, 2 * count).inside.reshape(count, 2, count, 2, count, 2)
    return inside.mean(axis=(1, 3, 5))


def _press_features(
    press: Press,
    predicted: Float[np.ndarray, "n 3"],
    deviation: float,
    grid: VoxelGrid,
    youngs_mpa: float,
) -> Float[np.ndarray, "c v v v"]:
    """Return the channels of a press, given the displacement of the uniform map."""
    data = press.data if press.weights is None else press.data & (press.weights > 0)
    # Components that were not observed take the displacement of the uniform map.
    displacement = np.where(data, press.displacement, predicted)
    observed = np.asarray(data.any(axis=1))
    scale = max(float(np.sqrt(np.mean(displacement[data] ** 2))), deviation)
    weight = grid.splat(observed.astype(float)[:, None])[0]
    mask = weight > _MIN_WEIGHT
    normalization = np.where(mask, 1.0 / np.maximum(weight, _MIN_WEIGHT), 0.0)
    force = float(np.prod(grid.size_mm)) ** (2.0 / 3.0) * youngs_mpa  # N; area of a side times E
    supported = grid.splat(press.held.any(axis=1).astype(float)[:, None])[0] > _MIN_WEIGHT
    strain = scale / (float(np.mean(grid.size_mm)) * grid.count)
    noise = np.log10(max(deviation / scale, 1e-6))
    factor = observed[:, None] / scale
    residual = grid.splat((displacement - predicted) * factor) * normalization
    scaled = grid.splat(displacement * factor) * normalization
    scalars = np.stack([mask * 1.0, supported.astype(float), mask * strain, mask * noise])
    return np.concatenate([residual, scaled, grid.splat(press.forces) / force, scalars])


def compute_targets(
    mesh: TetMesh, truth: Float[np.ndarray, " m"], youngs_mpa: float, count: int
) -> tuple[Shaped[np.ndarray, "v v v"], Shaped[np.ndarray, "v v v"]]:
    """Return log E relative to a modulus on a grid, and the mask of the voxels in the body."""
    grid = VoxelGrid(mesh, count)
    return np.log(grid.fill(truth) / youngs_mpa), grid.inside
