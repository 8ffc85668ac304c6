"""Words that are not used in code, settings, messages and documentation, with their replacements.

Rows of `words.txt` are "word | replacement"; a word may be a phrase, and ends in * for any ending.
Rows of `words_allowed.txt` are exceptions, "word | path | reason"; the reason "pending" marks
occurrences that remain to be rewritten.
"""

import ast
import io
import re
import tokenize
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from .blocks import DOCS, ROOT

HERE = Path(__file__).parent
PAGE = DOCS / "glossary.md"
_PATTERNS = (
    "tactorch/**/*.py",
    "tactorch/**/*.html",
    "tactorch/**/*.js",
    "tactorch/**/*.css",
    "tactorch/**/*.j2",
    "tactorch/**/*.yaml",
    "conf/**/*.yaml",
    "docs/*.md",
    "docs/howto/*.md",
    "docs/stories/*.md",
    "docs/theory/*.md",
    "docs/reproduction/*.md",
    "docs/hooks/*.py",
    "examples/*.py",
    "examples/stories/*.py",
    "benchmarks/*.py",
    "datasets/*.md",
    "datasets/*.py",
    "train/*.py",
    "README.md",
    "CHANGELOG.md",
)
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|_+")


@dataclass(frozen=True)
class Finding:
    """Occurrence of a word that is not used."""

    path: str
    line: int
    word: str
    replacement: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: '{self.word}' is not used; write {self.replacement}"


def _rows(name: str) -> list[tuple[str, ...]]:
    lines = (HERE / name).read_text().splitlines()
    rows = [line for line in lines if line.strip() and not line.startswith("#")]
    return [tuple(cell.strip() for cell in row.split("|")) for row in rows]


@cache
def words() -> dict[str, str]:
    """Replacement of each word that is not used."""
    return {word: replacement for word, replacement in _rows("words.txt")}


@cache
def patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    def pattern(word: str) -> re.Pattern[str]:
        body = re.escape(word.removesuffix("*")).replace(r"\ ", r"\s+")
        ending = r"\w*" if word.endswith("*") else ""
        return re.compile(rf"(?<![\w-]){body}{ending}(?![\w-])", re.IGNORECASE)

    return tuple((word, pattern(word)) for word in words())


def allowed() -> dict[tuple[str, str], str]:
    """Reason by word and the beginning of a path."""
    return {(word, path): reason for word, path, reason in _rows("words_allowed.txt")}


def check(path: str, text: str) -> list[Finding]:
    """Return the words that are not used in a file; of Python, in names, comments and strings."""
    sections = _python(text) if path.endswith(".py") else [(1, text)]
    whole = "\n\0".join(section for _, section in sections)  # most files have none of the words
    found = [(word, pattern) for word, pattern in patterns() if pattern.search(whole)]
    return [
        Finding(path, line + section.count("\n", 0, match.start()), word, words()[word])
        for line, section in sections
        for word, pattern in found
        for match in pattern.finditer(section)
    ]


def _python(text: str) -> list[tuple[int, str]]:
    """Return the strings, the comments, and the names in their parts, with their lines."""
    sections: list[tuple[int, str]] = []
    comments: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments.append((token.start[0], token.string.lstrip("# ")))
    for line, comment in comments:  # consecutive lines are one text
        if sections and sections[-1][0] + sections[-1][1].count("\n") + 1 == line:
            sections[-1] = (sections[-1][0], f"{sections[-1][1]}\n{comment}")
        else:
            sections.append((line, comment))
    nested: set[int] = set()  # parts of f-strings, which come after these
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):
            nested.update(map(id, node.values))
            values = [p.value if isinstance(p, ast.Constant) else "0" for p in node.values]
            sections.append((node.lineno, "".join(map(str, values))))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in nested:
                sections.append((node.lineno, node.value))
        else:
            sections.extend((line, _CAMEL.sub(" ", name)) for line, name in _names(node))
    return sections


def _names(node: ast.AST) -> list[tuple[int, str]]:
    """Return the names that a node defines."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            return [(node.lineno, node.name)]
        case ast.arg():
            return [(node.lineno, node.arg)]
        case ast.Name(ctx=ast.Store()):
            return [(node.lineno, node.id)]
        case ast.Attribute(ctx=ast.Store()):
            return [(node.lineno, node.attr)]
    return []


def files() -> list[Path]:
    return sorted({path for pattern in _PATTERNS for path in ROOT.glob(pattern)} - {PAGE})


@cache
def findings() -> tuple[Finding, ...]:
    return tuple(
        finding
        for path in files()
        for finding in check(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
    )


def test_words_are_those_of_the_glossary() -> None:
    refused = [
        str(finding)
        for finding in findings()
        if not any(
            finding.word == word and finding.path.startswith(path) for word, path in allowed()
        )
    ]
    assert not refused, "\n".join(["", *refused])


def test_every_exception_is_needed() -> None:
    unused = [
        f"{word} | {path}"
        for (word, path), reason in allowed().items()
        if reason != "pending"
        and not any(f.word == word and f.path.startswith(path) for f in findings())
    ]
    assert not unused, "\n".join(["", *unused])


@pytest.mark.parametrize(
    ("path", "text", "expected"),
    [
        ("a.py", 'x = 1\n"""Foretells the map."""\n', [(2, "foretell*")]),
        ("a.py", "# of the noise, for want\n# of a better one\n", [(1, "for want of")]),
        ("a.py", 'raise ValueError(f"{x} whoever reads it")\n', [(1, "whoever")]),
        ("a.py", "def foretold_map(anew): ...\n", [(1, "foretold"), (1, "anew")]),
        ("a.py", "class MapForetold: ...\n", [(1, "foretold")]),
        ("a.md", "A map is\nmade anew.\n", [(2, "anew")]),
        ("a.yaml", "weight: 1  # learnt\n", [(1, "learnt")]),
        ("a.py", "prediction = 1  # renewed manewvre\n", []),
    ],
)
def test_the_check_finds(path: str, text: str, expected: list[tuple[int, str]]) -> None:
    assert [(f.line, f.word) for f in check(path, text)] == expected
    assert all(str(f).startswith(f"{path}:{f.line}: ") for f in check(path, text))


def test_each_word_has_another() -> None:
    assert len(words()) > 30
    for word, replacement in words().items():
        assert replacement
        assert not any(p.search(replacement) for _, p in patterns()), f"{word}: {replacement}"
