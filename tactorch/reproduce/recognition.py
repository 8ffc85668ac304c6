"""Recognition (Section V-B, Fig. 11): how alike the truths are, and who tells them apart.

The network is trained and judged by the commands that anyone would use, on reconstructions of a
dataset of their own: `tactorch generate`, `tactorch train experiment=recognizer` over several
splits, `tactorch evaluate-model`. How well people do by touch is the paper's; no software repeats
that.
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
from tactorch.reproduce.cases import Case, Outcome
from tactorch.reproduce.models import MODELS
from tactorch.reproduce.paper import paper
from tactorch.reproduce.table import Table
from tactorch.viz.paper import plot_matrices

_SHAPES = {"cake": "4a", "torus": "4b", "cone": "4c"}
_ALIKE, _NAMED = "similarity", "recognizer"


def cases(options: Mapping[str, Any]) -> list[Case]:
    """Two: the truths, and the network."""
    edge = options["relative_edge_length"]
    return [
        Case("recognition", _ALIKE, {"relative_edge_length": edge}),
        Case("recognition", _NAMED, options),
    ]


def work(case: Case, scratch: Path) -> Outcome:
    """Compare the truths, or train and judge the network."""
    return _alike(case.settings) if case.name == _ALIKE else _recognizer(case.settings, scratch)


def _alike(settings: Mapping[str, Any]) -> Outcome:
    phantoms = [make_phantom(MODELS[model]) for model in _SHAPES.values()]
    mesh = phantoms[0].mesh(relative_edge_length=settings["relative_edge_length"])
    truths = [phantom.on_mesh(mesh) for phantom in phantoms]
    matrix = [[ssim(mesh, one, other) for other in truths] for one in truths]
    return Outcome({"matrix": matrix})


def _recognizer(settings: Mapping[str, Any], scratch: Path) -> Outcome:
    data, run, judged = (scratch / name for name in ("data", "run", "judged"))
    edge = settings["relative_edge_length"]
    _command(
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
        _command("train", f"resume={run}")
    else:
        _command(
            "train",
            "experiment=recognizer",
            f"data.folder={data}",
            f"run_dir={run}",
            f"splits={settings['splits']}",
            f"trainer.max_epochs={settings['epochs']}",
        )
    _command("evaluate-model", f"run={run}", f"run_dir={judged}")
    return Outcome(json.loads((judged / "scores.json").read_text()))


def _command(*arguments: str) -> None:
    """Run a command of tactorch.

    Raises:
        TactorchError: It failed; says why.
    """
    done = subprocess.run(
        [sys.executable, "-m", "tactorch", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        reason = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise TactorchError(f"tactorch {' '.join(arguments)} failed: {' '.join(reason)}")


def fig11(outcomes: Mapping[str, Outcome], options: Mapping[str, Any], out: Path) -> str:
    """Draw Fig. 11: similarity of the truths, confusion of the network."""
    known, matrices = paper()["recognition"], {}
    summary = Table(["", "paper", "here"], [None, 3, 3])
    if _ALIKE in outcomes:
        alike = np.array(outcomes[_ALIKE].figures["matrix"])
        matrices["SSIM of the truths"] = (alike, tuple(_SHAPES))
        summary.add("SSIM of cake and cone", known["ssim_cake_cone"], float(alike[0, 2]))
    if _NAMED in outcomes:
        found = outcomes[_NAMED].figures
        order = [list(found["classes"]).index(name) for name in _SHAPES]
        counts = np.array(found["confusion"], dtype=float)[np.ix_(order, order)]
        shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        title = f"named (across) of true (down), {found['samples']} answers"
        matrices[title] = (shares, tuple(_SHAPES))
        summary.add("shapes named right", known["accuracy"], found["accuracy"])
        summary.add("their deviation over splits", None, found["accuracy_deviation"])
        summary.add("the same by people", known["human_accuracy"], None)
    summary.write_csv(out / "fig11.csv")
    plot_matrices(matrices, out / "fig11.png")
    return f"{summary.markdown()}\n\n![Similarity and confusion](fig11.png)"


EXHIBITS = {"fig11": fig11}
