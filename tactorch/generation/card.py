"""Data card: the content of a dataset as text."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.files import write_file
from tactorch.generation.recipe import LINEAR
from tactorch.generation.sample import Sample
from tactorch.generation.sampleset import SampleSet
from tactorch.generation.touch_card import touch_contents, touch_method, touch_rows

CARD, PICTURE, TOUCH_PICTURE = "card.md", "card.png", "touch.png"
_MAX_CARD_SAMPLES = 500


def write_card(samples: SampleSet) -> Path:
    """Write card.md into the dataset's folder and return its path."""
    path = samples.folder / CARD
    write_file(path, _text(samples, card_samples(samples)))
    return path


def card_samples(samples: SampleSet) -> list[Sample]:
    """Return the samples of the card's statistics, evenly spread over the dataset."""
    places = np.linspace(0, len(samples) - 1, min(len(samples), _MAX_CARD_SAMPLES)).astype(int)
    return [samples[samples.indices[place]] for place in places]


def _text(samples: SampleSet, selected: Sequence[Sample]) -> str:
    manifest = samples.manifest
    recipe, failed = manifest["recipe"], manifest["failed"]
    family, has_touch = recipe["family"], "touch" in recipe
    size = sum(shard["bytes"] for shard in manifest["shards"])
    lines = [
        f"# {manifest['name']}",
        "",
        f"{len(samples)} samples in {len(manifest['shards'])} shards, {size / 1e6:.1f} MB;"
        f" {len(failed)} failed. Made by `tactorch generate` from random objects of the"
        f" family `{family['name'] if isinstance(family, dict) else family}` with seed"
        f" {recipe['seed']}.",
        "",
        f"![What is inside]({PICTURE})",
        *((f"![What the sensor sees]({TOUCH_PICTURE})",) if has_touch else ()),
        "",
        "## What is in a sample",
        "",
        "A recording (presses on a mesh, forces in N, displacements in mm) with the true Young's"
        " modulus of each element in MPa" + _second_map(recipe),
        *(touch_contents(recipe["touch"]) if has_touch else ()),
        "",
        *_statistics(selected),
        "## How it was made",
        "",
        *(
            touch_method(recipe["touch"], recipe["mesh"]["fine_relative"] is None)
            if has_touch
            else [_method(recipe)]
        ),
        "",
        *(f"- {key}: `{value}`" for key, value in recipe.items() if key != "inversion"),
        "",
        "Versions: " + ", ".join(f"{k} {v}" for k, v in manifest["versions"].items()) + ".",
        "",
    ]
    if failed:
        lines += ["## Failed", "", *(f"- {i}: {reason}" for i, reason in failed.items()), ""]
    return "\n".join(lines)


def _method(recipe: dict[str, Any]) -> str:
    return (
        "Presses are computed on the mesh that they are inverted on, with the same model: an"
        " inverse crime. Results on these data flatter."
        if recipe["mesh"]["fine_relative"] is None
        else "Presses are computed on a finer mesh than the one they are recorded and inverted on,"
        " and have noise: no inverse crime."
    )


def _statistics(selected: Sequence[Sample]) -> list[str]:
    if not selected:
        return []
    labels = Counter(sample.label for sample in selected)
    rows = {
        "presses": [len(s.recording.presses) for s in selected],
        "elements": [s.recording.mesh.n_tets for s in selected],
        "lowest modulus, MPa": [s.truth.min() for s in selected],
        "highest modulus, MPa": [s.truth.max() for s in selected],
        "largest displacement, mm": [s.largest_mm for s in selected],
    }
    if all(s.touch is not None for s in selected):
        rows |= touch_rows([s.touch for s in selected if s.touch is not None])
    figures = [s.figures for s in selected if s.figures]
    for name in ("iterations", "chi2", "ssim", "pearson", "rmse_mpa"):
        if figures and name in figures[0]:
            rows[f"reconstruction: {name}"] = [f[name] for f in figures]
    lines = [
        "Labels: " + ", ".join(f"{name} {count}" for name, count in sorted(labels.items())) + ".",
        "",
        f"| over {len(selected)} samples | 5 % | median | 95 % |",
        "|---|---:|---:|---:|",
    ]
    for name, values in rows.items():
        low, middle, high = np.nanquantile(np.array(values, dtype=float), [0.05, 0.5, 0.95])
        lines.append(f"| {name} | {low:.4g} | {middle:.4g} | {high:.4g} |")
    return [*lines, ""]


def _second_map(recipe: dict[str, Any]) -> str:
    if recipe["inversion"] == LINEAR:
        return ", and its linear image from the presses, a stand-in for a reconstruction."
    return ", and a reconstruction from the presses alone." if recipe["inversion"] else "."
