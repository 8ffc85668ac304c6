"""Changes of the data by the errors that a search for shapes takes into account."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.data import DataModel
from tactorch.inverse.shapes.model import Errors


@dataclass(frozen=True, eq=False)
class ErrorPatterns:
    """Changes of the data by errors, in standard deviations of the white noise.

    Each column is the change by an error of unit deviation, see `Errors`. Patterns that were not
    computed are None, and the deviations of these errors have to be zero.

    Attributes:
        pose: Rigid motions of contacts, and motions of probes.
        forces: Errors of the forces of each press.
        rims: Errors of the traction at the rims of contacts.
        stated: Correlated errors that the presses state, with the deviations stated.
    """

    pose: Float[np.ndarray, "data pose"]
    forces: Float[np.ndarray, "data forces"] | None = None
    rims: Float[np.ndarray, "data rims"] | None = None
    stated: Float[np.ndarray, "data stated"] | None = None

    def added_to(self, data: DataModel, errors: Errors) -> DataModel:
        """Return the data with errors of these deviations."""
        if self.stated is not None:
            data = data.with_errors(self.stated)
        levels = (
            (errors.pose, self.pose),
            (errors.forces, self.forces),
            (errors.rims, self.rims),
        )
        for deviation, patterns in levels:
            if deviation:
                assert patterns is not None
                data = data.with_errors(deviation * patterns)
        return data
