"""Define a prior: a symmetric object.

Many objects are symmetric about a plane. A prior that favours symmetric maps transfers what the
presses on one side show to the other side.

A prior is a dataclass of settings with a method `on(mesh)`, which returns the penalty on the field
of log-moduli of an element map: its value, gradient and curvature. This one is half the squared
difference of each element and its mirror image, added to total variation.
"""

from dataclasses import dataclass

import scipy.sparse as sp
from scipy.spatial import cKDTree

from tactorch import PressPlan, Settings, invert, make_phantom, simulate
from tactorch.config import option
from tactorch.inverse import CompositePenalty, Prior, Quadratic, Regularizer, TotalVariation
from tactorch.mesh import TetMesh
from tactorch.metrics import pearson


@dataclass(frozen=True, kw_only=True)
class Mirrored(Prior):
    """Total variation, and the squared difference from the image in the plane x = 5 mm."""

    share: float = option(1.0, "Weight of the symmetry relative to total variation", gt=0)

    def on(self, mesh: TetMesh) -> Regularizer:
        """Find each element's mirror image: the element nearest to the image of its centroid."""
        images = mesh.centroids.copy()
        images[:, 0] = 10.0 - images[:, 0]
        nearest = cKDTree(mesh.centroids).query(images)[1]
        identity = sp.identity(mesh.n_tets, format="csr")
        difference = identity - identity[nearest]
        symmetry = Quadratic(difference.T @ difference)
        return CompositePenalty([(1.0, TotalVariation().on(mesh)), (self.share, symmetry)])


def main() -> dict[str, float]:
    """Press one side of a cube with a ball in its middle; invert without and with the mirror."""
    phantom = make_phantom("cube_sphere", depth=0.5, radius=0.25)
    recording = simulate(
        phantom,
        PressPlan(["x+"], [0.02]),  # 20 kPa, from one side only
        mesh=phantom.mesh(2.5),
        fine_mesh=phantom.mesh(1.25),
        samples=4,
        snr_db=40,
    )
    found = {}
    for name, prior in (("total variation", TotalVariation()), ("mirrored", Mirrored())):
        result = invert(recording, Settings(regularization=prior, method="map"))
        found[name] = pearson(result.youngs, recording.truth)
        print(f"{name:<16} correlation with the truth {found[name]:.3f}")
    return found


if __name__ == "__main__":
    main()
