"""Samples with a tactile sensor as tensors and batches."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from tactorch.generation import MeshSizes, Recipe, SampleSet, generate
from tactorch.learning import TouchDataset, collate_touch
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.touch import TouchOptions


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four bodies with one or two presses."""
    place = tmp_path_factory.mktemp("touch")
    gel, markers = GelLayer(2.0, 0.2, 0.45, size_mm=(11.0, 9.0)), MarkerGrid(5, 4, (2.0, 2.0), 0.6)
    sensor = SensorDescription("small", (40, 32), (0.25, 0.25), gel, markers)
    save_sensor(sensor, place / "small.yaml")
    recipe = Recipe(
        name="tiny",
        count=4,
        family={"name": "bodies", "width_mm": (10.0, 12.0), "count": (0, 1), "shapes": ["ball"]},
        touch=TouchOptions(
            sensor=str(place / "small.yaml"), image_width_px=None, gel_edge_mm=1.8,
            depth_mm=(0.3, 0.6),
        ),
        mesh=MeshSizes(relative_edge_length=0.12, fine_relative=0.16),
        samples=1,
        shard=2,
        seed=1,
    )  # fmt: skip
    generate(recipe, place / "tiny", workers=1)
    return place / "tiny"


def test_tensors_are_those_of_the_touch(folder: Path) -> None:
    samples, data = SampleSet(folder), TouchDataset(folder, voxels=8)
    for row, index in enumerate(samples.indices):
        item, touch = data[row], samples[index].touch
        assert touch is not None
        k = len(touch.images)
        assert item["images"].shape == (k, 3, 32, 40)
        assert item["images"].dtype == item["reference"].dtype == torch.uint8
        assert item["reference"].shape == (3, 32, 40)
        np.testing.assert_array_equal(item["images"][0, 2], touch.images[0, :, :, 2])
        np.testing.assert_array_equal(item["reference"][1], touch.reference[..., 1])
        assert item["height_mm"].shape == (k, 32, 40)
        assert item["markers_px"].shape == (k, 20, 2)
        assert item["marker_visible"].dtype == torch.bool
        assert item["forces"].shape[0] == k
        assert item["voxel_youngs"].shape == (8, 8, 8)
        assert not item["voxel_inside"].all() or samples[index].facts["body"] == "box"
        turned = torch.einsum("kij,kj->ki", item["poses"][:, :3, :3], item["gel_force"])
        torch.testing.assert_close(item["forces"].sum(1), -turned, atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(item["gel_forces"].sum(1), item["gel_force"], atol=1e-5, rtol=0)


def test_loader_with_workers_fills_up_presses(folder: Path) -> None:
    data = TouchDataset(folder)
    counts = [len(data[row]["images"]) for row in range(4)]
    assert set(counts) == {1, 2}
    loader = DataLoader(data, batch_size=4, collate_fn=collate_touch, num_workers=2)
    (batch,) = loader
    assert batch["images"].shape == (4, 2, 3, 32, 40)
    assert batch["images"].dtype == torch.uint8
    assert batch["press_mask"].sum(dim=1).tolist() == counts
    for name in ("images", "gel_force", "poses", "markers_px", "height_mm"):
        assert (batch[name][~batch["press_mask"]] == 0).all(), name
    assert not batch["marker_visible"][~batch["press_mask"]].any()
    assert torch.equal(batch["images"][0, : counts[0]], data[0]["images"])
    assert torch.equal(batch["gel_points"][0], batch["gel_points"][3])
    assert batch["reference"].shape == (4, 3, 32, 40)
