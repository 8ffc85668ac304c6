"""The stories of the documentation, run from the wheel in a fresh environment and timed.

    python benchmarks/stories.py [--story NAME...] [--data FOLDER] [--keep FOLDER]
        [--pip-args "--extra-index-url INDEX"] [--out FOLDER]

A story is a page of `docs/stories`: shell commands and Python of less than 40 lines together. The
wheel is built, a new virtual environment is made, and the wheel with its requirements is installed
there with the pinned versions of `constraints.txt`. The blocks of each page are then run from top
to bottom in an empty folder, to which the input of the story is copied. It is made before, in the
present environment, by the scripts of `examples/stories`, and kept in `--data`.

The table has the lines and the seconds of each story without making its input and without the
installation, which are stated separately. The last line printed is one JSON object.
"""

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from machine import OtherWork, write_results

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "stories"
STORIES = ("roboticist", "anatomist", "learner")
MAX_LINES, MAX_SECONDS = 40, 300.0  # what a story takes is less
PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "lightning", "pypardiso", "mkl")
# Of a wheel's environment, not of this one.
_FORGOTTEN = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the stories and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--story", nargs="+", default=list(STORIES), choices=STORIES)
    parser.add_argument("--data", type=Path, default=ROOT / "data" / "stories")
    parser.add_argument("--keep", type=Path, help="new folder for the environment and the runs")
    parser.add_argument("--pip-args", default="", help="further arguments for pip")
    parser.add_argument("--out", type=Path, help="folder for stories.json and .md")
    options = parser.parse_args(arguments)
    made = {name: make_input(name, options.data) for name in options.story}
    with TemporaryDirectory() as temporary:
        place = (options.keep or Path(temporary)).resolve()
        place.mkdir(parents=True, exist_ok=True)
        started = time.perf_counter()
        python = make_environment(place, shlex.split(options.pip_args))
        installed = time.perf_counter() - started
        stories = {}
        for name in options.story:
            found = run_story(name, place / name, python, options.data)
            stories[name] = {"input_s": made[name], **found}
            print(row(name, stories[name]), flush=True)
    result = {"installation_s": installed, "stories": stories}
    lines = format_table(result)
    print("\n".join(["", *lines]))
    if options.out is not None:
        write_results(options.out, "stories", lines, result, PACKAGES)
    print(json.dumps(result))
    if not all(story["passed"] for story in stories.values()):
        sys.exit(1)


def make_input(name: str, data: Path) -> float | None:
    """Make the input of a story; return the seconds, or None if there is none or it was there."""
    script = ROOT / "examples" / "stories" / f"make_{name}_data.py"
    if not script.is_file() or (data / name / "truth.json").is_file():
        return None
    started = time.perf_counter()
    subprocess.run([sys.executable, str(script), str(data / name)], check=True)
    return time.perf_counter() - started


def make_environment(place: Path, pip_args: list[str]) -> Path:
    """Make an environment with the wheel in a folder, and return its Python."""
    build = ["wheel", "--no-deps", "--no-build-isolation", "-q", "-w", str(place)]
    subprocess.run([sys.executable, "-m", "pip", *build, str(source(place))], check=True)
    (wheel,) = place.glob("*.whl")
    environment = place / "environment"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
    pinned = ["-c", str(ROOT / "constraints.txt"), *pip_args, str(wheel)]
    subprocess.run([str(python), "-m", "pip", "install", "-q", *pinned], env=clean(), check=True)
    return python


def source(place: Path) -> Path:
    """Copy what the wheel is made of, so that no earlier build of the checkout is in it."""
    folder = place / "source"
    ignore = shutil.ignore_patterns("__pycache__")
    for name in ("tactorch", "conf"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignore)
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, folder / name)
    return folder


def clean() -> dict[str, str]:
    """Environment variables without those that lead to this environment's packages."""
    return {name: value for name, value in os.environ.items() if name not in _FORGOTTEN}


def run_story(name: str, folder: Path, python: Path, data: Path) -> dict[str, Any]:
    """Run a story in a new folder with its input; return its figures."""
    folder.mkdir(parents=True)
    if (data / name).is_dir():
        shutil.copytree(data / name, folder, dirs_exist_ok=True)
        (folder / "truth.json").unlink()
    report, meter = folder.parent / f"{name}.json", OtherWork()
    command = [str(python), str(ROOT / "benchmarks" / "story_page.py")]
    cache = {
        "NUMBA_CACHE_DIR": str(folder.parent / "numba"),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    words = [*command, str(PAGES / f"{name}.md"), str(report)]
    subprocess.run(words, cwd=folder, env=clean() | cache, check=False)
    found = json.loads(report.read_text())
    return {
        "lines": sum(block["lines"] for block in found["blocks"]),
        "seconds": sum(block["seconds"] for block in found["blocks"]),
        "processor_s": sum(block["processor_s"] for block in found["blocks"]),
        "passed": found["passed"],
        "other_work": meter.share(),
        "blocks": [
            # What a block prints names folders of the machine.
            {key: value for key, value in block.items() if key not in ("text", "output")}
            for block in found["blocks"]
        ],
    }


def row(name: str, story: dict[str, Any]) -> str:
    """Return a row of the table."""
    each = ", ".join(f"{block['seconds']:.0f}" for block in story["blocks"])
    errors = [block["error"] for block in story["blocks"] if block["error"]]
    outcome = errors[0].splitlines()[-1] if errors else "passed"
    cells = [name, story["lines"], f"{story['seconds']:.0f}", each, f"{story['processor_s']:.0f}",
             f"{story['other_work'] or 0:.0%}", outcome]  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def format_table(result: dict[str, Any]) -> list[str]:
    """Return the table as Markdown."""
    lines = [
        "| story | lines | seconds | of each block | processor | cores used by others | outcome |",
        "|---|---|---|---|---|---|---|",
        *(row(name, story) for name, story in result["stories"].items()),
        "",
        f"Building the wheel and installing it in a new environment took "
        f"{result['installation_s']:.0f} s.",
    ]
    made = {n: s["input_s"] for n, s in result["stories"].items() if s["input_s"] is not None}
    if made:
        each = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in made.items())
        lines.append(f"Making the input before took: {each}.")
    return lines


if __name__ == "__main__":
    main()
