"""Data card: the content of a dataset as text, by the template card.md."""

from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from jinja2 import StrictUndefined, Template

from tactorch.files import write_file
from tactorch.generation.sample import Sample
from tactorch.generation.sampleset import SampleSet
from tactorch.touch import Touch

CARD, PICTURE, TOUCH_PICTURE = "card.md", "card.png", "touch.png"
_MAX_CARD_SAMPLES = 500


def write_card(samples: SampleSet) -> Path:
    """Write card.md into the dataset's folder and return its path."""
    template = Template(
        files("tactorch.generation").joinpath("card.md").read_text(encoding="utf-8"),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    manifest, selected = samples.manifest, card_samples(samples)
    recipe = manifest["recipe"]
    path = samples.folder / CARD
    text = template.render(
        manifest=manifest,
        recipe=recipe,
        touch=recipe.get("touch"),
        same_mesh=recipe["mesh"]["fine_relative"] is None,
        count=len(samples),
        megabytes=sum(shard["bytes"] for shard in manifest["shards"]) / 1e6,
        picture=PICTURE,
        touch_picture=TOUCH_PICTURE,
        shown=len(selected),
        labels=sorted(Counter(sample.label for sample in selected).items()),
        rows=[(name, _quantiles(values)) for name, values in table_rows(selected)],
    )
    write_file(path, text)
    return path


def card_samples(samples: SampleSet) -> list[Sample]:
    """Return the samples of the card's statistics, evenly spread over the dataset."""
    places = np.linspace(0, len(samples) - 1, min(len(samples), _MAX_CARD_SAMPLES)).astype(int)
    return [samples[samples.indices[place]] for place in places]


def _quantiles(values: Sequence[float]) -> list[str]:
    quantiles = np.nanquantile(np.array(values, dtype=float), [0.05, 0.5, 0.95])
    return [f"{value:.4g}" for value in quantiles]


def table_rows(selected: Sequence[Sample]) -> Iterator[tuple[str, Sequence[float]]]:
    """Yield the quantities of the table, with a value for each sample, or press of a sensor."""
    yield "presses", [len(s.recording.presses) for s in selected]
    yield "elements", [s.recording.mesh.n_tets for s in selected]
    yield "lowest modulus, MPa", [s.truth.min() for s in selected]
    yield "highest modulus, MPa", [s.truth.max() for s in selected]
    yield "largest displacement, mm", [s.largest_mm for s in selected]
    yield from _touch_rows([s.touch for s in selected if s.touch is not None])
    figures = [s.figures for s in selected if s.figures]
    for name in ("iterations", "chi2", "ssim", "pearson", "rmse_mpa"):
        if figures and name in figures[0]:
            yield f"reconstruction: {name}", [f[name] for f in figures]


def _touch_rows(touches: Sequence[Touch]) -> Iterator[tuple[str, Sequence[float]]]:
    if touches:
        forces = [-touch.total_force[:, 2] for touch in touches]
        yield "force along the axis, N", np.concatenate(forces).tolist()
        lowest = [touch.gel_displacement[:, :, 2].min(axis=1) for touch in touches]
        yield "indentation of the gel, mm", (-np.concatenate(lowest)).tolist()
    motions = [touch.markers_px - touch.rest_markers_px for touch in touches]
    if moved := [np.linalg.norm(m, axis=2).max(axis=1) for m in motions if m.shape[1]]:
        yield "largest motion of a marker, px", np.concatenate(moved).tolist()
