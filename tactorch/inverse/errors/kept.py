"""Errors at the rims of contacts that searches on further presses of an object reuse."""

from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.recording import Press, Recording
from tactorch.recording.append import digest

Key: TypeAlias = tuple[str, ...]


class RimError(NamedTuple):
    """Predictions of a mesh that is finer at a rim, less those of the common mesh."""

    log_youngs: Float[np.ndarray, " nodes"]  # log MPa at the loaded nodes, of the model then
    changes: tuple[Float[np.ndarray, " _"], ...]  # of the data of some presses of the contact, mm


@dataclass(frozen=True, eq=False)
class KeptRims:
    """What a search computes once for each contact with a rim.

    It serves one object, with one material, element type and supports.

    Attributes:
        errors: Errors of the discretisation, by presses.
        responses: Changes of the data (mm) of each press of a contact by errors of the traction at
            each edge of the rim, by presses. They are those of the first model that had these
            presses: their amplitude is one of a few levels anyway.
    """

    errors: dict[Key, RimError] = field(default_factory=dict)
    responses: dict[Key, list[Float[np.ndarray, "_ edges"]]] = field(default_factory=dict)


def press_key(recording: Recording, presses: list[Press]) -> Key:
    """Return what identifies presses on a mesh."""
    return recording.mesh.content_hash(), *(digest(press) for press in presses)
