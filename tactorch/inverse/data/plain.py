"""Results as plain JSON values."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def to_plain(value: Any) -> Any:
    """Return arrays, dataclasses, tables and tuples as plain JSON values."""
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: to_plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def with_arrays(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return plain JSON values with lists of numbers as arrays."""
    return {
        name: np.array(value) if isinstance(value, list) else value for name, value in plain.items()
    }
