"""`tactorch generate`: make a dataset of simulated presses on random objects.

    tactorch generate                                   150 reconstructions of three shapes
    tactorch generate dataset=warmstart dataset.count=200 out=data/small
    tactorch generate dataset=touch dataset.count=20   images, markers and forces of a sensor
    tactorch generate dataset=warmstart executor=dask scheduler=tcp://HOST:8786

A run that was stopped or killed continues where it was when the same command is given again.
Settings of optimizer, regularization and so on are those of the reconstructions, if there are any.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.console import log, progress
from tactorch.cli.existing import results_in
from tactorch.cli.settings import CommandOptions, material_spec, select
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.generation import Recipe, SampleSet, generate
from tactorch.generation.layout import RECIPE
from tactorch.generation.recipe import LINEAR
from tactorch.inverse import Settings
from tactorch.progress import progress_line


@dataclass(frozen=True, kw_only=True)
class Dataset(Recipe):
    """A recipe, and whether its recordings are inverted."""

    reconstruct: bool | Literal["linear"] = option(
        False, "Invert each recording; linear: the linear image, for a tenth of the time"
    )

    def _check_samples(self) -> None:
        """Leave checks that read files to the recipe that is made of these settings."""


@dataclass(frozen=True, kw_only=True)
class GenerateOptions(Settings, CommandOptions):
    """Settings of the command."""

    dataset: Dataset = option(
        factory=lambda: Dataset(name="own", count=1), help="Recipe", preset="recognition"
    )
    material: Any = option("neo_hookean", "Material of the objects", section="material")
    out: Path | None = option(None, "Folder of the dataset; null: data/NAME")
    executor: Literal["processes", "dask"] = option("processes", "Where samples are made")
    workers: int | None = option(None, "Processes; null: one per core", ge=1)
    scheduler: str | None = option(
        None, "Address of the Dask scheduler, such as tcp://127.0.0.1:8786"
    )
    retry_failed: bool = option(False, "Try failed samples of unfinished shards again")
    card: bool = option(True, "Write the data card")


def run(options: GenerateOptions) -> SampleSet:
    """Make a dataset, or its missing samples."""
    recipe = make_recipe(options)
    out = options.out or Path("data") / recipe.name
    if not (out / RECIPE).is_file() and results_in(out):
        raise ConfigError(f"out={out} holds other files than those of a dataset; give another out.")
    log.info("%s: %d samples in %s", recipe.name, recipe.count, out)
    with progress(recipe.name, "samples") as update:
        samples = generate(
            recipe,
            out,
            executor=options.executor,
            workers=options.workers,
            scheduler=options.scheduler,
            retry_failed=options.retry_failed,
            progress=lambda done, failed, total: update(done, total, f", {failed} failed"),
        )
    if not len(samples):
        first = next(iter(samples.manifest["failed"].values()))
        raise ConfigError(f"none of {recipe.count} samples could be made; the first: {first}")
    for index, reason in samples.manifest["failed"].items():
        log.info("sample %s failed: %s", index, reason)
    if options.card:
        with progress_line("data card"):
            _write_card(samples, recipe)
    log.info("%d samples: %s", len(samples), out)
    return samples


def _write_card(samples: SampleSet, recipe: Recipe) -> None:
    from tactorch.generation.card import PICTURE, TOUCH_PICTURE, card_samples, write_card
    from tactorch.viz import save_figure
    from tactorch.viz.learning import samples_figure, touch_figure

    shown = card_samples(samples)
    save_figure(samples_figure(shown), samples.folder / PICTURE)
    if recipe.has_touch:
        save_figure(touch_figure(shown), samples.folder / TOUCH_PICTURE)
    log.info("data card: %s", write_card(samples))


def make_recipe(options: GenerateOptions) -> Recipe:
    """Return the recipe of a dataset."""
    inversion: Settings | str | None = None
    if options.dataset.reconstruct:
        is_linear = options.dataset.reconstruct == LINEAR
        inversion = LINEAR if is_linear else select(options, Settings)
    material = material_spec(options.material)
    return select(
        options.dataset, Recipe, material=material, element=options.element, inversion=inversion
    )
