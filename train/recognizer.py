"""The recognition study from scratch (Section V-B): data, ten trainings, judgement, harder data.

    python train/recognizer.py [FOLDER]         data and runs go there; outputs/recognizer otherwise

Stopped or killed, the same command goes on where it was.
"""

import sys
from pathlib import Path

from tactorch.cli import main
from tactorch.learning.training import LAST

HARDER = ("recognition_noisy", "recognition_offcentre")


def make(folder: Path) -> None:
    """Make what is missing, and judge."""
    for name in ("recognition", *HARDER):
        main(["generate", f"dataset={name}", f"out={folder / name}"])
    run = folder / "run"
    if list(run.glob(f"split-*/{LAST}")):
        main(["train", f"resume={run}"])
    else:
        own = folder / "recognition"
        main(["train", "experiment=recognizer", f"data.folder={own}", f"run_dir={run}"])
    main(["evaluate-model", f"run={run}", f"run_dir={folder / 'judged'}"])
    for name in HARDER:
        other = [f"folder={folder / name}", f"run_dir={folder / f'judged_{name}'}"]
        main(["evaluate-model", f"run={run}", *other])


if __name__ == "__main__":
    make(Path(sys.argv[1] if len(sys.argv) > 1 else "outputs/recognizer"))
