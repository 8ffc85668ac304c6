"""Recognition (Section V-B, Fig. 11): similarity of the truths, and accuracy of the recognizer.

The network is trained and evaluated by the commands of users, on reconstructions of a separate
dataset: `tactorch generate`, `tactorch train experiment=recognizer` with several splits, and
`tactorch evaluate-model`. The accuracy of people by touch is that of the paper; software cannot
reproduce it.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import TactorchError
from tactorch.metrics import ssim
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import Case, CaseResult
from tactorch.reproduce.models import MODELS
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.viz.paper import plot_matrices

_SHAPES = {"cake": "4a", "torus": "4b", "cone": "4c"}
_SIMILARITY, _RECOGNIZER = "similarity", "recognizer"


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Return two cases: similarity of the truths, and recognizer."""
    edge = options["relative_edge_length"]
    return [
        Case("recognition", _SIMILARITY, {"relative_edge_length": edge}),
        Case("recognition", _RECOGNIZER, options),
    ]


def run_case(case: Case, scratch: Path) -> CaseResult:
    """Compare the truths, or train and evaluate the network."""
    return (
        _compare_truths(case.settings)
        if case.name == _SIMILARITY
        else _train_recognizer(case.settings, scratch)
    )


def _compare_truths(settings: Mapping[str, Any]) -> CaseResult:
    phantoms = [make_phantom(MODELS[model]) for model in _SHAPES.values()]
    mesh = phantoms[0].mesh(relative_edge_length=settings["relative_edge_length"])
    truths = [phantom.on_mesh(mesh) for phantom in phantoms]
    matrix = [[ssim(mesh, one, other) for other in truths] for one in truths]
    return CaseResult({"matrix": matrix})


def _train_recognizer(settings: Mapping[str, Any], scratch: Path) -> CaseResult:
    data, run, scores = (scratch / name for name in ("data", "run", "scores"))
    edge = settings["relative_edge_length"]
    _run_command(
        "generate",
        "dataset=recognition",
        f"dataset.count={settings['count']}",
        f"dataset.reconstruct={str(settings['reconstruct']).lower()}",
        f"dataset.sizes.relative_edge_length={edge}",
        f"dataset.sizes.fine_relative={edge / 2}",
        "card=false",
        f"out={data}",
        f"run_dir={scratch / 'generate'}",
    )
    if list(run.glob("**/last.ckpt")):
        _run_command("train", f"resume={run}")
    else:
        _run_command(
            "train",
            "experiment=recognizer",
            f"data.folder={data}",
            f"run_dir={run}",
            f"splits={settings['splits']}",
            f"trainer.max_epochs={settings['epochs']}",
        )
    _run_command("evaluate-model", f"run={run}", f"run_dir={scores}")
    return CaseResult(json.loads((scores / "scores.json").read_text()))


def _run_command(*arguments: str) -> None:
    """Run a command of tactorch.

    Raises:
        TactorchError: The command failed.
    """
    process = subprocess.run(
        [sys.executable, "-m", "tactorch", *arguments], capture_output=True, text=True, check=False
    )
    if process.returncode:
        reason = (process.stderr.strip() or process.stdout.strip()).splitlines()[-1:]
        raise TactorchError(f"tactorch {' '.join(arguments)} failed: {' '.join(reason)}")


def fig11(results: Mapping[str, CaseResult], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 11: similarity of the truths, confusion of the network."""
    known, matrices = paper()["recognition"], {}
    summary = Table(["", "paper", "here"], [None, 3, 3])
    if _SIMILARITY in results:
        similarity = np.array(results[_SIMILARITY].figures["matrix"])
        matrices["SSIM of the truths"] = (similarity, tuple(_SHAPES))
        summary.add("SSIM of cake and cone", known["ssim_cake_cone"], float(similarity[0, 2]))
    if _RECOGNIZER in results:
        recognizer = results[_RECOGNIZER].figures
        order = [list(recognizer["classes"]).index(name) for name in _SHAPES]
        counts = np.array(recognizer["confusion"], dtype=float)[np.ix_(order, order)]
        fractions = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        title = f"predicted (columns) by true (rows), {recognizer['samples']} samples"
        matrices[title] = (fractions, tuple(_SHAPES))
        summary.add("accuracy of the recognizer", known["accuracy"], recognizer["accuracy"])
        summary.add("its standard deviation over splits", None, recognizer["accuracy_deviation"])
        summary.add("accuracy of people", known["human_accuracy"], None)
    summary.write_csv(out / "fig11.csv")
    plot_matrices(matrices, out / "fig11.png")
    return f"{summary.markdown()}\n\n![Similarity and confusion](fig11.png)"


EXHIBITS = {"fig11": fig11}
