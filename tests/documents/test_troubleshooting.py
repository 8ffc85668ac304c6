"""Messages that the page on troubleshooting quotes are those of the source."""

import ast
import re
from functools import cache

import pytest

from .blocks import DOCS, ROOT, blocks

PAGE = DOCS / "troubleshooting.md"
QUOTED = [block.text.strip() for block in blocks(PAGE, "text")]
GAP = "\0"  # what differs from case to case
_LOGGED = re.compile(r"%[-+.\d]*[a-z]")


@cache
def messages() -> str:
    """All text of the source, one a line, with gaps for what is put in."""
    found = []
    for path in sorted((ROOT / "tactorch").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
                found.append(_LOGGED.sub(GAP, " ".join(text(node).split())))
    return "\n".join(found)


def text(node: ast.AST) -> str:
    """A string as written; concatenated literals are one node."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(text(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return text(node.left) + text(node.right)
    return GAP


def fixed_parts(message: str) -> list[str]:
    """What stands between the gaps and says something."""
    return [part for part in (p.strip() for p in message.split("…")) if len(part) > 3]


def stands_in_the_source(message: str) -> bool:
    """Whether one string of the source has all fixed parts of a message in turn."""
    parts = [re.escape(part) for part in fixed_parts(message)]
    return re.search(r"[^\n]*?".join(parts), messages()) is not None


def test_there_are_messages() -> None:
    assert len(QUOTED) > 30
    assert all(len("".join(fixed_parts(message))) > 8 or "give" in message for message in QUOTED)


@pytest.mark.parametrize("message", QUOTED, ids=lambda m: m[:40])
def test_a_quoted_message_stands_in_the_source(message: str) -> None:
    assert stands_in_the_source(message), fixed_parts(message)


@pytest.mark.parametrize(
    "wrong", ["Nothing holds the objects", "checkpoint '…' is for … moduluses"]
)
def test_other_words_do_not(wrong: str) -> None:
    assert not stands_in_the_source(wrong)
