"""Moduli by region: means of priors, and starts; without inverse crime."""

import numpy as np
import pytest

from tactorch import PressPlan, Settings, simulate
from tactorch.errors import ConfigError
from tactorch.inverse import (
    INITIALIZATIONS,
    PRIORS,
    Bounds,
    InverseProblem,
    ShiftedPrior,
    Sparsity,
    Tikhonov,
    invert_map,
)
from tactorch.mesh import TetMesh, box_mesh
from tactorch.phantoms import make_phantom
from tactorch.recording import Recording

PLAIN = box_mesh(10.0, 2, tets_per_cell=5)
MESH = PLAIN.with_regions((PLAIN.centroids[:, 2] > 5.0) + 1)
MODULI = {1: 0.1, 2: 0.5}
EXPECTED = np.where(MESH.regions == 1, np.log(0.1), np.log(0.5))
WITH_REGIONS = ["tikhonov", "matern", "sparsity"]


@pytest.mark.parametrize("name", WITH_REGIONS)
def test_the_penalty_is_zero_at_the_moduli_of_the_regions(name: str) -> None:
    prior = PRIORS.build({"name": name, "region_mpa": MODULI}).on(MESH)
    assert prior.value(EXPECTED) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(prior.gradient(EXPECTED), 0.0, atol=1e-9)
    assert prior.value(EXPECTED + 0.3) > 0.1
    field = EXPECTED + np.random.default_rng(0).normal(0.0, 0.5, MESH.n_tets)
    step = 1e-6 * np.random.default_rng(1).standard_normal(MESH.n_tets)
    slope = (prior.value(field + step) - prior.value(field - step)) / 2.0
    assert prior.gradient(field) @ step == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("name", WITH_REGIONS)
def test_equal_moduli_of_all_regions_are_one_level(name: str) -> None:
    field = EXPECTED + 0.2
    one = PRIORS.build({"name": name, "level_mpa": 0.2}).on(MESH)
    each = PRIORS.build({"name": name, "region_mpa": {1: 0.2, 2: 0.2}}).on(MESH)
    rest = PRIORS.build({"name": name, "region_mpa": {2: 0.2}, "level_mpa": 0.2}).on(MESH)
    assert each.value(field) == pytest.approx(one.value(field))
    assert rest.value(field) == pytest.approx(one.value(field))


def test_parts_and_shifts_of_priors_have_means_by_region() -> None:
    part = {"tikhonov": {"region_mpa": MODULI, "weight": 2.0}, "smoothness": 1.0}
    field = EXPECTED + np.random.default_rng(0).normal(0.0, 0.5, MESH.n_tets)
    alone = Tikhonov(region_mpa=MODULI).on(MESH).value(field)
    rest = PRIORS.build("smoothness").on(MESH).value(field)
    together = PRIORS.build({"name": "composite", "parts": part}).on(MESH)
    assert together.value(field) == pytest.approx(2.0 * alone + rest)
    map_mpa = np.full(MESH.n_tets, 0.3)
    shifted = ShiftedPrior(prior=Tikhonov(region_mpa=MODULI), mean_mpa=map_mpa).on(MESH)
    mean = EXPECTED + np.log(0.3)
    assert shifted.value(mean) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(shifted.gradient(mean), 0.0, atol=1e-9)
    assert shifted.value(EXPECTED) > 0.1


@pytest.mark.parametrize(
    ("moduli", "mesh", "message"),
    [
        (MODULI, PLAIN, "the mesh has no regions; make it with tactorch body"),
        ({1: 0.1, 3: 0.2}, MESH, "names region 3; those of the mesh are 1, 2"),
        ({1: 0.1}, MESH, "has no value for region 2"),
    ],
)
def test_regions_that_do_not_fit_are_refused(
    moduli: dict[int, float], mesh: TetMesh, message: str
) -> None:
    for prior in (Tikhonov(region_mpa=moduli), Sparsity(region_mpa=moduli)):
        with pytest.raises(ConfigError, match=message):
            prior.on(mesh)


def test_moduli_of_regions_are_positive() -> None:
    with pytest.raises(ConfigError, match="region_mpa"):
        Tikhonov(region_mpa={1: -0.1})


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Presses on a cube of 0.1 MPa with a ball of 0.5 MPa, solved on a finer mesh."""
    phantom = make_phantom("cube_sphere", youngs_mpa=0.1, inclusion_mpa=0.5, radius=0.25)
    mesh = box_mesh(10.0, 4, tets_per_cell=5)
    mesh = mesh.with_regions((phantom.on_mesh(mesh, 4) > 0.3) + 1)
    plan = PressPlan(["z+"], [0.01], support="fixed")
    fine = box_mesh(10.0, 5, tets_per_cell=5)
    return simulate(phantom, plan, mesh=mesh, fine_mesh=fine, element="tet10", samples=4, snr_db=40)


def test_a_recording_of_two_regions_is_no_inverse_crime(recording: Recording) -> None:
    assert not recording.provenance["inverse_crime"]
    inner = recording.mesh.regions == 2
    assert 10 < inner.sum() < 60
    assert np.median(recording.truth[~inner]) == pytest.approx(0.1)


def error_of(recording: Recording, prior: dict[str, object]) -> float:
    """Error of the log-moduli, root mean square by volume."""
    result = invert_map(recording, Settings(regularization=PRIORS.build(prior)))
    squares = np.log(result.youngs / recording.truth) ** 2
    return float(np.sqrt(np.average(squares, weights=recording.mesh.volumes)))


@pytest.mark.slow
def test_means_by_region_improve_the_map(recording: Recording) -> None:
    plain = error_of(recording, {"name": "tikhonov"})
    # Means that are wrong by 20 %.
    informed = error_of(recording, {"name": "tikhonov", "region_mpa": {1: 0.12, 2: 0.4}})
    assert informed < 0.8 * plain


def test_the_start_fits_one_modulus_to_each_region(recording: Recording) -> None:
    problem = InverseProblem(recording)
    start = INITIALIZATIONS.build("regions")(problem, Bounds())
    moduli = {n: np.unique(start[recording.mesh.regions == n]) for n in (1, 2)}
    assert all(len(values) == 1 for values in moduli.values())
    assert moduli[1][0] == pytest.approx(0.1, rel=0.1)
    assert moduli[2][0] > 0.25
    uniform = INITIALIZATIONS.build({"name": "uniform", "start_mpa": "homogeneous"})
    assert problem.evaluate(start).chi2 < problem.evaluate(uniform(problem, Bounds())).chi2


def test_the_start_takes_given_moduli(recording: Recording) -> None:
    problem = InverseProblem(recording)
    start = INITIALIZATIONS.build({"name": "regions", "region_mpa": MODULI})(problem, Bounds())
    np.testing.assert_allclose(start, np.where(recording.mesh.regions == 1, 0.1, 0.5))


def test_a_mesh_without_regions_has_no_such_start(recording: Recording) -> None:
    from dataclasses import replace

    bare = replace(recording, mesh=recording.mesh.with_regions(None))
    with pytest.raises(ConfigError, match="has no regions"):
        INITIALIZATIONS.build("regions")(InverseProblem(bare), Bounds())
