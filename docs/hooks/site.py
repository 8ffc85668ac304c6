"""Hooks of MkDocs: pages that are made from the code when the site is built, and equations."""

import inspect
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from tactorch.recording import schema

sys.path.insert(0, str(Path(__file__).resolve().parent))

import configuration
import equations

_SCHEMA = "<!-- the docstring of tactorch.recording.schema -->"


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add the page that has no file."""
    files.append(File.generated(config, "configuration.md", content=configuration.page()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put in the layout of recordings, as the code has it."""
    return markdown.replace(_SCHEMA, inspect.getdoc(schema) or "")


def on_page_content(html: str, **_: Any) -> str:
    """Draw the equations."""
    return equations.with_mathml(html)
