"""`tactorch generate`."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from omegaconf import DictConfig

from tactorch.cli.settings import inversion_of, log, made, material_of, plain
from tactorch.errors import ConfigError
from tactorch.generation import MeshSizes, PressDraw, Recipe, SampleSet, generate
from tactorch.generation.recipe import LINEAR
from tactorch.inverse import Settings

_LINES = 20  # lines of progress in a log


def run(cfg: DictConfig) -> SampleSet:
    """Make a dataset, or what is missing of one."""
    recipe = recipe_of(cfg)
    out = Path("data") / recipe.name if cfg.out is None else Path(str(cfg.out))
    log.info("%s: %d samples in %s", recipe.name, recipe.count, out)
    with _progress(recipe.name) as tell:
        found = generate(
            recipe,
            out,
            executor=cfg.executor,
            workers=cfg.workers,
            scheduler=cfg.scheduler,
            retry_failed=cfg.retry_failed,
            progress=tell,
        )
    if not len(found):
        first = next(iter(found.manifest["failed"].values()))
        raise ConfigError(f"none of {recipe.count} samples could be made; the first: {first}")
    for index, reason in found.manifest["failed"].items():
        log.info("sample %s failed: %s", index, reason)
    if cfg.card:
        from tactorch.generation.card import PICTURE, looked_at, write_card
        from tactorch.viz.samples import plot_samples

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
        "presses": made("dataset.presses", PressDraw, settings.pop("presses")),
        "mesh": made("dataset.sizes", MeshSizes, settings.pop("sizes")),
        "material": material_of(cfg),
        "element": cfg.element,
        "inversion": _inversion(cfg, reconstruct),
    }
    return made("dataset", Recipe, {**settings, **parts})


def _inversion(cfg: DictConfig, reconstruct: bool | str) -> Settings | str | None:
    if reconstruct == LINEAR:
        return LINEAR
    return inversion_of(cfg) if reconstruct else None


@contextmanager
def _progress(label: str) -> Iterator[Callable[[int, int, int], None]]:
    """Show how far it is and how long it will take: a bar at a terminal, else some lines."""
    if not sys.stderr.isatty():
        shown, begun, start = -1, 0, time.monotonic()

        def tell(done: int, failed: int, total: int) -> None:
            nonlocal shown, begun
            begun = done if shown < 0 else begun
            part = _LINES * done // total
            if part > shown:
                shown = part
                left = (time.monotonic() - start) * (total - done) / max(1, done - begun) / 60.0
                rest = f", about {left:.0f} min left" if begun < done < total else ""
                log.info("%d of %d samples, %d failed%s", done, total, failed, rest)

        yield tell
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[failed]} failed"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Samples may be minutes apart.
    console, period = Console(stderr=True), 3600.0
    with Progress(*columns, console=console, speed_estimate_period=period) as bar:
        task = bar.add_task(label, total=None, failed=0)
        yield lambda done, failed, total: bar.update(
            task, completed=done, total=total, failed=failed
        )
