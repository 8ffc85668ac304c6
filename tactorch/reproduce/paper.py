"""Numbers of the paper, from `paper.yaml`."""

from functools import cache
from importlib.resources import files
from typing import Any

import yaml


@cache
def paper() -> dict[str, Any]:
    """Return the numbers of the paper by exhibit."""
    text = files("tactorch.reproduce").joinpath("paper.yaml").read_text(encoding="utf-8")
    numbers: dict[str, Any] = yaml.safe_load(text)
    return numbers


def column(table: str, name: str) -> list[Any]:
    """Return a column of a table of the paper."""
    content = paper()[table]
    index = content["columns"].index(name)
    return [row[index] for row in content["rows"]]


def row(table: str, key: str) -> dict[str, Any]:
    """Return the values of the row whose first value is `key` by column."""
    content = paper()[table]
    row_values = next(values for values in content["rows"] if values[0] == key)
    return dict(zip(content["columns"], row_values, strict=True))
