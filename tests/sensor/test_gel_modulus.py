"""The gel's modulus from known loads: found, with how far to trust it, or refused with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.sensor.calibration import KnownLoad, calibrate_modulus
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel import GelModel, GelOptions

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(10.0, 10.0))
CELLS = GelOptions(1.25, 2, "tet4")
NOISE = 0.003


@pytest.fixture(scope="module")
def model() -> GelModel:
    """States 0.2 MPa."""
    return GelModel(GEL, CELLS)


@pytest.fixture(scope="module")
def presses() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Displacement, total force and touched nodes of two presses on a gel of 0.35 MPa."""
    stiffer = GelModel(replace(GEL, youngs_mpa=0.35), CELLS)
    found = []
    for radius, pressure in ((2.6, 0.03), (1.9, 0.05)):
        touched = np.linalg.norm(stiffer.points[:, :2], axis=1) < radius
        forces = np.where(touched[:, None], (0.1, 0.0, -1.0), 0.0) * pressure
        forces = forces * stiffer.gel_mesh.face_areas[:, None]
        moved = stiffer._equilibrium(forces).result.displacement[stiffer.gel_mesh.face]
        found.append((moved, forces.sum(axis=0), touched))
    return found


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("along_z", [True, False])
def test_the_modulus_is_found(model: GelModel, presses: list, smooth: bool, along_z: bool) -> None:
    loads = [
        KnownLoad(moved, force[2] if along_z else force, 0.01, touched)
        for moved, force, touched in presses
    ]
    found = calibrate_modulus(model, loads, 1e-5, smooth=smooth, mesh_error=0.0)
    assert found.youngs_mpa == pytest.approx(0.35, rel=1e-3)
    assert found.freedom == (1 if along_z else 5)
    assert found.chi2 < 0.01
    assert found.consistent
    np.testing.assert_allclose(found.forces_n, [p[1] for p in presses], atol=2e-3)


@pytest.mark.parametrize("smooth", [True, False])
def test_stated_deviations_cover_the_truth(model: GelModel, presses: list, smooth: bool) -> None:
    """Two presses with noise of displacement and load, over seeds."""
    scores, chi2s = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        loads = []
        for moved, force, touched in presses:
            noisy = moved + rng.normal(0, NOISE, moved.shape)
            loads.append(KnownLoad(noisy, force[2] + rng.normal(0, 0.004), 0.004, touched))
        found = calibrate_modulus(model, loads, NOISE, smooth=smooth, mesh_error=0.0)
        scores.append((found.youngs_mpa - 0.35) / found.random_mpa)
        chi2s.append(found.chi2)
        assert found.deviation_mpa == found.random_mpa
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.45)
    assert abs(np.mean(scores)) < 0.7  # mean of 20: deviation 0.22
    assert np.mean(chi2s) == pytest.approx(1.0, abs=0.9)


def test_presses_that_disagree_show(model: GelModel, presses: list) -> None:
    (one, force, touched), (two, other, where) = presses
    loads = [KnownLoad(one, force, 0.003, touched), KnownLoad(two, 1.3 * other, 0.003, where)]
    found = calibrate_modulus(model, loads, 1e-4)
    assert found.chi2 > 50
    assert not found.consistent
    first, second = (calibrate_modulus(model, [load], 1e-4).youngs_mpa for load in loads)
    assert first < found.youngs_mpa < second


def test_the_surer_press_counts_more(model: GelModel, presses: list) -> None:
    (one, force, touched), (two, other, where) = presses
    loads = [KnownLoad(one, force, 0.001, touched), KnownLoad(two, 1.1 * other, 0.1, where)]
    found = calibrate_modulus(model, loads, 1e-4)
    assert found.youngs_mpa == pytest.approx(0.35, rel=3e-3)
    alone = calibrate_modulus(model, loads[:1], 1e-4)
    assert found.random_mpa < alone.random_mpa
    assert alone.freedom == 2


