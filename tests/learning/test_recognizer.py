from pathlib import Path
from typing import Any

import lightning
import pytest
import torch

from tactorch.errors import ConfigError
from tactorch.generation import MeshSizes, PressDraw, Recipe, generate
from tactorch.learning.recognizer import FCN, RecognitionData, RecognitionOptions, Recognizer


@pytest.mark.parametrize("size", [(4, 4, 4), (9, 16, 7), (24, 24, 24)])
def test_any_grid_will_do(size: tuple[int, int, int]) -> None:
    network = FCN(3, hidden=8).eval()
    assert network(torch.randn(2, 1, *size)).shape == (2, 3)


def test_normalisation_travels_with_the_weights(tmp_path: Path) -> None:
    model = Recognizer(["a", "b"], mean=-1.5, deviation=0.4, hidden=4, layers=2).eval()
    path = tmp_path / "model.ckpt"
    trainer = lightning.Trainer(logger=False, enable_checkpointing=False, max_epochs=0)
    trainer.strategy.connect(model)
    trainer.save_checkpoint(path)
    again = Recognizer.load_from_checkpoint(path).eval()
    maps = torch.randn(2, 1, 8, 8, 8)
    assert again.classes == ["a", "b"]
    torch.testing.assert_close(again(maps), model(maps))


def shapes(count: int, folder: Path) -> Path:
    """Truths of the three shapes; presses so few and coarse that they take a moment."""
    recipe = Recipe(
        name="shapes",
        count=count,
        family="recognition",
        presses=PressDraw(steps=(1,)),
        mesh=MeshSizes(0.13, None),
        samples=1,
        shard=36,
    )
    return generate(recipe, folder / "shapes", workers=1).folder


def recognition(folder: Path, **options: Any) -> RecognitionData:
    return RecognitionData(RecognitionOptions(folder=folder, **options))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shapes(9, tmp_path_factory.mktemp("shapes"))


@pytest.mark.slow
def test_it_learns_the_shapes(tmp_path: Path) -> None:
    """A small network tells true maps apart after a few epochs; chance is a third."""
    dataset = shapes(36, tmp_path)
    lightning.seed_everything(0, workers=True)
    data = recognition(dataset, voxels=12, source="truth", shares=(0.7, 0.0, 0.3), batch=8)
    assert data.classes == ["cake", "cone", "torus"]
    model = Recognizer(data.classes, data.mean, data.deviation, hidden=16, learning_rate=1e-2)
    trainer = lightning.Trainer(
        max_epochs=25,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        accelerator="cpu",
    )
    trainer.fit(model, train_dataloaders=data.train_dataloader())
    (result,) = trainer.test(model, data.test_dataloader(), verbose=False)
    assert result["test/accuracy"] >= 0.8


def test_what_a_dataset_lacks_is_said(dataset: Path) -> None:
    with pytest.raises(ConfigError, match="no reconstructions"):
        recognition(dataset, voxels=8)
    with pytest.raises(ConfigError, match="source='map'"):
        recognition(dataset, source="map")


def test_presses_on_three_sides_allow_six_symmetries(dataset: Path) -> None:
    assert len(recognition(dataset, voxels=4, source="truth").allowed) == 6
