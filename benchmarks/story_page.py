"""Run the code of a page as a user would, block by block, in the present folder.

    python story_page.py PAGE.md REPORT.json

Commands are run by a shell that stops at the first error; Python blocks share one namespace. The
report has lines, times and output of each block. It needs the standard library only, so that any
environment can run it.
"""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

_FENCE = re.compile(r"^```(sh|python)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


@dataclass
class Block:
    """Code of a page.

    Attributes:
        language: `sh` or `python`.
        text: The code.
        seconds: How long it took.
        processor_s: Processor seconds of it and of the programs that it started.
        output: What it printed.
        error: Why it failed; empty if it did not.
    """

    language: str
    text: str
    seconds: float = 0.0
    processor_s: float = 0.0
    output: str = ""
    error: str = ""

    @property
    def lines(self) -> int:
        """Lines that are not empty."""
        return sum(bool(line.strip()) for line in self.text.splitlines())


def read_blocks(page: Path) -> list[Block]:
    """Return the commands and the Python of a page, in their order."""
    return [Block(*match.groups()) for match in _FENCE.finditer(page.read_text(encoding="utf-8"))]


def run(blocks: list[Block]) -> bool:
    """Run blocks in the present folder until one fails; tell whether none did."""
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks:
        started, spent = time.perf_counter(), sum(os.times()[:4])
        if block.language == "sh":
            _run_commands(block)
        else:
            _run_python(block, names)
        block.seconds = time.perf_counter() - started
        block.processor_s = sum(os.times()[:4]) - spent
        if block.error:
            return False
    return True


def _run_commands(block: Block) -> None:
    """Run commands with the programs of this environment first."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        ["sh", "-e", "-c", block.text],
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    block.output = done.stdout
    if done.returncode:
        block.error = f"status {done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}"


def _run_python(block: Block, names: dict[str, object]) -> None:
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(block.text, "page", "exec"), names)
    except Exception as error:  # whatever the page raises is its outcome
        block.error = f"{type(error).__name__}: {error}"
    block.output = printed.getvalue()


def main() -> None:
    """Run a page and write its report."""
    page, report = Path(sys.argv[1]), Path(sys.argv[2])
    blocks = read_blocks(page)
    passed = run(blocks)
    rows = [{"lines": block.lines, **asdict(block)} for block in blocks]
    report.write_text(json.dumps({"passed": passed, "blocks": rows}))
    sys.exit(0 if passed else 1)


if __name__ == "__main__":
    main()
