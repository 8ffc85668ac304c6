"""What holds a body: exact displacements and zero-length springs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.fem.elements import Discretisation


@dataclass(frozen=True, eq=False)
class Supports:
    """Held degrees of freedom of one load case, or of several stacked along the first axis.

    Attributes:
        fixed: Degrees of freedom with an exact displacement.
        prescribed: That displacement, mm; zero where not given.
        springs: Stiffness k of zero-length springs to the rest position, N/mm: the energy is
            k u^2 / 2 per degree of freedom (eq. 3 with k_c = 1000 N/m read as the stiffness).
    """

    fixed: Bool[np.ndarray, "*cases n 3"] | None = None
    prescribed: Float[np.ndarray, "*cases n 3"] | None = None
    springs: Float[np.ndarray, "*cases n 3"] | None = None

    def require_cases(self, count: int) -> None:
        """Refuse supports for another number of load cases.

        Raises:
            ConfigError: names the field.
        """
        for name in ("fixed", "prescribed", "springs"):
            values = getattr(self, name)
            if values is not None and values.ndim == 3 and len(values) != count:
                raise ConfigError(
                    f"supports.{name} is for {len(values)} load cases but forces are for {count}; "
                    "give one each, or (n, 3) for all."
                )

    def case(self, index: int, discretisation: Discretisation) -> "HeldCase":
        """Return one load case over all nodes, midsides included.

        Raises:
            ConfigError: a shape does not fit the mesh.
        """
        n = discretisation.mesh.n_points
        zeros = np.zeros((n, 3))
        fixed = _pick(self.fixed, index, n, "fixed", zeros.astype(bool)).astype(bool)
        prescribed = _pick(self.prescribed, index, n, "prescribed", zeros)
        springs = _pick(self.springs, index, n, "springs", zeros)
        if np.any(springs < 0) or not np.all(np.isfinite(springs)):
            raise ConfigError("supports.springs must be finite and not negative (N/mm).")
        if not np.all(np.isfinite(prescribed[fixed])):
            raise ConfigError(
                "supports.prescribed is not finite at a fixed degree of freedom (mm)."
            )
        midsides = fixed[discretisation.edges].all(axis=1)
        return HeldCase(
            np.concatenate([fixed, midsides]),
            discretisation.extend(np.where(fixed, prescribed, 0.0)),
            discretisation.consistent_loads(springs),
        )


@dataclass(frozen=True, eq=False)
class HeldCase:
    """One load case's held degrees of freedom over all nodes of a discretisation."""

    fixed: Bool[np.ndarray, "nodes 3"]
    prescribed: Float[np.ndarray, "nodes 3"]
    springs: Float[np.ndarray, "nodes 3"]

    def __post_init__(self) -> None:
        """Midside nodes are held only where both ends are: drop the rest's averages."""
        object.__setattr__(self, "prescribed", np.where(self.fixed, self.prescribed, 0.0))

    @property
    def held(self) -> Bool[np.ndarray, "nodes 3"]:
        """Degrees of freedom that are fixed or on springs."""
        return self.fixed | (self.springs > 0)


def _pick(
    values: np.ndarray | None, index: int, n: int, name: str, default: np.ndarray
) -> np.ndarray:
    if values is None:
        return default
    if values.ndim not in (2, 3) or values.shape[-2:] != (n, 3):
        raise ConfigError(
            f"supports.{name} has shape {values.shape}; expected ({n}, 3), one row per mesh node, "
            f"or (cases, {n}, 3)."
        )
    return values if values.ndim == 2 else values[index]
