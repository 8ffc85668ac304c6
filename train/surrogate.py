"""Make the surrogate that ships with tactorch, from scratch: data, training, evaluation, weights.

    python train/surrogate.py [FOLDER]          data and run go there; outputs/surrogate otherwise

After an interruption the same command continues. The weights and the note of how they were
made are written to FOLDER as surrogate.pt and surrogate.json; to ship them, copy both to
tactorch/learning/surrogate/.
"""

import json
import sys
from pathlib import Path
from typing import Any

from tactorch.cli import main
from tactorch.files import atomic_path
from tactorch.generation import SampleSet
from tactorch.learning.surrogate.network import WEIGHT_BITS, export_weights
from tactorch.learning.training import BEST, LAST

_PLACES = ("folder:", "run_dir:", "resume:")


def make(folder: Path) -> None:
    """Make what is missing of data, training, evaluation and weights."""
    data, run, evaluated = folder / "warmstart", folder / "run", folder / "evaluated"
    main(["generate", "dataset=warmstart", f"out={data}", f"run_dir={folder / 'generate'}"])
    if (run / LAST).is_file():
        main(["train", f"resume={run}"])
    else:
        main(["train", "experiment=surrogate", f"data.folder={data}", f"run_dir={run}"])
    main(["evaluate-model", f"run={run}", f"run_dir={evaluated}"])
    export_weights(run / BEST, folder / "surrogate.pt")
    with atomic_path(folder / "surrogate.json") as temporary:
        temporary.write_text(
            json.dumps(note(data, run, evaluated), indent=1) + "\n", encoding="utf-8"
        )


def note(data: Path, run: Path, evaluated: Path) -> dict[str, Any]:
    """Return what the weights were made of."""
    manifest = SampleSet(data).manifest
    scores = json.loads((evaluated / "scores.json").read_text(encoding="utf-8"))
    config = (run / ".hydra" / "config.yaml").read_text(encoding="utf-8").splitlines()
    return {
        "dataset": {
            "recipe": manifest["recipe"],
            "versions": manifest["versions"],
            "shards": [shard["sha256"] for shard in manifest["shards"]],
        },
        "training": [line for line in config if not line.strip().startswith(_PLACES)],
        "test part": scores,
        "bits per weight": WEIGHT_BITS,
    }


if __name__ == "__main__":
    make(Path(sys.argv[1] if len(sys.argv) > 1 else "outputs/surrogate"))
