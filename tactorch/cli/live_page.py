"""Page of a live run: one self-contained file that reloads itself."""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

_REFRESH_S = 2
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1b1f24; margin: 1.5rem auto; max-width: 66rem;
       padding: 0 1rem; }
h1 { font-size: 1.25rem; margin: 0; }
.status { color: #57606a; margin: 0.2rem 0 1rem; }
.finding { font-size: 1.1rem; font-weight: 600; margin: 0.4rem 0; }
.next { font-size: 1.1rem; margin: 0.4rem 0 1rem; color: #8a1f63; }
.note { background: #fff4e5; border-left: 4px solid #d55e00; padding: 0.3rem 0.7rem; }
img { width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13px; margin-top: 1rem; }
th, td { text-align: left; padding: 0.25rem 0.6rem; border-bottom: 1px solid #d0d7de; }
th { color: #57606a; font-weight: 600; }
"""


def page(
    *,
    source: str,
    status: str,
    finding: str,
    notes: Sequence[str],
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    picture: Path | None,
    refresh: bool,
) -> str:
    """Return the page as HTML.

    Args:
        source: Recording that is followed.
        status: Progress.
        finding: Finding of the map.
        notes: Latest messages on invalid presses and files.
        columns: Headings of the table.
        rows: Rows of the table, the newest first; the last cell is the next press.
        picture: Figure to embed, if the file exists.
        refresh: Whether the page reloads itself.
    """
    refresh_tag = f'<meta http-equiv="refresh" content="{_REFRESH_S}">' if refresh else ""
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8">{refresh_tag}',
        f"<title>tactorch live: {escape(Path(source).name)}</title><style>{_STYLE}</style></head>",
        f"<body><h1>{escape(source)}</h1>",
        f'<p class="status">{escape(status)}</p>',
    ]
    if finding:
        parts.append(f'<p class="finding">{escape(finding)}</p>')
    if rows and rows[0][-1] != "-":
        parts.append(f'<p class="next">Press next: {escape(rows[0][-1])}</p>')
    parts += [f'<p class="note">{escape(note)}</p>' for note in notes]
    if picture is not None and picture.is_file():
        content = base64.b64encode(picture.read_bytes()).decode("ascii")
        parts.append(f'<img alt="slices of the map" src="data:image/png;base64,{content}">')
    if rows:
        parts.append(f"<table><tr>{_cells('th', columns)}</tr>")
        parts += [f"<tr>{_cells('td', row)}</tr>" for row in rows]
        parts.append("</table>")
    return "\n".join([*parts, "</body></html>", ""])


def _cells(tag: str, values: Sequence[str]) -> str:
    return "".join(f"<{tag}>{escape(value)}</{tag}>" for value in values)