@settings(max_examples=5, deadline=None)
@given(scale=st.floats(0.1, 8.0))
def test_the_modulus_goes_with_the_load(model: GelModel, presses: list, scale: float) -> None:
    """And so does its deviation, if that of the load does."""
    moved, force, touched = presses[0]
    base = calibrate_modulus(model, [KnownLoad(moved, force, 0.01, touched)], NOISE)
    load = KnownLoad(moved, scale * force, scale * 0.01, touched)
    found = calibrate_modulus(model, [load], NOISE)
    assert found.youngs_mpa == pytest.approx(scale * base.youngs_mpa, rel=1e-6)
    assert found.deviation_mpa == pytest.approx(scale * base.deviation_mpa, rel=1e-6)
    assert found.chi2 == pytest.approx(base.chi2, rel=1e-5)


def test_what_was_stated_before_is_no_matter(model: GelModel, presses: list) -> None:
    moved, force, touched = presses[0]
    load = KnownLoad(moved + 0.0, force, 0.01, touched)
    softer = GelModel(replace(GEL, youngs_mpa=0.05), CELLS)
    one, other = (calibrate_modulus(m, [load], NOISE) for m in (model, softer))
    assert one.youngs_mpa == pytest.approx(other.youngs_mpa, rel=1e-4)


def test_the_mesh_is_counted_once(model: GelModel, presses: list) -> None:
    moved, force, touched = presses[0]
    loads = [KnownLoad(moved, force, 1e-5, touched)] * 3
    found = calibrate_modulus(model, loads, 1e-6, mesh_error=0.03)
    assert found.deviation_mpa == pytest.approx(0.03 * found.youngs_mpa, rel=0.01)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (0.0, "test: force_n is 0 N along z, which does not determine"),
        (0.5, r"test: force_n is \+0.5 N along z, which pulls .* give -0.5"),
        (np.nan, "give at least the z component, finite"),
        (np.array([np.inf, 0.0, -1.0]), "give at least the z component, finite"),
        (np.array([0.1, 0.0, np.nan]), "give at least the z component, finite"),
    ],
)
def test_loads_that_are_none_are_refused(
    presses: list, force: float | np.ndarray, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        KnownLoad(presses[0][0], force, 0.01, name="test")


def test_wrong_input_is_refused(model: GelModel, presses: list) -> None:
    moved, force, touched = presses[0]

    def of(**changes: object) -> list[KnownLoad]:
        fields = {"displacement": moved, "force_n": force, "deviation_n": 0.01, "contact": touched}
        return [KnownLoad(**{**fields, **changes})]

    with pytest.raises(ConfigError, match="at least one press"):
        calibrate_modulus(model, [], NOISE)
    with pytest.raises(ConfigError, match="Is force_n in mN, not N"):
        calibrate_modulus(model, of(force_n=1e3 * force), NOISE)
    with pytest.raises(ConfigError, match="Is force_n in g, not N"):
        calibrate_modulus(model, of(force_n=102.0 * force), NOISE)
    with pytest.raises(ConfigError, match=r"times the 0\.2 MPa of its description\. Check"):
        calibrate_modulus(model, of(force_n=1e-4 * force), NOISE)
    with pytest.raises(ConfigError, match="moved as if pulled"):
        calibrate_modulus(model, of(displacement=-moved), NOISE)
    with pytest.raises(ConfigError, match="there is no contact"):
        calibrate_modulus(model, of(displacement=1e-3 * moved), NOISE)
    with pytest.raises(ConfigError, match="no displacement is known where"):
        calibrate_modulus(model, of(displacement=np.full(moved.shape, np.nan)), NOISE)
    with pytest.raises(ConfigError, match="noise_mm"):
        calibrate_modulus(model, of(), 0.0)
    with pytest.raises(ConfigError, match="deviation_n"):
        of(deviation_n=0.0)
    with pytest.raises(ConfigError, match="needs smooth=True"):
        calibrate_modulus(model, of(), NOISE, smooth=False, free_plane=True)
    with pytest.raises(ConfigError, match="mesh_error"):
        calibrate_modulus(model, of(), NOISE, mesh_error=-0.1)
