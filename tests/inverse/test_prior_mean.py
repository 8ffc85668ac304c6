"""Priors about a map: the same prior, of the distance from it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.inverse import (
    PRIORS,
    Prior,
    Settings,
    ShiftedPrior,
    Smoothness,
    TotalVariation,
    invert_map,
)
from tactorch.mesh import box_mesh
from tactorch.recording import Recording

MESH = box_mesh(10.0, 2, tets_per_cell=5)
MEAN = np.random.default_rng(0).uniform(0.1, 0.9, MESH.n_tets)
WIDE = np.random.default_rng(1).uniform(0.2, 2.0, MESH.n_tets)
NAMES = ["total_variation", "smoothness", "tikhonov", "matern", "log_jumps", "composite"]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_prior_of_the_distance(name: str) -> None:
    field = np.random.default_rng(2).normal(-1.0, 0.5, MESH.n_tets)
    prior: Prior = PRIORS.build(name)
    if hasattr(prior, "level_mpa"):
        prior = PRIORS.build({"name": name, "level_mpa": 1.0})
    about, inner = ShiftedPrior(prior=prior, mean_mpa=MEAN, deviation=WIDE).on(MESH), prior.on(MESH)
    distance = (field - np.log(MEAN)) / WIDE
    assert about.value(field) == pytest.approx(inner.value(distance))
    assert about.value(np.log(MEAN)) == pytest.approx(inner.value(np.zeros(MESH.n_tets)))
    step = 1e-6 * np.random.default_rng(3).standard_normal(MESH.n_tets)
    slope = (about.value(field + step) - about.value(field - step)) / 2.0
    assert about.gradient(field) @ step == pytest.approx(slope, rel=1e-4)
    expected = inner.curvature(distance).toarray() / np.outer(WIDE, WIDE)
    np.testing.assert_allclose(about.curvature(field).toarray(), expected)


def test_a_share_of_the_prior_is_about_the_map() -> None:
    field = np.random.default_rng(2).normal(-1.0, 0.5, MESH.n_tets)
    whole = ShiftedPrior(prior=Smoothness(), mean_mpa=MEAN)
    third = replace(whole, share=1 / 3)
    about, inner, mixed = (prior.on(MESH) for prior in (whole, whole.prior, third))
    assert mixed.value(field) == pytest.approx((about.value(field) + 2 * inner.value(field)) / 3)
    expected = (about.gradient(field) + 2 * inner.gradient(field)) / 3
    np.testing.assert_allclose(mixed.gradient(field), expected)
    with pytest.raises(ConfigError, match="share=0: give a number above 0, up to 1"):
        replace(whole, share=0)


def test_halves_of_total_variation_leave_the_jumps_open() -> None:
    """Any map between a plain one and the mean costs the same, one beyond them more."""
    prior = ShiftedPrior(prior=TotalVariation(edge=1e-6), mean_mpa=MEAN, share=0.5).on(MESH)
    costs = [prior.value(part * np.log(MEAN)) for part in (0.0, 0.25, 0.5, 1.0)]
    np.testing.assert_allclose(costs, costs[0], rtol=1e-3)
    for part in (-0.2, 1.2):
        assert prior.value(part * np.log(MEAN)) > 1.1 * costs[0]


def test_a_prior_that_rules_keeps_the_mean(make_cube: Callable[..., Recording]) -> None:
    """With a large weight the map is the mean, but for one factor that total variation ignores."""
    recording = make_cube()
    assert recording.truth is not None
    mean = np.random.default_rng(0).uniform(0.2, 0.4, recording.mesh.n_tets)
    prior = ShiftedPrior(prior=TotalVariation(weight=1e12), mean_mpa=mean)
    settings = Settings(regularization=prior)
    found = invert_map(recording, settings, start_mpa=mean, show_progress=False)
    ratio = found.youngs / mean
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)
    assert not np.allclose(ratio[0], 1.0, rtol=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mean_mpa": MEAN[:-1]}, "mean_mpa has shape"),
        ({"mean_mpa": -MEAN}, "mean_mpa: give one finite number above 0"),
        ({"deviation": 0.0 * WIDE}, "deviation: give one finite number above 0"),
        ({"deviation": WIDE[:3]}, "deviation has shape"),
    ],
)
def test_wrong_means_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ShiftedPrior(**({"prior": Smoothness(), "mean_mpa": MEAN} | changes)).on(MESH)


def test_settings_with_different_maps_differ() -> None:
    one, other = (ShiftedPrior(mean_mpa=m) for m in (MEAN, np.nextafter(MEAN, 1.0)))
    assert one == ShiftedPrior(mean_mpa=MEAN.copy())
    assert one != other
    kinds = (PRIORS.build({"name": name, "weight": 1.0}) for name in ("none", "smoothness"))
    one_kind, other_kind = (ShiftedPrior(prior=p, mean_mpa=MEAN, weight=1.0) for p in kinds)
    assert one_kind != other_kind
    assert to_mapping(one) == to_mapping(ShiftedPrior(mean_mpa=MEAN.copy()))
    assert to_mapping(one) != to_mapping(other)
