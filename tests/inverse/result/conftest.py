"""Results that are made of known fields."""

from collections.abc import Callable

import numpy as np
import pytest

from tactorch.inverse import Reconstruction, ShapeReconstruction
from tactorch.inverse.posterior import GaussianPosterior
from tactorch.inverse.result.build import of_inclusions, with_lumps
from tactorch.recording import Recording

MakeMap = Callable[..., Reconstruction]


@pytest.fixture(scope="session")
def element_map() -> MakeMap:
    """Return a function that makes an element map of known moduli."""

    def make(
        recording: Recording, youngs: np.ndarray, posterior: GaussianPosterior | None = None
    ) -> Reconstruction:
        moved = np.zeros((0, recording.mesh.n_points, 3))
        result = Reconstruction(recording.mesh, youngs, moved, [], "known", 0.0)
        result = with_lumps(result, recording)
        return result if posterior is None else result.with_posterior(recording, posterior)

    return make


@pytest.fixture(scope="session")
def inclusions() -> Callable[[Recording, ShapeReconstruction], Reconstruction]:
    """Return a function that makes a result of known inclusions."""

    def make(recording: Recording, shapes: ShapeReconstruction) -> Reconstruction:
        return of_inclusions(recording, shapes, {}, 0.0)

    return make
