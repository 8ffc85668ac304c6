"""Code in documents: what its blocks are, and how they are run or checked."""

import re
import shlex
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
LANGUAGES = ("python", "sh", "toml", "yaml", "text")

_BLOCK = re.compile(
    r"^(?P<marks>(?:[ \t]*<!-- [a-z]+ -->\n\n?)*)"
    r"(?P<indent> *)```(?P<head>[^\n]*)\n(?P<text>.*?)^(?P=indent)```$",
    flags=re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        page: Of which document.
        language: What the fence says.
        title: Name of the file that it shows, or nothing.
        text: The code.
        marks: Words in comments before it: `slow` (takes long), `run` (commands that can be run).
    """

    page: str
    language: str
    title: str
    text: str
    marks: tuple[str, ...]

    @property
    def slow(self) -> bool:
        """Whether it takes long."""
        return "slow" in self.marks


def blocks(path: Path, *languages: str) -> list[Block]:
    """Return the blocks of a document, of some languages or all."""
    found = [_block(path.name, match) for match in _BLOCK.finditer(path.read_text())]
    return [block for block in found if not languages or block.language in languages]


def _block(page: str, match: re.Match[str]) -> Block:
    language, _, rest = match["head"].partition(" ")
    title = re.search(r'title="([^"]*)"', rest)
    text = textwrap.dedent(match["text"])
    marks = tuple(re.findall(r"<!-- (\w+) -->", match["marks"]))
    return Block(page, language, title[1] if title else "", text, marks)


def pages() -> list[Path]:
    """The documents that the site shows, but for those made when it is built."""
    return sorted(path for path in DOCS.rglob("*.md"))


def commands(block: Block) -> list[list[str]]:
    """The commands of a block in words, without comments."""
    lines = block.text.replace("\\\n", " ").splitlines()
    words = (shlex.split(line, comments=True) for line in lines)
    return [line for line in words if line]
