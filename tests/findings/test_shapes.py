"""Findings from shapes: found, nothing found, cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.findings import Status, build_finding, build_shape_finding
from tactorch.inverse.shapes import ShapeReconstruction
from tactorch.inverse.shapes.field import ShapeField, ShapePrior
from tactorch.inverse.shapes.fractions import Geometry
from tactorch.inverse.shapes.posterior import ShapePosterior
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 6, tets_per_cell=5)
FIELD = ShapeField(ShapePrior.of(MESH, 0.2), (True,))
VALUES = [np.log(0.2), 5.0, 5.0, 6.0, np.log(2.0), np.log(4.0), 0.3, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def recording():
    return simulate(make_phantom("uniform_cube"), PressPlan(("z+",), (0.01,)), mesh=MESH)


@pytest.fixture
def shapes():
    """An ellipsoid of 0.8 MPa in 0.2 MPa, its parameters known to 2 % of the prior."""
    return reconstruct(VALUES)


def reconstruct(values):
    z = FIELD.standard(np.array(values))
    posterior = ShapePosterior(FIELD, z, np.zeros(len(z)), 4e-4 * np.eye(len(z)))
    return ShapeReconstruction(FIELD, z, posterior, 1.0, (50.0,), 50.0)


def test_a_shape_becomes_a_lump_with_intervals(recording, shapes):
    finding = build_shape_finding(recording, shapes)
    (lump,) = finding.lumps
    (shape,) = FIELD.shapes(shapes.z)
    assert finding.status is Status.FOUND
    assert lump.inclusion.mean_mpa == pytest.approx(0.8)
    assert lump.inclusion.contrast == pytest.approx(4.0)
    assert lump.inclusion.equivalent_radius_mm == pytest.approx(2.0)
    assert lump.depth.center_mm == pytest.approx(4.0)
    assert np.prod(lump.size_mm) == pytest.approx(np.prod(2.0 * np.array(shape.semi_axes_mm)))
    low, high = lump.confidence.youngs_mpa
    deviation = 0.02 * np.hypot(FIELD.prior.background, FIELD.prior.log_contrast)
    assert np.log(high / low) == pytest.approx(2 * 1.645 * deviation, rel=0.1)
    text = finding.text()
    assert "A stiff lump at (5.00, 5.00, 6.00) mm, 4.00 mm below the pressed side z+" in text
    assert f"{low:.2g} to {high:.2g} MPa" in text
    assert "more than 99.9 %" in text


def test_a_long_shape_is_named_with_length_widths_and_direction(recording):
    axis = np.array([0.6, 0.8, 0.0])
    stretch = np.log(1.0) * np.eye(3) + np.log(4.0) * np.outer(axis, axis)
    _, log_radius, distortions = Geometry.of(np.array([5.0, 5.0, 6.0]), stretch)
    long = reconstruct([*VALUES[:4], log_radius, np.log(4.0), *distortions])
    (lump,) = build_shape_finding(recording, long).lumps
    assert lump.elongation is not None
    assert lump.elongation.length_mm == pytest.approx(8.0)
    assert lump.elongation.widths_mm == pytest.approx((2.0, 2.0))
    assert lump.elongation.direction == pytest.approx(axis)
    assert lump.plain()["direction"] == pytest.approx(axis.tolist())
    assert "A long stiff lump at (5.00, 5.00, 6.00) mm" in lump.text()
    assert "8 mm long along (0.60, 0.80, 0.00) and 2 x 2 mm across" in lump.text()
    short = build_shape_finding(recording, reconstruct(VALUES)).lumps[0]
    assert short.elongation is None
    assert "length_mm" not in short.plain()


def test_smooth_errors_of_a_palpation_are_noted(recording, shapes):
    smooth, whole = (
        build_shape_finding(recording, replace(shapes, errors={name: 0.15})).text()
        for name in ("smooth_forces", "forces")
    )
    assert "The forces differ from the model by about 15%, smoothly over the surface" in smooth
    assert "The forces of the presses are wrong by about 15%" in whole


def test_soft_shapes_are_soft(recording):
    values = [*VALUES[:5], np.log(0.25), *VALUES[6:]]
    finding = build_shape_finding(recording, reconstruct(values))
    assert finding.lumps[0].inclusion.side == "soft"
    assert "4 times as soft" in finding.text()


def test_a_doubtful_shape_is_no_lump(recording, shapes):
    finding = build_shape_finding(recording, replace(shapes, log_odds=(2.0,), log_odds_any=2.0))
    assert finding.status is Status.NOTHING
    assert finding.probability == pytest.approx(0.88, abs=0.01)
    assert finding.text().startswith("Nothing found: ")


def test_presses_that_no_model_explains_cannot_tell(recording, shapes):
    finding = build_shape_finding(recording, replace(shapes, unexplained=0.3))
    assert finding.status is Status.UNKNOWN
    assert finding.lumps == ()
    assert "30% of the displacements unexplained" in finding.text()


def test_a_map_that_is_not_to_be_trusted_cannot_tell(recording):
    youngs = np.full(MESH.n_tets, 0.2)
    youngs[:50] = 100.0
    finding = build_finding(recording, youngs, reasons=("it is at its bounds.",))
    assert finding.status is Status.UNKNOWN
    assert finding.lumps == ()
    assert finding.plain()["reasons"] == ["it is at its bounds."]


def test_a_shape_between_elements_has_the_nearest_one(recording):
    values = [*VALUES[:4], np.log(0.05), *VALUES[5:]]
    finding = build_shape_finding(recording, reconstruct(values))
    assert finding.lumps[0].inclusion.elements.sum() == 1


def test_errors_of_the_recording_are_noted(recording, shapes):
    assert build_shape_finding(recording, replace(shapes, errors={"pose": 0.002})).notes == ()
    wrong = replace(shapes, errors={"forces": 0.05, "pose": 0.01})
    finding = build_shape_finding(recording, wrong)
    assert finding.status is Status.FOUND
    assert "forces of the presses are wrong by about 5%" in finding.notes[0]
    assert "by about 1% of the displacements" in finding.notes[1]
    assert finding.text().endswith(finding.notes[1])
    assert finding.plain()["notes"] == list(finding.notes)
