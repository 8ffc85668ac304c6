"""Numbers in the text of mesh files."""

import warnings

import numpy as np
from jaxtyping import Float


def parse_numbers(text: bytes) -> Float[np.ndarray, " n"]:
    """Return numbers that are separated by white space.

    Raises:
        DeprecationWarning, ValueError: The text has something else.
    """
    with warnings.catch_warnings(action="error"):
        return np.asarray(np.fromstring(text.decode("ascii"), sep=" "))
