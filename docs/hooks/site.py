"""Hooks of MkDocs: pages that are made from the code when the site is built, and equations."""

import re
from pathlib import Path
from typing import Any

import api
import configuration
import equations
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_ROOT = Path(__file__).resolve().parents[2]
_SCHEMA = "<!-- the docstring of tactorch.recording.schema -->"
_FETCHED = re.compile(r'<(?:script|link|img|iframe)\b[^>]*(?:src|href)="?(?:https?:)?//[^>]*>')
_EXAMPLE = re.compile(r"^<!-- (examples/\w+\.py) -->$", flags=re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add the pages that have no file."""
    for path, content in {"configuration.md": configuration.page(), **api.pages()}.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put in what stands elsewhere: the layout of recordings, and examples."""
    found = markdown.replace(_SCHEMA, api.docstring("tactorch.recording.schema"))
    return _EXAMPLE.sub(lambda match: _shown(match[1]), found)


def on_page_content(html: str, **_: Any) -> str:
    """Draw the equations."""
    return equations.with_mathml(html)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """Refuse what a reader's browser would have to fetch from elsewhere.

    Raises:
        PluginError: There is some.
    """
    found = _FETCHED.search(output)
    if found:
        raise PluginError(f"{page.file.src_uri} needs a network: {found[0]}")
    return output


def _shown(path: str) -> str:
    code = (_ROOT / path).read_text(encoding="utf-8")
    return f'```python title="{path}"\n{code}```'
