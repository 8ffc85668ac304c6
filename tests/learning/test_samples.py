"""Samples of datasets as tensors and batches."""

import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from tactorch.errors import ConfigError, FileError
from tactorch.generation import MeshSizes, PressDraw, Recipe, SampleSet, generate
from tactorch.learning import TouchDataset, collate_touch


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four samples with one or two presses, two of them in a shard."""
    recipe = Recipe(
        name="tiny",
        count=4,
        family={"name": "inclusions", "count": (1, 1), "shapes": ["ball", "box"]},
        presses=PressDraw(faces=(("z+",), ("z+", "x+")), steps=(1, 1)),
        mesh=MeshSizes(relative_edge_length=0.3, fine_relative=0.2),
        samples=1,
        snr_db=(30.0, 40.0),
        shard=2,
        seed=1,
    )
    place = tmp_path_factory.mktemp("samples") / "tiny"
    generate(recipe, place, workers=1)
    return place


def test_tensors_are_those_of_the_recording(folder: Path) -> None:
    samples, data = SampleSet(folder), TouchDataset(folder)
    assert len(data) == len(samples) == 4
    for row, index in enumerate(samples.indices):
        item, sample = data[row], samples[index]
        press, count = sample.recording.presses[0], len(sample.recording.presses)
        assert item["index"] == index
        assert item["label"] == sample.label
        assert item["forces"].shape == (count, sample.recording.mesh.n_points, 3)
        np.testing.assert_allclose(item["forces"][0], press.forces, rtol=1e-6)
        shown = item["displacement"][0][item["observed"][0]]
        np.testing.assert_allclose(shown, press.displacement[press.observed], rtol=1e-6)
        assert (item["displacement"][~item["observed"]] == 0).all()
        np.testing.assert_allclose(item["youngs"], sample.truth, rtol=1e-6)
        assert item["noise_mm"][0] == pytest.approx(press.noise_mm)
        assert "reconstruction" not in item


def test_voxels_have_the_modulus_inside_the_body(folder: Path) -> None:
    item = TouchDataset(folder, voxels=6)[0]
    assert item["voxel_youngs"].shape == (6, 6, 6)
    assert item["voxel_inside"].all()  # a cube
    assert set(item["voxel_youngs"].unique().tolist()) <= set(item["youngs"].unique().tolist())


def test_batches_of_different_numbers_of_presses_are_filled_up(folder: Path) -> None:
    data = TouchDataset(folder, voxels=4)
    counts = [len(data[row]["forces"]) for row in range(4)]
    assert set(counts) == {1, 2}
    (batch,) = DataLoader(data, batch_size=4, collate_fn=collate_touch)
    assert batch["forces"].shape[:2] == (4, 2)
    assert batch["press_mask"].sum(dim=1).tolist() == counts
    assert (batch["forces"][~batch["press_mask"]] == 0).all()
    assert torch.equal(batch["forces"][0, : counts[0]], data[0]["forces"])
    assert batch["label"] == [data[row]["label"] for row in range(4)]
    assert batch["voxel_youngs"].shape == (4, 4, 4, 4)
    assert batch["node_mask"].all()
    assert batch["index"].tolist() == [0, 1, 2, 3]


def test_meshes_of_different_sizes_are_filled_up(folder: Path) -> None:
    one = TouchDataset(folder)[0]
    nodes, elements = len(one["points"]), len(one["tets"])
    small = {**one, "points": one["points"][:5], "tets": one["tets"][:3]}
    del small["noise_mm"]
    batch = collate_touch([one, small])
    assert batch["node_mask"].sum(dim=1).tolist() == [nodes, 5]
    assert batch["element_mask"].sum(dim=1).tolist() == [elements, 3]
    assert torch.equal(batch["points"][1, :5], one["points"][:5])
    assert (batch["points"][1, 5:] == 0).all()
    assert "noise_mm" not in batch


def test_workers_read_the_same_samples(folder: Path) -> None:
    data = TouchDataset(folder, transform=total_youngs)
    loaded = [float(x) for x in DataLoader(data, batch_size=1, num_workers=2)]
    assert loaded == pytest.approx([float(data[row]) for row in range(4)])
    again = pickle.loads(pickle.dumps(data))
    assert float(again[1]) == pytest.approx(float(data[1]))


def total_youngs(item: dict[str, torch.Tensor]) -> torch.Tensor:
    return item["youngs"].sum()


def test_shards_are_read_by_plain_h5py(folder: Path) -> None:
    item = TouchDataset(folder)[1]
    shard = SampleSet(folder).manifest["shards"][0]["file"]
    with h5py.File(folder / shard) as file:
        sample = file["samples/000001"]
        np.testing.assert_allclose(sample["truth"], item["youngs"], rtol=1e-6)
        np.testing.assert_allclose(sample["presses/0000/forces"], item["forces"][0], rtol=1e-6)
        assert sample.attrs["label"].decode() == item["label"]


def test_the_end_is_an_index_error_so_that_loops_end(folder: Path) -> None:
    data = TouchDataset(SampleSet.load(folder))
    assert len(list(data)) == 4  # type: ignore[call-overload]
    assert data[-1]["index"] == 3
    with pytest.raises(IndexError, match="row 4 of a dataset of 4 samples"):
        data[4]


def test_errors_name_the_value(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="voxels=0: give at least 1"):
        TouchDataset(folder, voxels=0)
    with pytest.raises(FileError, match="nowhere"):
        TouchDataset(tmp_path / "nowhere")


def test_a_set_describes_itself(folder: Path) -> None:
    made: Callable[[], str] = SampleSet(folder).summary
    assert "4 samples in 2 shards" in made()
    assert repr(SampleSet(folder)).startswith("SampleSet\n  4 samples")
