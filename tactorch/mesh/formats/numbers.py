"""Numbers in the text of mesh files."""

import warnings

import numpy as np
from jaxtyping import Float, Int, Num


def parse_numbers(text: bytes) -> Float[np.ndarray, " n"]:
    """Return numbers that are separated by white space.

    Raises:
        DeprecationWarning, ValueError: The text has something else.
    """
    with warnings.catch_warnings(action="error"):
        return np.asarray(np.fromstring(text.decode("ascii"), sep=" "))


def places(
    known: Num[np.ndarray, " n"], numbers: Num[np.ndarray, "*k"], what: str
) -> Int[np.ndarray, "*k"]:
    """Return the place of each number among the ascending ones that are known.

    Raises:
        ValueError: There is no such number; `what` names it.
    """
    found = np.searchsorted(known, numbers).clip(max=max(len(known) - 1, 0))
    absent = numbers if not len(known) else numbers[known[found] != numbers]
    if absent.size:
        raise ValueError(f"there is no {what} {absent.flat[0]:.0f}")
    return found
