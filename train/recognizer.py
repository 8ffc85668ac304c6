"""The recognition study from scratch (Section V-B): data, ten trainings, evaluation, harder data.

    python train/recognizer.py [FOLDER]         data and runs go there; outputs/recognizer otherwise

After an interruption the same command continues.
"""

import sys
from pathlib import Path

from tactorch.cli import main
from tactorch.learning.training import LAST

HARDER = ("recognition_noisy", "recognition_offcentre")


def make(folder: Path) -> None:
    """Make what is missing, and evaluate."""
    for name in ("recognition", *HARDER):
        main(["generate", f"dataset={name}", f"out={folder / name}"])
    run = folder / "run"
    if list(run.glob(f"split-*/{LAST}")):
        main(["train", f"resume={run}"])
    else:
        own = folder / "recognition"
        main(["train", "experiment=recognizer", f"data.folder={own}", f"run_dir={run}"])
    main(["evaluate-model", f"run={run}", f"run_dir={folder / 'evaluated'}"])
    for name in HARDER:
        other = [f"folder={folder / name}", f"run_dir={folder / f'evaluated_{name}'}"]
        main(["evaluate-model", f"run={run}", *other])


if __name__ == "__main__":
    make(Path(sys.argv[1] if len(sys.argv) > 1 else "outputs/recognizer"))
