"""Compact and safe encoding of arrays and text in a page."""

import base64
import json
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

_STEPS = 65_535


def packed(array: Shaped[np.ndarray, "..."], dtype: str) -> dict[str, Any]:
    """Return the little-endian bytes of an array, within the range of `dtype`, in base64."""
    data = np.ascontiguousarray(array, dtype=np.dtype(dtype).newbyteorder("<")).tobytes()
    return {"dtype": dtype, "data": base64.b64encode(data).decode("ascii")}


def indices(array: Int[np.ndarray, "..."], count: int) -> dict[str, Any]:
    """Return indices below `count`, with two bytes each if possible."""
    return packed(array, "uint16" if count <= _STEPS + 1 else "uint32")


def quantised(values: Float[np.ndarray, " m"]) -> dict[str, Any]:
    """Return a field with two bytes per value, on a logarithmic scale if all are positive.

    There are 65,535 steps between minimum and maximum: 0.02 % for moduli of 0.001 to 100 MPa.
    """
    ratio = bool(values.min() > 0)
    scaled = np.log(values) if ratio else values
    low, high = float(scaled.min()), float(scaled.max())
    width = high - low
    steps = np.rint((scaled - low) / width * _STEPS) if width > 0 else np.zeros(len(values))
    return packed(steps, "uint16") | {"ratio": ratio, "low": low, "high": high}


def rows(values: Float[np.ndarray, "k 3"]) -> dict[str, Any]:
    """Return vectors with two bytes per component, relative to the largest; NaN is kept."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    step = largest / (_STEPS // 2) if largest > 0 else 1.0
    whole = np.where(np.isnan(values), -(_STEPS // 2) - 1, np.rint(values / step))
    return packed(whole, "int16") | {"step": step}


def script_json(value: Any) -> str:
    """Return JSON that cannot close the script element that contains it."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
