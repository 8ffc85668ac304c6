"""Text of findings for terminals and pages."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse import Reconstruction
from tactorch.inverse.result.text import describe, describe_lump
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 6, tets_per_cell=5)


@pytest.fixture(scope="module")
def finding(element_map: Callable[..., Reconstruction]) -> Reconstruction:
    recording = simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)
    inside = np.linalg.norm(MESH.centroids - [5, 5, 7], axis=1) < 2.5
    return element_map(recording, np.where(inside, 1.0, 0.2))


def test_a_finding_states_what_it_is_of(finding: Reconstruction) -> None:
    assert describe(finding) == f"In the element map:\n{describe_lump(finding.lumps[0])}"
    assert describe(finding, 4, 4) == describe(finding)
    assert describe(finding, 2, 4) == f"Of the first 2 of 4 presses:\n{describe(finding)}"
    unknown = replace(finding, lumps=(), reasons=("it is at a bound.",))
    assert describe(unknown, 4, 4) == "Do not trust this result: it is at a bound."
    assert describe(unknown) in unknown.summary()
