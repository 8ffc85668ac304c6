from collections.abc import Callable
from pathlib import Path

from tactorch.generation import Recipe, generate
from tactorch.generation.card import card_samples, write_card
from tactorch.viz import save_figure
from tactorch.viz.learning import samples_figure


def test_card_says_what_is_inside(make_recipe: Callable[..., Recipe], tmp_path: Path) -> None:
    found = generate(make_recipe(count=3), tmp_path / "tiny", workers=1)
    text = write_card(found).read_text()
    assert "3 samples in 2 shards" in text
    assert "no inverse crime" in text
    assert "| presses |" in text
    picture = save_figure(samples_figure(card_samples(found)), found.folder / "card.png")
    assert picture.stat().st_size > 10_000


def test_card_owns_up_to_an_inverse_crime(
    make_recipe: Callable[..., Recipe], tmp_path: Path
) -> None:
    from tactorch.generation import MeshSizes

    recipe = make_recipe(count=1, mesh=MeshSizes(0.3, None))
    text = write_card(generate(recipe, tmp_path / "crime", workers=1)).read_text()
    assert "inverse crime. Results on these data flatter" in text.replace("\n", " ")


def test_card_tells_linear_images_from_reconstructions(
    make_recipe: Callable[..., Recipe], tmp_path: Path
) -> None:
    found = generate(make_recipe(count=2, inversion="linear"), tmp_path / "linear", workers=1)
    text = write_card(found).read_text()
    assert "its linear image from the presses" in text
    assert "| reconstruction: pearson |" in text
    assert "iterations" not in text
    sample = found[0]
    assert sample.reconstruction is not None
    assert save_figure(samples_figure(card_samples(found)), found.folder / "card.png").is_file()
