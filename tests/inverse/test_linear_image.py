"""The linear image against linear theory, and as a map."""

from collections.abc import Callable

import numpy as np

from tactorch.inverse import InverseProblem
from tactorch.inverse.fit.linear_image import _prior_precision, linear_image, linear_map
from tactorch.mesh import VoxelGrid, box_mesh
from tactorch.recording import Recording

COUNT = 4


def test_the_image_is_that_of_linear_theory(cube: Recording) -> None:
    """Against the same posterior by the other formula, C J^T (J C J^T + R)^-1 d."""
    problem = InverseProblem(cube)
    found = problem.evaluate(np.full(problem.n_elements, 0.3))
    deviations = problem.noise.deviations(cube)
    image, explained = linear_image(found, cube.mesh, deviations, COUNT)
    C = np.linalg.inv(_prior_precision(COUNT))
    scale = np.concatenate([seen.scale for seen in problem.data.observations])
    cells = VoxelGrid(cube.mesh, COUNT).element_weights.toarray()
    J = 0.3 * (found.jacobian() / scale[:, None]) @ cells
    noise = [
        np.full(len(d), s**2 + np.mean((0.02 * d) ** 2))
        for d, s in ((found.data.observations[i].values, s) for i, s in enumerate(deviations))
    ]
    gain = C @ J.T @ np.linalg.inv(J @ C @ J.T + np.diag(np.concatenate(noise)))
    np.testing.assert_allclose(image.ravel(), -gain @ (found.residuals / scale), atol=1e-6)
    left = C - gain @ J @ C
    expected = 1.0 - left.diagonal() / C.diagonal()
    np.testing.assert_allclose(explained.ravel(), expected, atol=1e-6)


def test_cells_interpolate_linear_fields() -> None:
    """Exactly between the centres of the outer cells, and with their value beyond."""
    mesh = box_mesh(6.0, 5, center_mm=(3.0, 3.0, 3.0), tets_per_cell=5)
    axis = np.arange(3) * 2.0 + 1.0
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    found = VoxelGrid(mesh, 3).at_elements(x + 2 * y - z)
    held = np.clip(mesh.centroids, 1.0, 5.0)
    np.testing.assert_allclose(found, held @ [1.0, 2.0, -1.0], atol=1e-12)


def test_the_map_shows_the_ball(make_cube: Callable[..., Recording]) -> None:
    recording = make_cube(snr_db=40.0)
    found = np.log(linear_map(recording))
    assert recording.truth is not None
    assert np.corrcoef(found, np.log(recording.truth))[0, 1] > 0.7
