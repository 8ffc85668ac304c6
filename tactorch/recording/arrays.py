"""Turning what a caller gives into the arrays that recordings hold, or saying why not."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import RecordingError


def real_array(value: Any, shape: tuple[int | None, ...], what: str) -> Float[np.ndarray, "..."]:
    """Return `value` as a float64 array of `shape` (None: any length), or raise RecordingError."""
    array = _array(value, what)
    if array.dtype.kind not in "fiu":
        raise RecordingError(f"{what} has dtype {array.dtype}; real numbers are needed")
    _check_shape(array, shape, what)
    return np.array(array, dtype=np.float64, order="C")


def bool_array(value: Any, shape: tuple[int | None, ...], what: str) -> Bool[np.ndarray, "..."]:
    """Return `value` as a bool array of `shape` (None: any length), or raise RecordingError.

    Numbers are refused: a list of indices passed for a mask would otherwise be read as one.
    """
    array = _array(value, what)
    if array.dtype.kind != "b":
        raise RecordingError(
            f"{what} has dtype {array.dtype}; it is a mask, one True or False per degree of freedom"
        )
    _check_shape(array, shape, what)
    return np.array(array, dtype=np.bool_, order="C")


def require_finite(array: Float[np.ndarray, "..."], what: str) -> None:
    """Raise RecordingError naming the first entry of `array` that is NaN or infinite."""
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = tuple(int(i) for i in bad[0])
        raise RecordingError(
            f"{what} holds {len(bad)} values that are NaN or infinite, the first at {where}; "
            "repair or leave out what was not measured"
        )


def _array(value: Any, what: str) -> np.ndarray:
    try:
        return np.asarray(value)
    except ValueError as error:
        raise RecordingError(f"{what} is not an array of numbers: {error}") from error


def _check_shape(array: np.ndarray, shape: tuple[int | None, ...], what: str) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        raise RecordingError(f"{what} has shape {array.shape}; ({wanted}) is needed")
