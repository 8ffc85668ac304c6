"""Arrays of recordings, converted and checked."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError

_NEEDED = {
    "b": "it is a mask, one True or False per degree of freedom",
    "fiu": "real numbers are needed",
}


def make_array(
    value: Any, shape: tuple[int | None, ...], what: str, kinds: str = "fiu"
) -> Float[np.ndarray, "..."] | Bool[np.ndarray, "..."]:
    """Return a copy of `value` with `shape` (None: any length), or raise `RecordingError`.

    It is float64, or bool where `kinds` is "b". An array that is read-only and has this type is
    shared instead, so that many presses need not have a copy each; what it is a view of must not
    change. Numbers are refused for a mask: a list of indices would otherwise be read as one.
    """
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise RecordingError(f"{what} is not an array of numbers: {error}") from error
    if array.dtype.kind not in kinds:
        raise RecordingError(f"{what} has dtype {array.dtype}; {_NEEDED[kinds]}")
    fits = array.ndim == len(shape) and all(
        size in (None, actual) for size, actual in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        raise RecordingError(f"{what} has shape {array.shape}; ({wanted}) is needed")
    dtype = np.bool_ if kinds == "b" else np.float64
    if not array.flags.writeable and array.dtype == dtype:
        return array
    return np.array(array, dtype=dtype, order="C")


def require_finite(array: Float[np.ndarray, "..."], what: str) -> None:
    """Raise `RecordingError` naming the first entry of `array` that is NaN or infinite."""
    if not (finite := np.isfinite(array)).all():
        invalid = np.argwhere(~finite)
        where = tuple(int(i) for i in invalid[0])
        raise RecordingError(
            f"{what} holds {len(invalid)} values that are NaN or infinite, the first at {where}; "
            "repair or leave out what was not measured"
        )
