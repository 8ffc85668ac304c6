"""Hooks of MkDocs: pages generated from the code, inserted content, and equations."""

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
_DOCSTRING = re.compile(r"<!-- the docstring of (tactorch[\w.]+) -->")
_WORDS = "<!-- words not used -->"
_CONFIGURATION = "configuration/index.md"
_EXTERNAL = re.compile(r'<(?:script|link|img|iframe)\b[^>]*(?:src|href)="?(?:https?:)?//[^>]*>')
_LINK = re.compile(r'href="(\.\./[\w/-]+)\.md')
_EXAMPLE = re.compile(r"^<!-- (examples/\w+\.py) -->$", flags=re.MULTILINE)


def on_config(config: MkDocsConfig, **_: Any) -> MkDocsConfig:
    """Put the pages of the configuration reference into the navigation."""
    for section in config.nav or []:
        for entries in section.values():
            if isinstance(entries, list) and _CONFIGURATION in entries:
                entries[entries.index(_CONFIGURATION)] = {
                    "Configuration": configuration.navigation()
                }
    return config


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add generated pages."""
    for path, content in {**configuration.pages(), **api.pages()}.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Insert layouts of files, examples, and the table of words that are not used."""
    text = _DOCSTRING.sub(lambda match: api.docstring(match[1]), markdown)
    if _WORDS in text:
        text = text.replace(_WORDS, _words_table())
    return _EXAMPLE.sub(lambda match: _example(match[1]), text)


def on_page_content(html: str, **_: Any) -> str:
    """Convert equations to MathML."""
    return equations.with_mathml(html)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """Complete links of notebooks, and refuse pages that load resources from a network.

    Raises:
        PluginError: A page has an external resource.
    """
    if page.file.src_uri.endswith(".ipynb"):  # whose links MkDocs leaves as they are
        output = _LINK.sub(r'href="\1.html', output)
    match = _EXTERNAL.search(output)
    if match:
        raise PluginError(f"{page.file.src_uri} needs a network: {match[0]}")
    return output


def _example(path: str) -> str:
    code = (_ROOT / path).read_text(encoding="utf-8")
    return f'```python title="{path}"\n{code}```'


def _words_table() -> str:
    lines = (_ROOT / "tests" / "documents" / "words.txt").read_text(encoding="utf-8").splitlines()
    rows = [f"| {line} |" for line in lines if line and not line.startswith("#")]
    return "\n".join(["| not used | write |", "|---|---|", *rows])
