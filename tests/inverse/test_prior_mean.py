"""Priors about a map: the same prior, of the distance from it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse import GaussNewton, PriorOptions, Settings, invert, make_regularizer
from tactorch.mesh import box_mesh
from tactorch.plain import plain
from tactorch.recording import Recording

MESH = box_mesh(10.0, 2, tets_per_cell=5)
MEAN = np.random.default_rng(0).uniform(0.1, 0.9, MESH.n_tets)
WIDE = np.random.default_rng(1).uniform(0.2, 2.0, MESH.n_tets)
NAMES = ["total_variation", "smoothness", "tikhonov", "matern", "log_jumps", "composite"]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_prior_of_the_distance(name: str) -> None:
    field = np.random.default_rng(2).normal(-1.0, 0.5, MESH.n_tets)
    about = make_regularizer(
        name, MESH, options=PriorOptions(mean_mpa=MEAN, mean_deviation=WIDE, level_mpa=1.0)
    )
    inner = make_regularizer(name, MESH, options=PriorOptions(level_mpa=1.0))
    distance = (field - np.log(MEAN)) / WIDE
    assert about.name == name
    assert about.value(field) == pytest.approx(inner.value(distance))
    assert about.value(np.log(MEAN)) == pytest.approx(inner.value(np.zeros(MESH.n_tets)))
    step = 1e-6 * np.random.default_rng(3).standard_normal(MESH.n_tets)
    slope = (about.value(field + step) - about.value(field - step)) / 2.0
    assert about.gradient(field) @ step == pytest.approx(slope, rel=1e-4)
    expected = inner.curvature(distance).toarray() / np.outer(WIDE, WIDE)
    np.testing.assert_allclose(about.curvature(field).toarray(), expected)


def test_a_share_of_the_prior_is_about_the_map() -> None:
    field = np.random.default_rng(2).normal(-1.0, 0.5, MESH.n_tets)
    whole, none = PriorOptions(mean_mpa=MEAN), PriorOptions()
    third = replace(whole, mean_share=1 / 3)
    about, inner, mixed = (
        make_regularizer("smoothness", MESH, options=one) for one in (whole, none, third)
    )
    assert mixed.value(field) == pytest.approx((about.value(field) + 2 * inner.value(field)) / 3)
    expected = (about.gradient(field) + 2 * inner.gradient(field)) / 3
    np.testing.assert_allclose(mixed.gradient(field), expected)
    with pytest.raises(ConfigError, match="mean_share=0 must be above 0, up to 1"):
        replace(whole, mean_share=0)


def test_halves_of_total_variation_leave_the_jumps_open() -> None:
    """Any map between a plain one and the mean costs the same, one beyond them more."""
    options = PriorOptions(mean_mpa=MEAN, mean_share=0.5)
    prior = make_regularizer("total_variation", MESH, edge=1e-6, options=options)
    costs = [prior.value(part * np.log(MEAN)) for part in (0.0, 0.25, 0.5, 1.0)]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-3)
    for part in (-0.2, 1.2):
        assert prior.value(part * np.log(MEAN)) > 1.1 * costs[0]


def test_a_prior_that_rules_keeps_the_mean(make_cube: Callable[..., Recording]) -> None:
    """With a large weight the map is the mean, but for one factor that total variation ignores."""
    recording = make_cube()
    assert recording.truth is not None
    mean = np.random.default_rng(0).uniform(0.2, 0.4, recording.mesh.n_tets)
    settings = Settings(GaussNewton(weight=1e12), prior=PriorOptions(mean_mpa=mean))
    found = invert(recording, settings, start_mpa=mean, show_progress=False)
    ratio = found.youngs / mean
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)
    assert not np.allclose(ratio[0], 1.0, rtol=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mean_mpa": MEAN[:-1]}, "mean_mpa has shape"),
        ({"mean_mpa": -MEAN}, "mean_mpa must be above 0"),
        ({"mean_deviation": 0.0 * WIDE}, "deviation must be above 0"),
        ({"mean_deviation": WIDE[:3]}, "deviation has shape"),
    ],
)
def test_wrong_means_are_refused(changes: dict, message: str) -> None:
    options = replace(PriorOptions(mean_mpa=MEAN), **changes)
    with pytest.raises(ConfigError, match=message):
        make_regularizer("smoothness", MESH, options=options)


def test_settings_tell_maps_apart() -> None:
    one, other = (plain(PriorOptions(mean_mpa=m)) for m in (MEAN, np.nextafter(MEAN, 1.0)))
    assert one == plain(PriorOptions(mean_mpa=MEAN.copy()))
    assert one != other
