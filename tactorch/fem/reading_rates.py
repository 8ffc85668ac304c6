"""Derivatives of data that are not displacements of nodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.sparse as sp


@dataclass(frozen=True, eq=False)
class ReadingRates:
    """Derivatives of k data at an equilibrium.

    With the elastic forces f(u, e) of all nodes, d data / de is `by_displacement` du/de plus
    `by_forces` df/de.

    Attributes:
        by_displacement: Derivative by the displacements of all nodes, the total one where elastic
            forces enter.
        by_forces: Derivative by the elastic forces of nodes whose displacement is prescribed.
    """

    by_displacement: sp.csr_matrix
    by_forces: sp.csr_matrix

    @staticmethod
    def stack(rates: "Sequence[ReadingRates]") -> "ReadingRates":
        """Return the derivatives of several data."""
        first, second = zip(*((r.by_displacement, r.by_forces) for r in rates), strict=True)
        return ReadingRates(sp.vstack(first, format="csr"), sp.vstack(second, format="csr"))

    @staticmethod
    def of_displacements(rows: sp.csr_matrix) -> "ReadingRates":
        """Return the derivatives of data that are linear in the displacements."""
        return ReadingRates(rows, sp.csr_matrix(rows.shape))
