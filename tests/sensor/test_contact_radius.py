"""Radii and centers of contacts, drift of the light, and presses that disagree."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from tactorch.errors import ConfigError
from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Circle,
    FitOptions,
    find_circle,
    fit_map,
    image_change,
    select_map,
)
from tactorch.sensor.calibration.align import align_contacts
from tactorch.sensor.calibration.profile import ContactProfile, fit_profile, steepest_contact
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.light import light_change

from . import ball_images as drawn

BALL = Ball(drawn.RADIUS_MM, (drawn.MM_PER_PX, drawn.MM_PER_PX))
PLACES = [(float(x), float(y)) for y in (30.4, 47.1, 64.2) for x in (32.3, 55.8, 78.1)]
EDGES = (9.0, 11.0, 13.0, 15.0, 17.0, 12.0, 14.0, 10.0, 16.0)


def presses(off_px: tuple[float, float] = (0.0, 0.0)) -> list[BallPress]:
    """Presses whose circles share an offset and are all of one wrong radius."""
    known, still = np.ones(drawn.SHAPE, dtype=bool), drawn.still()
    found = []
    for k, ((x, y), edge) in enumerate(zip(PLACES, EDGES, strict=True)):
        change = image_change(drawn.ball((x, y), edge, seed=k), still)
        circle = Circle((x + off_px[0], y + off_px[1]), 19.0)
        found.append(BallPress(f"press {k}", change, known, circle))
    return found


def test_slopes_outside_are_those_of_a_half_space() -> None:
    """The height at the edge is half the depth, Johnson (1985), for a shallow contact."""
    profile = ContactProfile(10.0, 0.5)
    inner = quad(lambda r: float(profile.slopes(np.array([r]))[0]), 0.0, 0.5)[0]
    radius = np.geomspace(0.5, 200.0, 40_000)
    sharp = profile._sharp_slopes(radius)
    assert inner == pytest.approx(0.5**2 / 20.0, rel=0.01)
    assert np.trapezoid(sharp, radius) == pytest.approx(0.5**2 / 20.0, rel=0.01)


@given(
    contact=st.floats(0.4, 1.1),
    blur=st.floats(0.03, 0.15),
    decay=st.sampled_from([0.3, 1.0, 5.0]),
)
def test_the_radius_of_a_profile_is_found(contact: float, blur: float, decay: float) -> None:
    true = ContactProfile(drawn.RADIUS_MM, contact, blur, decay * contact)
    rows, columns = np.mgrid[:96, :110]
    distance = np.hypot(columns - 52.3, rows - 47.8) * drawn.MM_PER_PX
    outward = true.slopes(distance.ravel()).reshape(distance.shape)
    found = fit_profile(outward, distance, BALL, 0.8 * contact)
    assert found.contact_mm == pytest.approx(contact, rel=0.08)
    radii = np.linspace(0.2, 1.8, 30) * contact
    np.testing.assert_allclose(found.slopes(radii), true.slopes(radii), atol=0.03)


def test_radii_and_centers_are_measured_without_labels() -> None:
    """Detected circles share an offset of 3 px and have no size; both are found.

    One image is of a ball of half the radius: it is named and left out.
    """
    given_presses = presses((2.0, -2.5))
    slope = drawn.slopes((60.0, 50.0), 9.0) * 2.5
    change = image_change(drawn.shaded(slope), drawn.still())
    circle = Circle((60.0, 50.0), 14.0)
    wrong = replace(given_presses[0], name="wrong", change=change, circle=circle)
    _, fitted = fit_map([*given_presses, wrong], BALL, FitOptions("mlp_colour", rounds=3))
    assert [press.name for press in fitted if press.outlying] == ["wrong"]
    fitted = [press for press in fitted if not press.outlying]
    off = np.array([press.contact.center_px for press in fitted]) - PLACES
    assert np.abs(off.mean(axis=0)).max() < 0.5
    assert np.hypot(*off.T).max() < 1.2
    radii = np.array([press.contact.radius_px for press in fitted])
    assert np.abs(radii - EDGES).max() < 2.0
    assert np.corrcoef(radii, EDGES)[0, 1] > 0.98


def test_a_common_offset_of_centers_is_removed() -> None:
    rough = presses((2.0, -2.5))
    aligned = align_contacts(rough, BALL, [edge * drawn.MM_PER_PX for edge in EDGES])
    off = np.array([press.contact.center_px for press in aligned]) - PLACES
    assert (np.abs(off.mean(axis=0)) < (0.6, 0.75)).all()  # 0.3 of the offset
    labeled = [replace(press, labeled=True) for press in rough]
    kept = align_contacts(labeled, BALL, [edge * drawn.MM_PER_PX for edge in EDGES])
    assert [press.contact for press in kept] == [press.circle for press in labeled]


def test_colours_tell_radii_roughly() -> None:
    for press, edge in zip(presses(), EDGES, strict=True):
        contact = steepest_contact(press, BALL)
        assert contact / drawn.MM_PER_PX == pytest.approx(edge, abs=3.0)


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (33.0, -10.0, 5.0), (-23.0, -23.0, -23.0)])
def test_drift_of_the_light_is_removed(shift: tuple[float, float, float]) -> None:
    image, still = drawn.ball((60.0, 50.0), 16.0).astype(float), drawn.still().astype(float)
    light = light_change(image + shift, still, np.ones(drawn.SHAPE, dtype=bool))
    assert not light.changed
    np.testing.assert_allclose(light.terms[:, -1], shift, atol=2.5)
    plain = np.full((*drawn.SHAPE, 3), 120, dtype=np.uint8)
    lit = (plain + np.array(shift)).astype(np.uint8)
    np.testing.assert_allclose(image_change(lit, plain), 0.0, atol=1e-6)


@pytest.mark.slow
def test_presses_at_one_position_take_a_map_of_colours_alone() -> None:
    few = [replace(press, circle=replace(press.circle, radius_px=60.0)) for press in presses()[:3]]
    name, quality = select_map(few, replace(BALL, radius_mm=4.0), FitOptions(rounds=0))
    assert name == "mlp_colour"
    assert set(quality) == {"mlp_colour"}


def test_a_gel_without_directed_light_gets_a_true_message() -> None:
    y, x = np.mgrid[-1 : 1 : 96 * 1j, -1 : 1 : 110 * 1j]
    change = np.repeat((0.4 * x * y + 0.3)[..., None], 3, axis=-1)
    with pytest.raises(ConfigError, match=r"change by up to \d+ gray values, but nowhere as steep"):
        find_circle(change, BALL, "x.png")


def test_a_thin_edge_encloses_a_deformed_face() -> None:
    """A flat object pressed by 0.3 mm, with a wide gap in its edges."""
    height = np.zeros((120, 160))
    height[40:80, 50:110] = -0.3
    slopes = np.stack([np.gradient(height, 0.1, axis=1), np.gradient(height, 0.1, axis=0)], axis=-1)
    slopes[34:46, 60:100] = 0.0
    found = reconstruct_height(slopes, (0.1, 0.1))
    assert not found.undeformed[40:80, 50:110].any()
    assert -0.35 < np.median(found.height_mm[44:76, 54:106]) < -0.2  # the gap takes its part
    assert np.abs(found.height_mm[found.undeformed]).max() < 0.03
