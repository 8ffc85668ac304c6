"""Length, widths and direction of a long lump."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.fields import InclusionShape

_MIN_RATIO = 2.0  # of the longest semi-axis to the next one


@dataclass(frozen=True, eq=False)
class Elongation:
    """Length and widths of a lump that is much longer than wide.

    Attributes:
        length_mm: Length, mm.
        widths_mm: Smallest and largest width across it, mm.
        direction: Unit vector along it, (3,), whose largest component is positive.
    """

    length_mm: float
    widths_mm: tuple[float, float]
    direction: Float[np.ndarray, "3"]

    @staticmethod
    def of(shape: InclusionShape) -> "Elongation | None":
        """Return the elongation of a shape; None if it is not twice as long as wide."""
        longest, second, third = shape.semi_axes_mm
        if longest < _MIN_RATIO * second:
            return None
        direction = np.array(shape.axes[0])
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        return Elongation(2.0 * longest, (2.0 * third, 2.0 * second), direction)

    def text(self) -> str:
        """Return length, direction and widths in words."""
        along = ", ".join(f"{x + 0.0:.2f}" for x in np.round(self.direction, 2))
        widths = " x ".join(f"{width:.2g}" for width in self.widths_mm)
        return f"{self.length_mm:.2g} mm long along ({along}) and {widths} mm across"

    def plain(self) -> dict[str, object]:
        """Return plain values: mm, and the direction."""
        return {
            "length_mm": self.length_mm,
            "widths_mm": list(self.widths_mm),
            "direction": self.direction.tolist(),
        }
