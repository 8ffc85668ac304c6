"""Datasets with a tactile sensor: samples, bytes, cards, wrong sensors and bodies."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError, MeshError
from tactorch.generation import MeshSizes, Recipe, SampleSet, generate, make_sample
from tactorch.generation.card import card_samples, table_rows, write_card
from tactorch.mesh import Hemisphere, write_surface
from tactorch.recording import MaterialSpec
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.touch import TouchOptions
from tactorch.viz import save_figure
from tactorch.viz.learning import touch_figure

Make = Callable[..., Recipe]
FAMILY = {"name": "bodies", "width_mm": (10.0, 12.0), "count": (0, 1), "shapes": ["ball"]}


@pytest.fixture(scope="module")
def sensor_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensor") / "small.yaml"
    gel, markers = GelLayer(2.0, 0.2, 0.45, size_mm=(11.0, 9.0)), MarkerGrid(5, 4, (2.0, 2.0), 0.6)
    save_sensor(SensorDescription("small", (40, 32), (0.25, 0.25), gel, markers), path)
    return path


@pytest.fixture(scope="module")
def make(sensor_file: Path) -> Make:
    """Makes recipes of samples that take a second each."""

    def make_recipe(touch: dict[str, Any] | None = None, **changes: Any) -> Recipe:
        options = {"sensor": str(sensor_file), "image_width_px": None, "gel_edge_mm": 1.8}
        usual = {
            "name": "tiny",
            "count": 3,
            "family": FAMILY,
            "touch": TouchOptions(**{**options, "depth_mm": (0.3, 0.6), **(touch or {})}),
            "mesh": MeshSizes(relative_edge_length=0.12, fine_relative=0.16),
            "samples": 1,
            "shard": 2,
        }
        return Recipe(**{**usual, **changes})

    return make_recipe


@pytest.fixture(scope="module")
def made(make: Make, tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return generate(make(), tmp_path_factory.mktemp("made") / "tiny", workers=1)


def test_samples_are_those_of_recipe_and_index(made: SampleSet, make: Make) -> None:
    assert made.indices == (0, 1, 2)
    stored, again = made[2], make_sample(make(), 2)
    assert stored.touch is not None
    assert again.touch is not None
    for name, value in vars(again.touch).items():
        np.testing.assert_array_equal(getattr(stored.touch, name), value, err_msg=name)
        assert getattr(stored.touch, name).dtype == value.dtype, name
    np.testing.assert_array_equal(stored.truth, again.truth)
    assert stored.facts == json.loads(json.dumps(again.facts))
    assert {sample.facts["body"] for sample in made} <= {
        "box", "cylinder", "hemisphere", "hyperboloid", "lathe",
    }  # fmt: skip


@pytest.mark.slow
def test_bytes_do_not_depend_on_workers_or_interruptions(
    made: SampleSet, make: Make, tmp_path: Path
) -> None:
    def stop(done: int, failed: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(make(), tmp_path / "other", workers=1, progress=stop)
    with pytest.raises(FileError, match="unfinished"):
        SampleSet(tmp_path / "other")
    found = generate(make(), tmp_path / "other", workers=2)
    sums = [[s["sha256"] for s in one.manifest["shards"]] for one in (made, found)]
    assert sums[0] == sums[1]


def test_shards_are_read_by_plain_h5py(made: SampleSet) -> None:
    """Forces of the gel and of the recording are opposite, with nothing but h5py and NumPy."""
    with h5py.File(made.folder / "shard-00000.h5") as shard:
        sample = shard["samples/000001"]
        touch = sample["touch"]
        assert touch["images"].dtype == np.uint8
        assert touch["images"].shape[1:] == (32, 40, 3)
        assert touch["reference"].shape == (32, 40, 3)
        assert touch["height_mm"].dtype == np.float32
        count = len(touch["images"])
        assert sample["presses"].attrs["count"] == count
        for k in range(count):
            on_gel = touch["gel_forces"][k].sum(axis=0, dtype=float)
            on_body = sample[f"presses/{k:04d}/forces"][()].sum(axis=0)
            np.testing.assert_allclose(on_body, -touch["poses"][k][:3, :3] @ on_gel, atol=1e-6)
        mesh = shard[f"meshes/{sample.attrs['mesh_hash'].decode()}"]
        assert len(mesh["tets"]) == len(sample["truth"])


def test_the_card_has_the_largest_motion_of_each_press(made: SampleSet) -> None:
    touches = [sample.touch for sample in made if sample.touch is not None]
    rows = dict(table_rows(card_samples(made)))
    motions = [one.markers_px - one.rest_markers_px for one in touches]
    squares = np.concatenate([(motion**2).sum(axis=2) for motion in motions])
    found = np.array(rows["largest motion of a marker, px"])
    np.testing.assert_allclose(found, np.sqrt(squares.max(axis=1)), rtol=1e-6)
    deepest = np.concatenate([one.gel_displacement[..., 2].min(axis=1) for one in touches])
    np.testing.assert_allclose(rows["indentation of the gel, mm"], -deepest)
    assert len(rows["force along the axis, N"]) == len(found)


def test_card_says_how_presses_were_simulated(made: SampleSet, make: Make, tmp_path: Path) -> None:
    text = write_card(made).read_text()
    assert "For each press of the sensor `small`: its image of 40 x 32 px" in text
    assert "another mesh than the one they are recorded on" in text
    assert "do not slip" in text
    assert "| force along the axis, N |" in text
    assert "family `bodies`" in text
    picture = save_figure(touch_figure(list(made)), tmp_path / "touch.png")
    assert picture.stat().st_size > 10_000
    recipe = make(
        {"friction": "none", "heights": False, "presses": (1, 1)},
        count=1, mesh=MeshSizes(0.16, None), family={"name": "bodies", "bodies": ["box"],
                                                     "width_mm": (10.0, 11.0), "count": (0, 0)},
    )  # fmt: skip
    same = generate(recipe, tmp_path / "same", workers=1)
    text = write_card(same).read_text()
    assert "results on these data may flatter" in text
    assert "slip freely" in text
    assert same[0].touch is not None
    assert same[0].touch.height_mm is None
    assert touch_figure(list(same)).axes


def test_bodies_of_files_are_pressed(make: Make, tmp_path: Path) -> None:
    body = tmp_path / "dome.stl"
    write_surface(body, *Hemisphere((0.0, 0.0, 0.0), 6.0).surface(16))
    family = {"name": "file", "file": str(body), "count": (0, 1), "shapes": ["ball"]}
    recipe = make({"presses": (1, 1)}, family=family, count=2)
    found = [make_sample(recipe, index) for index in range(2)]
    first, second = (sample.recording.mesh for sample in found)
    assert first.content_hash() == second.content_hash()
    assert all(sample.touch.total_force[0, 2] < -0.01 for sample in found)  # type: ignore[union-attr]
    config = json.dumps(recipe.to_config())
    write_surface(body, *Hemisphere((0.0, 0.0, 0.0), 6.5).surface(16))
    assert json.dumps(recipe.to_config()) != config  # the folder of another body is refused


def test_recipes_that_no_sample_can_be_made_of_are_refused(make: Make, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nowhere\.yaml"):
        make({"sensor": "nowhere.yaml"})
    broken = tmp_path / "broken.yaml"
    broken.write_text("name: x\ngel: 3\n")
    with pytest.raises(ConfigError, match=r"broken.yaml.*'gel' is missing or not a table"):
        make({"sensor": str(broken)})
    with pytest.raises(FileError, match=r"body\.stl"):
        make(family={"name": "file", "file": str(tmp_path / "body.stl")})
    vertices, triangles = Hemisphere((0.0, 0.0, 0.0), 6.0).surface(16)
    write_surface(tmp_path / "open.stl", vertices, triangles[1:])
    with pytest.raises(MeshError, match=r"open.stl.*open"):
        make(family={"name": "file", "file": str(tmp_path / "open.stl")})
    with pytest.raises(ConfigError, match="differs from neo_hookean of the gel"):
        make(material=MaterialSpec("linear", 0.45))
    with pytest.raises(
        ConfigError, match=r"dataset.touch.gel_edge_mm: edge_mm=9.*at least 4 cells"
    ):
        make({"gel_edge_mm": 9.0})


def test_samples_without_a_sensor_are_as_before(make_recipe: Make) -> None:
    recipe = make_recipe()
    assert "touch" not in recipe.to_config()
    assert make_sample(recipe, 0).touch is None
    with pytest.raises(ConfigError, match="no sample has images"):
        touch_figure([make_sample(recipe, 0)])


def test_description_of_the_sensor_is_part_of_the_recipe(make: Make, tmp_path: Path) -> None:
    """A file that changed makes other samples."""
    texts = []
    path = tmp_path / "sensor.yaml"
    for youngs in (0.2, 0.3):
        gel = GelLayer(2.0, youngs, 0.45, size_mm=(11.0, 9.0))
        save_sensor(SensorDescription("one", (40, 32), (0.25, 0.25), gel), path)
        texts.append(json.dumps(make({"sensor": str(path)}).to_config()))
    assert texts[0] != texts[1]
