"""How sure a lump is, under posteriors that are known."""

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.inverse import Log, find_lump
from tactorch.inverse.posterior import LaplacePosterior
from tactorch.inverse.result.regions import compute_confidence
from tactorch.inverse.result.text import describe, lump_facts
from tactorch.mesh import box_mesh, face_nodes
from tactorch.recording import MaterialSpec, Press, Recording

MESH = box_mesh(10.0, 6)
INSIDE = np.linalg.norm(MESH.centroids - [5, 5, 7], axis=1) < 2.5


def youngs(inside=0.5, outside=0.2):
    return np.where(INSIDE, inside, outside)


def posterior(map_mpa, deviation):
    """Each element's logarithm by itself, all as uncertain as one another."""
    log = Log()
    mean = log.parameters(map_mpa)
    nothing = np.zeros((1, MESH.n_tets))
    prior = sp.identity(MESH.n_tets, format="csr") / deviation**2
    return LaplacePosterior.of(mean, nothing, prior, log)


def sure(map_mpa, deviation, draws=400):
    lump = find_lump(MESH, map_mpa)
    assert lump is not None
    return lump, compute_confidence(MESH, lump, posterior(map_mpa, deviation), draws=draws)


@pytest.mark.parametrize("inside", [0.5, 0.08])
def test_the_contrast_is_as_uncertain_as_its_mean(inside):
    lump, stated = sure(youngs(inside), 0.3, draws=2000)
    weights = MESH.volumes[INSIDE] / MESH.volumes[INSIDE].sum()
    spread = 0.3 * np.sqrt(weights @ weights)  # the rest, of many elements, is known far better
    centre = np.log(inside / 0.2)
    ends = np.log(stated.contrast)
    assert ends == pytest.approx(centre + np.array([-1.645, 1.645]) * spread, abs=0.15 * spread)
    assert stated.probability > 0.999
    assert (min(ends) > 0) == (lump.side == "stiff")


def test_what_might_be_chance_is_not_believed(element_map):
    lump, stated = sure(youngs(0.21), 3.0)
    assert 0.4 < stated.probability < 0.9
    found = element_map(recording(), youngs(0.21), posterior(youngs(0.21), 3.0))
    low, high = stated.contrast
    assert low < 1 < high
    assert f"{low:.2g} to {high:.2g} for the ratio of moduli" in describe(found)
    assert f"ratio of moduli {low:.2g} to {high:.2g}" in lump_facts(found.lumps[0])[-1].note
    assert "Do not rely on it" in describe(found)
    assert found.lumps[0].plain()["probability"] == stated.probability
    np.testing.assert_allclose(found.log_deviation_at(MESH.centroids), 3.0, rtol=1e-6)
    low_mpa, high_mpa = found.intervals()
    np.testing.assert_allclose(np.log(high_mpa / low_mpa), 2 * 1.6449 * 3.0, rtol=1e-4)
    assert lump.side == "stiff"


def test_the_interval_is_about_the_contrast_that_is_stated():
    """Also in a soft lump of unequal elements, whose geometric mean is far below the mean."""
    uneven = np.where(np.arange(MESH.n_tets) % 5, 0.02, 0.06)
    lump, stated = sure(youngs(uneven), 0.01)
    assert lump.side == "soft"
    assert 0.9 * lump.contrast < stated.contrast[0] < lump.contrast < stated.contrast[1]


def test_a_certain_map_has_a_certain_centre(element_map):
    _, exact = sure(youngs(), 1e-6)
    _, vague = sure(youngs(), 0.5)
    assert np.linalg.norm(exact.center_deviation_mm) < 1e-4
    assert np.linalg.norm(vague.center_deviation_mm) > 0.01
    assert exact.probability == pytest.approx(1.0)
    found = element_map(recording(), youngs(), posterior(youngs(), 1e-6))
    assert "more than 99.9 %" in describe(found)


def recording():
    forces = np.zeros((MESH.n_points, 3))
    forces[face_nodes(MESH, "z+"), 2] = -0.1
    held = np.zeros((MESH.n_points, 3), dtype=bool)
    held[face_nodes(MESH, "z-")] = True
    press = Press(forces, forces != 0, 0.01 * forces, fixed=held, noise_mm=1e-3)
    return Recording(MESH, (press,), MaterialSpec("neo_hookean", 0.45), check_units=False)
