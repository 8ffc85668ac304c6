"""Lumps, depths and their text on maps that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError, MeshError
from tactorch.inverse import Reconstruction, Status, find_lumps
from tactorch.inverse.result.build import with_lumps
from tactorch.inverse.result.lump import measure_depth
from tactorch.inverse.result.text import describe
from tactorch.mesh import box_mesh, face_nodes
from tactorch.metrics import dice, position_error_mm
from tactorch.recording import MaterialSpec, Press, Recording

MESH = box_mesh(10.0, 8)


def ball(center, radius, inside, outside=0.2):
    near = np.linalg.norm(MESH.centroids - np.array(center), axis=1) < radius
    return np.where(near, inside, outside), near


def press(face="z+", force=0.1):
    axis, sign = "xyz".index(face[0]), -1.0 if face[1] == "+" else 1.0
    forces = np.zeros((MESH.n_points, 3))
    forces[face_nodes(MESH, face), axis] = sign * force
    observed = forces != 0
    held = np.zeros((MESH.n_points, 3), dtype=bool)
    held[face_nodes(MESH, face[0] + ("-" if face[1] == "+" else "+"))] = True
    return Press(forces, observed, 0.01 * forces, fixed=held, noise_mm=1e-3)


def test_a_ball_of_two_levels_is_cut_exactly():
    youngs, inside = ball((4, 5, 7), 2.2, 1.0)
    (lump,) = find_lumps(MESH, youngs)
    assert np.array_equal(lump.elements, inside)
    assert lump.side == "stiff"
    assert lump.contrast == pytest.approx(5.0)


@pytest.mark.parametrize(("inside", "side"), [(1.0, "stiff"), (0.04, "soft")])
def test_wild_elements_do_not_move_the_threshold(inside, side):
    youngs, mask = ball((4, 5, 7), 2.2, inside)
    wild = np.flatnonzero(mask)[::7]
    youngs[wild] = 100.0 if side == "stiff" else 0.001
    (lump,) = find_lumps(MESH, youngs)
    assert lump.side == side
    assert np.array_equal(lump.elements, mask)


@pytest.mark.parametrize("blur_mm", [0.5, 1.5, 3.0])
def test_scores_measure_the_lump_that_is_found(blur_mm):
    """A blurred map with some elements at the bounds: one segmentation for both."""
    center = np.array([4.0, 5.0, 6.0])
    distance = np.linalg.norm(MESH.centroids - center, axis=1)
    truth = np.where(distance < 2.2, 1.0, 0.2)
    youngs = 0.2 * np.exp(np.log(3.0) / (1.0 + np.exp((distance - 2.6) / (0.3 * blur_mm))))
    youngs[np.flatnonzero(distance < 1.5)[::9]] = 50.0
    (lump,) = find_lumps(MESH, youngs)
    inside = truth > 0.5
    volumes, both = MESH.volumes, lump.elements & inside
    overlap = 2.0 * volumes[both].sum() / (volumes[lump.elements].sum() + volumes[inside].sum())
    assert dice(MESH, youngs, truth) == pytest.approx(overlap)
    assert dice(MESH, youngs, truth) < 1.0
    center_mm = volumes[lump.elements] @ MESH.centroids[lump.elements] / lump.volume_mm3
    true_mm = volumes[inside] @ MESH.centroids[inside] / volumes[inside].sum()
    error = np.linalg.norm(center_mm - true_mm)
    assert position_error_mm(MESH, youngs, truth) == pytest.approx(error)


def test_two_lumps_of_either_kind_are_ranked_by_contrast_and_size():
    stiff, first = ball((2.5, 2.5, 2.5), 1.8, 1.0)
    youngs = np.where(ball((7, 7, 7), 2.6, 0.02)[1], 0.02, stiff)
    found = find_lumps(MESH, youngs)
    assert [lump.side for lump in found] == ["soft", "stiff"]
    assert np.array_equal(found[1].elements, first)
    assert [lump.side for lump in find_lumps(MESH, youngs, side="stiff")] == ["stiff"]
    assert len(find_lumps(MESH, youngs, max_lumps=1)) == 1


def test_what_is_faint_beside_another_is_left_out():
    stiff, first = ball((2.5, 2.5, 2.5), 1.8, 1.0)
    faint = ball((7, 7, 7), 2.6, 0.19)[1]
    (lump,) = find_lumps(MESH, np.where(faint, 0.19, stiff))
    assert np.array_equal(lump.elements, first)
    assert len(find_lumps(MESH, np.where(faint, 0.19, 0.2))) == 1


def test_specks_are_left_out():
    youngs, _ = ball((4, 5, 7), 2.2, 1.0)
    youngs[0] = 1.0
    assert len(find_lumps(MESH, youngs)) == 1
    assert len(find_lumps(MESH, youngs, min_volume_fraction=0.0)) == 2


def test_nothing_is_found_in_a_uniform_body(element_map):
    assert find_lumps(MESH, np.full(MESH.n_tets, 0.2)) == []
    finding = element_map(recording(), np.full(MESH.n_tets, 0.2))
    assert finding.status is Status.NOTHING
    assert describe(finding).startswith("Nothing found: ")
    assert finding.plain()["status"] == "nothing found"


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    spread=st.floats(0.0, 4.0),
    kept=st.sampled_from([1, 2, 50, MESH.n_tets]),
    level=st.floats(1e-3, 1e2),
)
def test_whatever_the_map_the_lumps_are_parts_that_stand_out(seed, spread, kept, level):
    rng = np.random.default_rng(seed)
    logs = spread * rng.standard_normal(MESH.n_tets)
    logs[rng.permutation(MESH.n_tets)[kept:]] = 0.0
    youngs = level * np.exp(logs)
    lumps = find_lumps(MESH, youngs)
    assert len(lumps) <= 5
    taken = np.zeros(MESH.n_tets)
    for lump in lumps:
        taken += lump.elements
        assert (lump.contrast > 1) == (lump.side == "stiff")
        assert np.all(lump.center_mm >= 0)
        assert np.all(lump.center_mm <= 10)
        assert lump.volume_mm3 == pytest.approx(MESH.volumes[lump.elements].sum())
    assert taken.max(initial=0) <= 1
    # Another unit of the modulus changes nothing but the moduli.
    again = find_lumps(MESH, 3.0 * youngs)
    assert [np.flatnonzero(a.elements).tolist() for a in again] == [
        np.flatnonzero(b.elements).tolist() for b in lumps
    ]


def test_bad_input_is_refused():
    with pytest.raises(MeshError):
        find_lumps(MESH, np.ones(3))
    with pytest.raises(MeshError, match="above 0"):
        find_lumps(MESH, np.zeros(MESH.n_tets))
    with pytest.raises(ConfigError, match="max_lumps=0"):
        find_lumps(MESH, np.ones(MESH.n_tets), max_lumps=0)
    with pytest.raises(ConfigError, match="no element"):
        measure_depth(MESH, [press()], np.full(3, 5.0), np.zeros(MESH.n_tets, dtype=bool))


def recording(*faces):
    presses = tuple(press(face) for face in faces or ("z+",))
    return Recording(MESH, presses, MaterialSpec("neo_hookean", 0.45), check_units=False)


def test_depth_is_under_the_nearest_pressed_side():
    youngs, _ = ball((4, 5, 7), 2.2, 1.0)
    (lump,) = find_lumps(MESH, youngs)
    depth = measure_depth(MESH, recording("x+", "z+").presses, lump.center_mm, lump.elements)
    assert depth is not None
    assert depth.face == "z+"
    assert depth.center_mm == pytest.approx(10.0 - lump.center_mm[2])
    assert depth.cover_mm < depth.center_mm
    only_x = measure_depth(MESH, recording("x+").presses, lump.center_mm, lump.elements)
    assert only_x is not None
    assert only_x.face == "x+"
    assert only_x.center_mm == pytest.approx(10.0 - lump.center_mm[0])


def test_slanted_pushes_have_no_side():
    forces = np.zeros((MESH.n_points, 3))
    forces[face_nodes(MESH, "z+")] = [0.1, 0.0, -0.1]
    slanted = Press(forces, forces != 0, 0.01 * forces, noise_mm=1e-3, fixed=press().fixed)
    _, inside = ball((5, 5, 7), 2.2, 1.0)
    depth = measure_depth(MESH, [slanted], np.array([5.0, 5.0, 7.0]), inside)
    assert depth is not None
    assert depth.face == ""
    assert depth.center_mm == pytest.approx(3.0 * np.sqrt(2), abs=0.5)


def test_the_text_says_where_how_large_and_how_stiff(element_map):
    youngs, _ = ball((4, 5, 7), 2.2, 1.0)
    finding = element_map(recording(), youngs)
    text = describe(finding)
    assert "A stiff lump at (" in text
    assert "below the pressed side z+" in text
    assert "5 times as stiff" in text
    lump = finding.lumps[0]
    assert lump.plain()["under"] == "z+"
    assert lump.size_mm == pytest.approx(np.full(3, 4.4), abs=0.4)


def test_the_size_is_that_along_each_axis(element_map):
    centred = (MESH.centroids - [5, 5, 5]) / [3.0, 2.0, 1.5]
    youngs = np.where((centred**2).sum(axis=1) < 1, 1.0, 0.2)
    size = element_map(recording(), youngs).lumps[0].size_mm
    assert size == pytest.approx([6.0, 4.0, 3.0], abs=0.5)


@pytest.mark.parametrize(("height_mm", "is_trusted"), [(1.25, True), (2.5, False)])
def test_a_quarter_of_a_map_at_a_bound_is_not_trusted(height_mm, is_trusted):
    youngs = np.where(MESH.centroids[:, 2] < height_mm, 0.01, 0.2)
    bounds = {"settings": {"bounds": {"lower": 0.01, "upper": 10.0}}}
    moved = np.zeros((0, MESH.n_points, 3))
    map_ = Reconstruction(MESH, youngs, moved, [], "known", 0.0, config=bounds)
    found = with_lumps(map_, recording())
    assert (found.status is not Status.UNKNOWN) == is_trusted
    assert is_trusted or "25% of the map" in found.reasons[0]
