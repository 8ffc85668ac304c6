import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.generation import MeshSizes, PressDraw, Recipe, make_sample
from tactorch.inverse import Settings
from tactorch.recording import MaterialSpec

BOX = np.array([(0.0, 0.0, 0.0), (10.0, 10.0, 10.0)])
Make = Callable[..., Recipe]


@given(seed=st.integers(0, 2**32 - 1))
def test_plans_stay_within_what_they_are_drawn_from(seed: int) -> None:
    draw = PressDraw(
        faces=(("z+",), ("x+", "y-")),
        p_max_mpa=(0.01, 0.03),
        steps=(2, 4),
        patch_radius_mm=(1.0, 2.0),
        patches=(2, 3),
    )
    plan = draw.draw(np.random.default_rng(seed), BOX, 0.2)
    again = draw.draw(np.random.default_rng(seed), BOX, 0.2)
    assert plan == again
    assert plan.faces in (("z+",), ("x+", "y-"))
    assert 0.01 <= max(plan.pressures_mpa) <= 0.03
    assert len(plan.pressures_mpa) in (2, 4)
    assert 1.0 <= plan.patch_radius_mm <= 2.0
    assert 2 <= len(plan.patch_centers_mm) <= 3
    centers = np.array(plan.patch_centers_mm)
    assert ((centers >= plan.patch_radius_mm) & (centers <= 10 - plan.patch_radius_mm)).all()


def test_loads_go_with_the_object() -> None:
    draw = PressDraw(load=(0.03, 0.09), steps=(2,))
    for youngs in (0.05, 0.8):
        plan = draw.draw(np.random.default_rng(0), BOX, youngs)
        assert 0.03 * youngs <= max(plan.pressures_mpa) <= 0.09 * youngs


def test_loads_are_drawn_evenly_in_their_logarithm() -> None:
    draw, rng = PressDraw(load=(0.01, 1.0), steps=(1,)), np.random.default_rng(0)
    loads = [draw.draw(rng, BOX, 1.0).pressures_mpa[0] for _ in range(400)]
    assert 0.4 < np.mean(np.array(loads) < 0.1) < 0.6


@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 0, 0), (0.3, 90, 150), (1.0, 400, 400)])
def test_a_share_of_the_plans_presses_patches(share: float, least: int, most: int) -> None:
    draw, rng = PressDraw(patch_radius_mm=(1.0, 2.0), patch_share=share), np.random.default_rng(0)
    plans = [draw.draw(rng, BOX, 1.0) for _ in range(400)]
    assert least <= sum(plan.patch_radius_mm is not None for plan in plans) <= most


def test_poissons_ratio_is_the_objects(make_recipe: Make) -> None:
    recipe = make_recipe(poisson=(0.3, 0.49), views=2)
    found = [recipe.material_of(index).poisson for index in range(4)]
    assert found[0] == found[1] != found[2] == found[3]
    assert all(0.3 <= poisson <= 0.49 for poisson in found)
    sample = make_sample(recipe, 2)
    assert sample.recording.material == recipe.material_of(2)
    assert make_recipe().material_of(2) == make_recipe().material


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"faces": ()}, "faces=.*not empty"),
        ({"steps": ()}, "steps=.*not empty"),
        ({"faces": (("top",),)}, "faces=.*top.*lists of x-, x"),
        ({"p_max_mpa": (0.02, 0.01)}, "lower end first"),
        ({"p_max_mpa": (0.02,)}, "two numbers"),
        ({"load": (0.1, 0.05)}, "load=.*lower end first"),
        ({"patches": (0, 2)}, "patches"),
        ({"patch_share": 1.5}, "patch_share=1.5"),
        ({"steps": (4, 0)}, "steps=.*at least 1"),
        ({"spring_n_per_mm": -1.0}, "spring_n_per_mm"),
    ],
)
def test_wrong_draws_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        PressDraw(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 0}, "count=0"),
        ({"seed": -1}, "seed=-1"),
        ({"snr_db": (40.0, 30.0)}, "snr_db"),
        ({"poisson": (0.4, 0.5)}, "poisson=.*below 0.5"),
        ({"poisson": (0.4,)}, "two numbers"),
        ({"family": "cats"}, "family=cats is unknown"),
        ({"family": {"name": "inclusions", "sise": 1}}, "sise"),
        (
            {"family": {"name": "inclusions", "count": [3]}},
            "family.count=.*list of two whole numbers",
        ),
        (
            {"family": {"name": "inclusions", "backgrounds": ["uniform", "blue"]}},
            "backgrounds=.*blue.*uniform, gradient or random",
        ),
        ({"element": "hex8"}, "element='hex8'"),
        ({"mesh": MeshSizes(1e-4)}, "cells"),
        ({"material": MaterialSpec("steel", 0.3)}, "steel"),
        ({"inversion": Settings(max_seconds=1.0)}, "max_seconds"),
        ({"inversion": "quick"}, "give settings, 'linear' or None"),
    ],
)
def test_wrong_recipes_are_refused(make_recipe: Make, changes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_recipe(**changes)


def test_wrong_mesh_sizes_are_refused() -> None:
    with pytest.raises(ConfigError, match="fine_relative"):
        MeshSizes(fine_relative=0.0)


def test_objects_are_shared_by_their_views(make_recipe: Make) -> None:
    recipe = make_recipe(views=2)
    phantoms = [recipe.drawn(index).phantom for index in range(4)]
    assert phantoms[0] == phantoms[1] != phantoms[2] == phantoms[3]


def test_configuration_says_all_and_fits_json(make_recipe: Make) -> None:
    """Any change of what decides the samples changes the configuration."""
    base = json.dumps(make_recipe().to_config())
    changed = [
        {"seed": 1},
        {"mesh": MeshSizes(0.3, None)},
        {"presses": PressDraw(support="fixed")},
        {"inversion": Settings()},
        {"inversion": "linear"},
        {"inversion": Settings(regularization="smoothness")},
        {"inversion": Settings(optimizer="newton_cg")},
        {"family": "inclusions"},
        {"poisson": (0.4, 0.45)},
    ]
    texts = [json.dumps(make_recipe(**changes).to_config()) for changes in changed]
    assert len({base, *texts}) == len(changed) + 1
