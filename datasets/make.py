"""Make the project's datasets; each is what `tactorch generate dataset=NAME` makes.

    python datasets/make.py                     all of them, in data/
    python datasets/make.py warmstart           one
    python datasets/make.py recognition workers=8 out=/big/disk/recognition

After an interruption the same command continues. What is in each, and how long it takes,
is described in README.md in this folder; each dataset has a data card with pictures.
"""

import sys

from tactorch.cli import main

NAMES = (
    "recognition",
    "recognition_noisy",
    "recognition_offcentre",
    "recognition_large",
    "warmstart",
    "touch",
)


def make(arguments: list[str]) -> None:
    """Make the datasets that are named, or all."""
    names = [word for word in arguments if "=" not in word]
    settings = [word for word in arguments if "=" in word]
    if len(names) != 1 and any(word.startswith("out=") for word in settings):
        sys.exit("out= is the folder of one dataset; name which.")
    for name in names or NAMES:
        main(["generate", f"dataset={name}", *settings])


if __name__ == "__main__":
    make(sys.argv[1:])
