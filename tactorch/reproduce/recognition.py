"""Recognition (Section V-B, Fig. 11): similarity of the truths, and accuracy of the recognizer.

The network is trained and evaluated by the commands of users, on reconstructions of a separate
dataset: `tactorch generate`, `tactorch train experiment=recognizer` with several splits, and
`tactorch evaluate-model`. The accuracy of people by touch is that of the paper; software cannot
reproduce it.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from tactorch.errors import TactorchError
from tactorch.metrics import ssim
from tactorch.phantoms import make_phantom
from tactorch.reproduce.cases import CaseResult, CaseSettings, Exhibit, Results, Table
from tactorch.reproduce.models import MODELS
from tactorch.reproduce.paper import paper
from tactorch.viz.paper import matrices_figure

_SHAPES = {"cake": "4a", "torus": "4b", "cone": "4c"}
_SIMILARITY, _RECOGNIZER = "similarity", "recognizer"


def cases(options: CaseSettings) -> dict[str, CaseSettings]:
    """Return two cases: similarity of the truths, and recognizer."""
    edge = options["relative_edge_length"]
    return {_SIMILARITY: {"relative_edge_length": edge}, _RECOGNIZER: options}


def run_case(settings: CaseSettings, scratch: Path) -> CaseResult:
    """Train and evaluate the network, or compare the truths, for which the mesh suffices."""
    if "epochs" in settings:
        return _train_recognizer(settings, scratch)
    phantoms = [make_phantom(MODELS[model]) for model in _SHAPES.values()]
    mesh = phantoms[0].mesh(relative_edge_length=settings["relative_edge_length"])
    truths = [phantom.on_mesh(mesh) for phantom in phantoms]
    return CaseResult({"matrix": [[ssim(mesh, a, b) for b in truths] for a in truths]})


def _train_recognizer(settings: CaseSettings, scratch: Path) -> CaseResult:
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
    process = subprocess.run(
        [sys.executable, "-m", "tactorch", *arguments], capture_output=True, text=True, check=False
    )
    if process.returncode:
        reason = (process.stderr.strip() or process.stdout.strip()).splitlines()[-1:]
        raise TactorchError(f"tactorch {' '.join(arguments)} failed: {' '.join(reason)}")


def fig11(results: Results, options: CaseSettings) -> Exhibit:
    """Return Fig. 11: similarity of the truths, confusion of the network."""
    known, matrices = paper()["recognition"], {}
    summary = Table({"": None, "paper": 3, "here": 3})
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
    figure = matrices_figure(matrices)
    return Exhibit([summary.markdown()], summary, figure, "Similarity and confusion")


EXHIBITS = {"fig11": fig11}
