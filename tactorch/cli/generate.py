"""`tactorch generate`."""

from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.progress import progress
from tactorch.cli.settings import build, inversion_of, log, material_of, plain
from tactorch.errors import ConfigError
from tactorch.generation import MeshSizes, PressDraw, Recipe, SampleSet, generate
from tactorch.generation.recipe import LINEAR
from tactorch.inverse import Settings


def run(cfg: DictConfig) -> SampleSet:
    """Make a dataset, or what is missing of one."""
    recipe = recipe_of(cfg)
    out = Path("data") / recipe.name if cfg.out is None else Path(str(cfg.out))
    log.info("%s: %d samples in %s", recipe.name, recipe.count, out)
    with progress(recipe.name, "samples") as tell:
        found = generate(
            recipe,
            out,
            executor=cfg.executor,
            workers=cfg.workers,
            scheduler=cfg.scheduler,
            retry_failed=cfg.retry_failed,
            progress=lambda done, failed, total: tell(done, total, f", {failed} failed"),
        )
    if not len(found):
        first = next(iter(found.manifest["failed"].values()))
        raise ConfigError(f"none of {recipe.count} samples could be made; the first: {first}")
    for index, reason in found.manifest["failed"].items():
        log.info("sample %s failed: %s", index, reason)
    if cfg.card:
        from tactorch.generation.card import PICTURE, looked_at, write_card
        from tactorch.viz.learning import plot_samples

        plot_samples(looked_at(found), found.folder / PICTURE)
        log.info("data card: %s", write_card(found))
    log.info("%d samples: %s", len(found), out)
    return found


def recipe_of(cfg: DictConfig) -> Recipe:
    """Make the recipe."""
    settings = plain(cfg.dataset)
    family = settings.pop("family")
    if not isinstance(family, dict) or "name" not in family:
        raise ConfigError("dataset.family lacks its name; give dataset.family.name=...")
    reconstruct = settings.pop("reconstruct")
    parts = {
        "family": family.pop("name"),
        "options": family,
        "presses": build("dataset.presses", PressDraw, settings.pop("presses")),
        "mesh": build("dataset.sizes", MeshSizes, settings.pop("sizes")),
        "material": material_of(cfg),
        "element": cfg.element,
        "inversion": _inversion(cfg, reconstruct),
    }
    return build("dataset", Recipe, {**settings, **parts})


def _inversion(cfg: DictConfig, reconstruct: bool | str) -> Settings | str | None:
    if reconstruct == LINEAR:
        return LINEAR
    return inversion_of(cfg) if reconstruct else None
