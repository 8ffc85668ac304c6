"""Results by inclusions: found, nothing found, cannot tell."""

import json
from dataclasses import replace

import meshio
import numpy as np
import pytest

from tactorch.inverse import Reconstruction, Status
from tactorch.inverse.fields import BALL, ELLIPSOID, FAMILIES, ShapeField, ShapePrior
from tactorch.inverse.fields.background import Background
from tactorch.inverse.posterior.shapes import ShapePosterior
from tactorch.inverse.result.lump import Lump
from tactorch.inverse.result.shapes import Alternative, ShapeReconstruction
from tactorch.inverse.result.text import describe, describe_lump, headline, lead
from tactorch.mesh import box_mesh
from tactorch.phantoms import make_phantom
from tactorch.simulation import PressPlan, simulate

MESH = box_mesh(10.0, 6, tets_per_cell=5)
FIELD = ShapeField(ShapePrior.of(MESH, 0.2), (ELLIPSOID,))
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


def test_a_shape_becomes_a_lump_with_intervals(recording, shapes, inclusions):
    finding = inclusions(recording, shapes)
    (lump,) = finding.lumps
    (shape,) = FIELD.shapes(shapes.estimate)
    assert finding.status is Status.FOUND
    assert lump.inclusion.mean_mpa == pytest.approx(0.8, rel=5e-3)
    assert lump.inclusion.contrast == pytest.approx(4.0, rel=5e-3)
    assert lump.inclusion.equivalent_radius_mm == pytest.approx(2.0, rel=2e-3)
    assert lump.depth.center_mm == pytest.approx(4.0, abs=0.02)
    assert np.prod(lump.size_mm) == pytest.approx(np.prod(2.0 * np.array(shape.semi_axes_mm)))
    low, high = lump.confidence.youngs_mpa
    deviation = 0.02 * np.hypot(FIELD.prior.background, FIELD.prior.log_contrast)
    assert np.log(high / low) == pytest.approx(2 * 1.645 * deviation, rel=0.1)
    text = describe(finding)
    assert "A stiff lump at (5.00, 5.00, 6.00) mm, 4.00 mm below the pressed side z+" in text
    assert f"{low:.2g} to {high:.2g} MPa" in text
    assert "more than 99.9 %" in text


