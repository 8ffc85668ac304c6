"""Settings of a prior beside its name, its weight and its edge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.plain import plain

_PARTS = {"total_variation": 1.0, "sparsity": 1.0}


@dataclass(frozen=True, eq=False)
class PriorOptions:
    """What only some priors need; the others pass it over.

    Attributes:
        level_mpa: Reference of Tikhonov, background of sparsity, mean of Matern, MPa; None
            estimates it from the map.
        levels_mpa: The two moduli of the binary well, MPa; None estimates them from the map.
        length_mm: Correlation length of Matern, mm.
        deviation: Standard deviation of the log-modulus of Matern.
        parts: Shares of the priors that a composite is made of, by name.
        mean_mpa: A map (m,) that the prior, whichever, is about; None for none. Levels are then of
            the distance from it: see `ShiftedPrior`.
        mean_deviation: Standard deviation (m,) of log-moduli about that map; None for 1.
        mean_share: Share of the prior that is about that map, above 0 to 1; the rest is about
            nothing. With total variation, halves leave it open, free of cost, how much of the
            map's jumps there is between none and all, and the presses decide.
    """

    level_mpa: float | None = None
    levels_mpa: Sequence[float] | None = None
    length_mm: float = 3.0
    deviation: float = 0.5
    parts: Mapping[str, float] = field(default_factory=lambda: dict(_PARTS))
    mean_mpa: Float[np.ndarray, " _"] | None = None
    mean_deviation: Float[np.ndarray, " _"] | None = None
    mean_share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a composite within a composite."""
        for name in ("mean_mpa", "mean_deviation"):
            if getattr(self, name) is not None:
                values = np.array(getattr(self, name), dtype=np.float64)
                object.__setattr__(self, name, values)
        if not 0 < self.mean_share <= 1:
            raise ConfigError(f"mean_share={self.mean_share} must be above 0, up to 1.")
        if "composite" in self.parts:
            raise ConfigError("regularization.parts: a composite cannot hold a composite.")

    def __eq__(self, other: object) -> bool:
        """Compare all fields, maps by their bytes."""
        return isinstance(other, PriorOptions) and plain(self) == plain(other)

    __hash__ = None  # type: ignore[assignment]
