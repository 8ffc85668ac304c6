"""Text of findings for terminals, tables and pages."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse import Reconstruction
from tactorch.inverse.result.text import describe, describe_lump, summarize_finding
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 6, tets_per_cell=5)
SHAPE = {
    "side": "stiff",
    "center_mm": [5.0, 5.0, 6.0],
    "equivalent_radius_mm": 2.0,
    "mean_mpa": 0.94,
    "background_mpa": 0.2,
}
INTERVALS = {"equivalent_radius_90_mm": [1.91, 2.12], "mean_90_mpa": [0.74, 1.2]}


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


def plain(status: str, *lumps: dict[str, object]) -> dict[str, object]:
    return {"status": status, "background_mpa": 0.204, "lumps": list(lumps)}


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (plain("cannot tell"), "cannot tell"),
        (plain("nothing found"), "none; 0.204 MPa"),
        (plain("found", SHAPE), "stiff at (5.0, 5.0, 6.0) mm, radius 2.0 mm: 0.94 MPa in 0.2"),
        (
            plain("found", SHAPE | INTERVALS, SHAPE),
            "stiff at (5.0, 5.0, 6.0) mm, radius 2.0 (1.9 to 2.1) mm: 0.94 (0.74 to 1.2) MPa in "
            "0.2; 1 more",
        ),
    ],
)
def test_a_finding_fits_a_cell(values: dict[str, object], text: str) -> None:
    assert summarize_finding(values) == text


def test_the_plain_values_of_a_finding_fit_a_cell(finding: Reconstruction) -> None:
    assert summarize_finding(finding.plain()).startswith("stiff at (")