@pytest.mark.parametrize(
    ("name", "own", "form"),
    [
        ("ring", [0.0, 0.0, 2.5], "ring"),
        ("rod", [2.0, 0.0, 1.0], "rod"),
        ("tapered rod", [2.0, 0.0, 1.0, 0.5], "tapered rod"),
        ("bent rod", [2.0, 0.0, 0.0, 0.0, 1.0, 0.0], "bent rod"),
        ("cuboid", [0.0, 1.0, 0.1, 0.2, 0.3], "plate"),
        ("cuboid", [0.0, -1.0, 0.1, 0.2, 0.3], "bar"),
        ("cuboid", [0.1, 0.1, 0.1, 0.2, 0.3], "block"),
    ],
)
def test_a_form_is_named(recording, inclusions, name, own, form):
    field = ShapeField(FIELD.prior, (FAMILIES[name],))
    z = field.standard(np.array([*VALUES[:6], *own]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 1e-6 * np.eye(len(z)))
    result = inclusions(recording, ShapeReconstruction(field, z, posterior, 1.0, (50.0,), 50.0))
    (lump,) = result.lumps
    assert lump.form == lump.plain()["form"] == form
    assert Lump.of_stored(lump.stored(), MESH.n_tets).form == form
    center = ", ".join(f"{x:.2f}" for x in result.shapes.inclusions[0].shape.centroid_mm)
    assert f"A stiff {form} at ({center}) mm" in describe_lump(lump)
    assert headline(result).startswith(f"A stiff {form}, 4 times as stiff")


def test_an_estimate_is_within_its_interval_where_the_best_fit_is_not(recording, inclusions):
    """The best ball is smaller and stiffer than the ellipsoids of its posterior."""
    ball = ShapeField(FIELD.prior, (BALL,))
    best = ball.standard(np.array([*VALUES[:4], np.log(1.7), np.log(7.0)]))
    ellipsoids = reconstruct(VALUES).posterior
    result = inclusions(recording, ShapeReconstruction(ball, best, ellipsoids, 1.0, (9.0,), 9.0))
    (lump,) = result.lumps
    assert 1.7 < lump.confidence.radius_mm[0] < lump.inclusion.equivalent_radius_mm
    assert lump.inclusion.mean_mpa < lump.confidence.youngs_mpa[1] < 1.4
    assert np.ptp(lump.size_mm) == 0.0  # without the distortions of the posterior
    assert result.youngs.max() == pytest.approx(lump.inclusion.mean_mpa)
    low, high = result.intervals()
    assert (low <= result.youngs).all()
    assert (result.youngs <= high).all()


def test_a_long_shape_is_named_with_length_widths_and_direction(recording, inclusions):
    axis = np.array([0.6, 0.8, 0.0])
    stretch = np.log(1.0) * np.eye(3) + np.log(4.0) * np.outer(axis, axis)
    own = ELLIPSOID.values(np.array([5.0, 5.0, 6.0]), stretch, np.log(4.0))
    long = reconstruct([VALUES[0], *own])
    (lump,) = inclusions(recording, long).lumps
    assert lump.elongation is not None
    assert lump.elongation.length_mm == pytest.approx(8.0, rel=2e-3)
    assert lump.elongation.widths_mm == pytest.approx((2.0, 2.0), rel=0.02)
    assert lump.elongation.direction == pytest.approx(axis, abs=0.01)
    assert lump.plain()["direction"] == pytest.approx(axis.tolist(), abs=0.01)
    assert "A long stiff lump at (5.00, 5.00, 6.00) mm" in describe_lump(lump)
    assert "8 mm long along (0.60, 0.80, 0.00) and 2 x 2 mm across" in describe_lump(lump)
    short = inclusions(recording, reconstruct(VALUES)).lumps[0]
    assert short.elongation is None
    assert "length_mm" not in short.plain()


def test_smooth_errors_of_a_palpation_are_noted(recording, shapes, inclusions):
    smooth, whole = (
        describe(inclusions(recording, replace(shapes, errors={name: 0.15})))
        for name in ("smooth_forces", "forces")
    )
    assert "The forces differ from the model by about 15%, smoothly over the surface" in smooth
    assert "The forces of the presses are wrong by about 15%" in whole


def test_soft_shapes_are_soft(recording, inclusions):
    values = [*VALUES[:5], np.log(0.25), *VALUES[6:]]
    finding = inclusions(recording, reconstruct(values))
    assert finding.lumps[0].inclusion.side == "soft"
    assert "4 times as soft" in describe(finding)


def test_a_doubtful_shape_is_no_lump(recording, shapes, inclusions):
    finding = inclusions(recording, replace(shapes, log_odds=(2.0,), log_odds_any=2.0))
    assert finding.status is Status.NOTHING
    assert finding.probability == pytest.approx(0.88, abs=0.01)
    assert describe(finding).startswith("Nothing found: ")


@pytest.mark.parametrize(("gain", "status"), [(-0.5, Status.NOTHING), (0.5, Status.FOUND)])
def test_a_shape_that_predicts_no_held_out_presses_is_no_lump(
    recording, shapes, inclusions, gain, status
):
    doubtful = replace(shapes, predictive=(gain,))
    assert ShapeReconstruction.of(doubtful.plain()).predictive == (gain,)
    assert inclusions(recording, doubtful).status is status
    assert inclusions(recording, shapes).status is Status.FOUND  # where it is not known


def test_presses_that_no_model_explains_cannot_tell(recording, shapes, inclusions):
    finding = inclusions(recording, replace(shapes, unexplained=0.3))
    assert finding.status is Status.UNKNOWN
    assert finding.lumps == ()
    assert "30% of the displacements unexplained" in describe(finding)


def test_a_result_has_its_field_at_points_and_elements(recording, shapes, inclusions, tmp_path):
    result = inclusions(recording, shapes)
    inside, outside = np.array([[5.0, 5.0, 6.0]]), np.array([[1.0, 1.0, 1.0]])
    youngs = result.youngs_at(np.vstack([inside, outside]))
    np.testing.assert_allclose(youngs, [0.8, 0.2], rtol=5e-3)
    low, high = result.intervals()
    at = np.linalg.norm(MESH.centroids - inside, axis=1) < 0.5
    assert (low[at] < 0.8).all()
    assert (high[at] > 0.8).all()
    assert result.youngs.max() == pytest.approx(youngs[0])
    again = Reconstruction.load(result.save(tmp_path / "result.h5"))
    assert again.plain() == result.plain()
    assert describe(again) == describe(result)
    np.testing.assert_allclose(again.youngs_at(inside), youngs[:1])
    (lump,), (kept,) = result.lumps, again.lumps
    np.testing.assert_array_equal(kept.inclusion.elements, lump.inclusion.elements)
    np.testing.assert_array_equal(kept.depth.above_mm, lump.depth.above_mm)


def test_both_descriptions_are_kept_in_one_file(
    recording, shapes, inclusions, element_map, tmp_path
):
    elements = element_map(recording, np.full(MESH.n_tets, 0.3))
    result = replace(inclusions(recording, shapes), other=elements)
    again = Reconstruction.load(result.save(tmp_path / "both.h5"))
    assert (again.name, again.other.name) == ("inclusions", "element map")
    assert again.element_map is again.other
    np.testing.assert_array_equal(again.other.youngs, elements.youngs)
    fields = meshio.read(result.write_vtu(tmp_path / "both.vtu")).cell_data
    np.testing.assert_allclose(fields["youngs_mpa"][0], result.youngs)
    np.testing.assert_allclose(fields["youngs_element_map_mpa"][0], 0.3)
    assert fields["youngs_90_high_mpa"][0].max() > 0.8
    assert fields["trusted"][0].min() == 1.0


def test_shapes_of_a_file_do_not_know_how_presses_are_predicted(shapes):
    again = ShapeReconstruction.of(json.loads(json.dumps(shapes.plain())))
    assert again.held_out is None
    assert again.predictions is None
    np.testing.assert_array_equal(again.z, shapes.z)


def test_a_shape_between_elements_has_the_nearest_one(recording, inclusions):
    values = [*VALUES[:4], np.log(0.05), *VALUES[5:]]
    finding = inclusions(recording, reconstruct(values))
    assert finding.lumps[0].inclusion.elements.sum() == 1


def test_errors_of_the_recording_are_noted(recording, shapes, inclusions):
    assert inclusions(recording, replace(shapes, errors={"pose": 0.002})).warnings == ()
    wrong = replace(shapes, errors={"forces": 0.05, "pose": 0.01})
    finding = inclusions(recording, wrong)
    assert finding.status is Status.FOUND
    assert "forces of the presses are wrong by about 5%" in finding.warnings[0]
    assert "by about 1% of the displacements" in finding.warnings[1]
    assert describe(finding).endswith(finding.warnings[1])
    assert finding.plain()["warnings"] == list(finding.warnings)


@pytest.mark.parametrize("families", [(), (ELLIPSOID,)])
def test_layers_are_described_with_their_intervals(recording, inclusions, families):
    field = replace(FIELD, families=families, background=Background(steps=("z-", "x+")))
    steps = [2.5, np.log(3.0), 8.0, np.log(0.5)]
    z = field.standard(np.array([VALUES[0], *steps, *(VALUES[1:] if families else [])]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 1e-4 * np.eye(len(z)))
    odds = (50.0,) * len(families)
    shapes = ShapeReconstruction(field, z, posterior, 1.0, odds, 50.0)
    first, last = shapes.steps
    assert (first.side, last.side) == ("z-", "x+")
    assert first.place_mm == pytest.approx(2.5, abs=0.01)
    assert np.ptp(first.place_90_mm) == pytest.approx(2 * 1.645 * 0.01 * 5.0, rel=0.1)
    assert last.contrast_90.low < last.contrast < last.contrast_90.high
    finding = inclusions(recording, shapes)
    text = describe(finding)
    assert "Where z < 2.5 mm, Young's modulus is 3 times that of the rest" in text
    assert "Where x > 8 mm, Young's modulus is 0.5 times" in text
    assert finding.plain()["steps"][1]["side"] == "x+"
    if not families:
        assert "Where z < 2.5 mm" in lead(finding)


@pytest.mark.parametrize(
    ("side", "contrast", "said"),
    [
        ("z-", 8.0, "the object is stiffer, as at a base. Unless it has a layer there, import the "
         "file again with that depth, or without format.depth_mm"),
        ("x+", 0.2, "the object is softer, as where it is deeper. Unless it has a layer there, "
         "import the file again with a larger depth, or without format.depth_mm"),
    ],
)  # fmt: skip
def test_a_stated_depth_that_the_forces_contradict_is_said(
    recording, inclusions, side, contrast, said
):
    field = replace(FIELD, families=(), background=Background(steps=(side,)))
    place = 2.5 if side == "z-" else 7.5
    z = field.standard(np.array([VALUES[0], place, np.log(contrast)]))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 1e-4 * np.eye(len(z)))
    shapes = ShapeReconstruction(field, z, posterior, 1.0, (), 50.0)
    stated = replace(recording, provenance={"depth_mm": 8.0, "block": True})
    (warning,) = inclusions(stated, shapes).warnings
    assert warning.startswith("The forces contradict the stated depth (format.depth_mm=8): from a")
    assert "depth of 5.5 mm (90 %: 5.4" in warning
    assert said in warning
    for provenance in ({"depth_mm": None, "block": True}, {"depth_mm": 8.0, "block": False}, {}):
        assert not inclusions(replace(recording, provenance=provenance), shapes).warnings


def test_alternatives_are_described_with_their_probabilities(recording, shapes, inclusions):
    rods = replace(FIELD, families=(FAMILIES["rod"], FAMILIES["ball"]))
    own = [*VALUES[:6], 0.0, 3.0, 0.0, 2.0, 2.0, 2.0, 0.0, np.log(0.5)]
    rod = alternative(0.3, rods, own)
    skin = replace(FIELD, families=(), background=Background(steps=("z+", "z+")))
    step = alternative(0.1, skin, [VALUES[0], 9.0, np.log(2.0), 8.0, np.log(3.0)])
    finding = inclusions(recording, replace(shapes, alternatives=(rod, step)))
    text = describe(finding)
    assert "has a probability of 60 %; or there is a stiff rod at (5.0, 5.0, 6.0) mm, " in text
    assert ", 4 times as stiff as its surroundings and a soft lump at (2.0, 2.0, 2.0)" in text
    assert "2 times as soft as its surroundings (30 %), or a step to 2 times the modulus " in text
    assert text.endswith("where z > 8 mm (10 %).")
    first, second = json.loads(json.dumps(finding.plain()))["alternatives"]
    assert first["probability"] == 0.3
    assert [lump["form"] for lump in first["lumps"]] == ["rod", "lump"]
    assert second["steps"][1] == {"side": "z+", "place_mm": 8.0, "contrast": pytest.approx(3.0)}
    assert "Other models" not in describe(inclusions(recording, shapes))
    doubtful = replace(shapes, alternatives=(rod,), log_odds=(0.0,))
    assert "Other models" not in describe(inclusions(recording, doubtful))


def test_the_estimate_is_the_best_fit_where_medians_do_not_belong_together(
    recording, shapes, inclusions
):
    best = replace(shapes, z=shapes.z + 0.1)
    assert np.abs(best.estimate - shapes.z).max() < 0.01
    apart = replace(best, at_medians=False)
    np.testing.assert_array_equal(apart.estimate, best.z)
    assert "together only" in describe(inclusions(recording, apart))
    assert "together only" not in describe(inclusions(recording, best))
    assert not ShapeReconstruction.of(json.loads(json.dumps(apart.plain()))).at_medians


def test_intervals_include_alternatives_with_as_many_inclusions(shapes):
    """With half the probability an ellipsoid of half the modulus, 1 mm higher."""
    other = [*VALUES[:3], 7.0, VALUES[4], np.log(2.0), *VALUES[6:]]
    two = alternative(0.4, replace(FIELD, families=(ELLIPSOID, BALL)), [*VALUES, *VALUES[1:6]])
    half = alternative(0.5, FIELD, other)
    (alone,), (mixed,) = shapes.inclusions, replace(shapes, alternatives=(half,)).inclusions
    assert alone.youngs_90_mpa.low > 0.7
    assert mixed.youngs_90_mpa.low == pytest.approx(0.4, rel=0.1)
    assert mixed.youngs_90_mpa.high == pytest.approx(0.8, rel=0.1)
    assert mixed.center_deviation_mm[2] == pytest.approx(0.5, rel=0.1)
    assert mixed.youngs_mpa == alone.youngs_mpa
    (same,) = replace(shapes, alternatives=(two,)).inclusions
    assert same.youngs_90_mpa == alone.youngs_90_mpa


def alternative(probability, field, values):
    """Return an alternative whose parameters are known to 2 % of the prior."""
    z = field.standard(np.array(values))
    posterior = ShapePosterior(field, z, np.zeros(len(z)), 4e-4 * np.eye(len(z)))
    return Alternative(probability, field, z, posterior)
