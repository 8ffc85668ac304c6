"""How well a description predicts the presses of a contact from those of all others.

The model is linearised at its fit, where data and parameters are jointly normal, so that the
prediction of held-out data follows from one fit of all (S. Sundararajan and S. S. Keerthi,
"Predictive approaches for choosing hyperparameters in Gaussian processes", Neural Computation 13
(2001), 1103-1118). With the precision Q = W^T (1 - J C J^T) W of all data, W the whitening of their
errors, C the posterior covariance of the parameters, J their derivatives of the whitened residuals
r, the data of a contact g are predicted with the precision Q_gg, and missed by Q_gg^-1 (W^T r)_g.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from tactorch.inverse.data.observations import DataModel

_MAX_DATA = 6_000  # whose dense precision is formed


def held_out_score(
    data: DataModel,
    contacts: Sequence[Sequence[int]],
    residuals: Float[np.ndarray, " data"],
    jacobian: Float[np.ndarray, "data size"],
    covariance: Float[np.ndarray, "size size"],
) -> float | None:
    """Return the mean log-density of a datum (1/mm or 1/N) given the data of all other contacts.

    The presses of each contact are held out together. Residuals at the fit and their derivatives
    are whitened, and the covariance is that of the posterior. The score is larger where the
    prediction is better; there is none for more than 6,000 data, nor for a single contact.
    """
    count = len(residuals)
    if count > _MAX_DATA or len(contacts) < 2:
        return None
    columns, weighted = data.transposed(jacobian), data.transposed(residuals)
    ends, total = np.cumsum([0, *data.counts]), 0.0
    for contact in contacts:
        rows = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in contact])
        units = np.zeros((count, len(rows)))
        units[rows, np.arange(len(rows))] = 1.0
        precision = data.transposed(data.whiten(units))[rows]
        precision -= columns[rows] @ covariance @ columns[rows].T
        factor = cho_factor(precision, lower=True)
        error = weighted[rows]
        total += float(np.log(factor[0].diagonal()).sum() - 0.5 * error @ cho_solve(factor, error))
    return (total + float(np.log(data.scale).sum())) / count
