"""What the paper reports, from `paper.yaml`."""

from functools import cache
from importlib.resources import files
from typing import Any

import yaml


@cache
def paper() -> dict[str, Any]:
    """Return the paper's numbers, by exhibit."""
    text = files("tactorch.reproduce").joinpath("paper.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def column(table: str, name: str) -> list[Any]:
    """Return a column of one of the paper's tables that are given by rows."""
    content = paper()[table]
    place = content["columns"].index(name)
    return [row[place] for row in content["rows"]]


def row(table: str, key: str) -> dict[str, Any]:
    """Return the row of a table whose first value is `key`, by column."""
    content = paper()[table]
    found = next(values for values in content["rows"] if values[0] == key)
    return dict(zip(content["columns"], found, strict=True))
