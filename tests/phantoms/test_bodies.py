"""Random bodies that are no cubes, and bodies of files."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.mesh import BodyFile, Hemisphere, Sphere, write_surface
from tactorch.phantoms import draw_phantom
from tactorch.phantoms.bodies import BodiesFamily, FileFamily
from tactorch.phantoms.overlap import protrusion

KINDS = ("box", "cylinder", "hemisphere", "hyperboloid", "lathe")


@pytest.fixture
def dome(tmp_path: Path) -> Path:
    path = tmp_path / "dome.stl"
    write_surface(path, *Hemisphere((0.0, 0.0, 0.0), 6.0).surface(24))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_stand_on_the_ground_within_their_size(kind: str) -> None:
    family = BodiesFamily(bodies=(kind,), width_mm=(18.0, 22.0), height=(0.6, 0.8), count=(1, 2))
    for seed in range(4):
        drawn = family.draw(np.random.default_rng(seed))
        low, high = drawn.phantom.body.bounds()
        assert low[2] == pytest.approx(0.0)
        assert 17.9 <= high[0] - low[0] <= 22.1
        if kind != "hemisphere":
            assert 0.59 * 18.0 <= high[2] <= 0.81 * 22.0
        assert drawn.parameters["body"] == kind
        assert drawn.label == str(len(drawn.phantom.inclusions))
        assert 1 <= len(drawn.phantom.inclusions) <= 2


def test_same_generator_gives_the_same_body_and_others_differ() -> None:
    same = [draw_phantom("bodies", np.random.default_rng(3)) for _ in range(2)]
    other = draw_phantom("bodies", np.random.default_rng(4))
    assert same[0].parameters == same[1].parameters != other.parameters
    kinds = {
        draw_phantom("bodies", np.random.default_rng(s), count=(0, 0)).parameters["body"]
        for s in range(30)
    }
    assert kinds == set(KINDS)


def test_body_of_a_file_has_random_inclusions(dome: Path) -> None:
    family = FileFamily(file=dome, count=(1, 2), size=(0.15, 0.25))
    drawn = [family.draw(np.random.default_rng(seed)) for seed in range(2)]
    assert all(isinstance(one.phantom.body, BodyFile) for one in drawn)
    assert all(one.phantom.inclusions for one in drawn)
    assert drawn[0].parameters["parts"] != drawn[1].parameters["parts"]
    before = family.content_hash()
    write_surface(dome, *Hemisphere((0.0, 0.0, 0.0), 7.0).surface(24))
    assert family.content_hash() != before


def test_protrusion_out_of_a_file_is_the_largest_of_all_distances(dome: Path) -> None:
    body = BodyFile(str(dome))
    for center, radius in (((0.0, 0.0, 2.5), 1.0), ((2.0, 1.0, 3.0), 1.5), ((0.0, 0.0, 5.0), 2.0)):
        ball = Sphere(center, radius)
        some = ball.surface(72)[0]  # the sampled points are these and more
        largest = body.signed_distance(some).max()
        assert largest <= protrusion(ball, body) + 1e-12
        assert protrusion(ball, body) == pytest.approx(largest, abs=0.01)


def test_wrong_settings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"family.file is required"):
        FileFamily()
    with pytest.raises(FileError, match=r"nowhere.stl"):
        FileFamily(file=tmp_path / "nowhere.stl").draw(np.random.default_rng(0))
    with pytest.raises(ConfigError, match=r"family.width_mm=\[20.0, 10.0\]: give the lower end"):
        BodiesFamily(width_mm=(20.0, 10.0))
    with pytest.raises(ConfigError, match="No inclusion fits"):
        BodiesFamily(size=(2.0, 2.0), shapes=("ball",), count=(1, 1)).draw(np.random.default_rng(0))
