"""Numbers and text as a page can hold them: few bytes, and nothing that could run."""

import base64
import json
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

_STEPS = 65_535


def packed(array: Shaped[np.ndarray, "..."], dtype: str) -> dict[str, Any]:
    """Return an array as its little-endian bytes in base64.

    Args:
        array: Numbers that `dtype` can hold.
        dtype: "float32", "uint32", "uint16", "int16" or "uint8".
    """
    data = np.ascontiguousarray(array, dtype=np.dtype(dtype).newbyteorder("<")).tobytes()
    return {"dtype": dtype, "data": base64.b64encode(data).decode("ascii")}


def indices(array: Int[np.ndarray, "..."], count: int) -> dict[str, Any]:
    """Return indices below `count`, in two bytes each where that does."""
    return packed(array, "uint16" if count <= _STEPS + 1 else "uint32")


def quantised(values: Float[np.ndarray, " m"]) -> dict[str, Any]:
    """Return a field in two bytes a value, in steps of equal ratio where all are above 0.

    Between the least and the largest value there are 65,535 steps: of a modulus that goes from
    0.001 to 100 MPa each is 0.02 %.
    """
    ratio = bool(values.min() > 0)
    scaled = np.log(values) if ratio else values
    low, high = float(scaled.min()), float(scaled.max())
    width = high - low
    steps = np.rint((scaled - low) / width * _STEPS) if width > 0 else np.zeros(len(values))
    return packed(steps, "uint16") | {"ratio": ratio, "low": low, "high": high}


def rows(values: Float[np.ndarray, "k 3"]) -> dict[str, Any]:
    """Return vectors in two bytes a component, in steps of their largest; NaN is kept."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    step = largest / (_STEPS // 2) if largest > 0 else 1.0
    whole = np.where(np.isnan(values), -(_STEPS // 2) - 1, np.rint(values / step))
    return packed(whole, "int16") | {"step": step}


def script_json(value: Any) -> str:
    """Return JSON that stands within a script element of a page and cannot end it."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
