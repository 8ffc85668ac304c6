"""Small pieces of HTML; all text is escaped."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any


def text(value: Any) -> str:
    """Return text as it may stand between tags and in attributes."""
    return escape(str(value), quote=True)


def element(name: str, inner: str = "", **attributes: str) -> str:
    """Return an element around HTML; `class_` stands for class, `_` for a hyphen."""
    told = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"' for key, value in attributes.items()
    )
    return f"<{name}{told}>{inner}</{name}>"


def folded(summary: str, inner: str) -> str:
    """Return what opens by a click; it is printed in full."""
    return f"<details><summary>{text(summary)}</summary>{inner}</details>"


def bullets(lines: Iterable[str]) -> str:
    """Return a list of plain sentences."""
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"


def table(
    head: Sequence[str],
    body: Iterable[Sequence[str]],
    *,
    caption: str,
    best: Mapping[int, set[int]] | None = None,
) -> str:
    """Return a table whose first column names its rows.

    Args:
        head: Titles of the columns.
        body: Rows of plain text.
        caption: What the table tells, for all readers.
        best: Per row, the columns that are marked as best.
    """
    marks = best or {}
    titles = "".join(f'<th scope="col">{text(title)}</th>' for title in head)
    lines = []
    for number, row in enumerate(body):
        cells = "".join(
            _cell(cell, column in marks.get(number, ()))
            for column, cell in enumerate(row)
            if column
        )
        lines.append(f'<tr><th scope="row">{text(row[0])}</th>{cells}</tr>')
    return (
        f'<div class="scroll"><table><caption>{text(caption)}</caption>'
        f"<thead><tr>{titles}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )


def _cell(cell: str, best: bool) -> str:
    if not best:
        return f"<td>{text(cell)}</td>"
    return f'<td class="best">{text(cell)} <span class="mark">best</span></td>'
