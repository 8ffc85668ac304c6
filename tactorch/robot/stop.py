"""When a robot has pressed enough."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtri

from tactorch.config import Options, option

_SPAN = 2.0 * float(ndtri(0.95))  # width of a central 90 % interval, in standard deviations


@dataclass(frozen=True)
class StopRule(Options):
    """End of the presses by a robot.

    The run ends when each lump that is probable enough has a narrow position, or when there is none
    after a number of presses.
    """

    section: ClassVar[str] = "stop"

    width_mm: float = option(
        1.0, "Width of the 90 % interval of the position, along the axis where it is widest",
        unit="mm", gt=0,
    )  # fmt: skip
    probability: float = option(0.95, "Least probability of a lump that counts", gt=0.5, lt=1)
    min_presses: int = option(3, "Least number of presses", ge=1)
    empty_presses: int = option(
        8, "Number of presses after which the run ends where no lump is probable", ge=1
    )

    def decide(self, entry: Mapping[str, Any]) -> str:
        """Return the reason to end after an entry of the history of a loop; empty to go on.

        Args:
            entry: Plain values of an update, see `tactorch.sampling.Update`.
        """
        count, finding = int(entry["press"]), entry["finding"]
        if count < self.min_presses or not entry.get("searched", False):
            return ""
        widths = [
            position_width_mm(lump)
            for lump in finding["lumps"]
            if lump.get("probability", 0.0) >= self.probability
        ]
        if widths and max(widths) <= self.width_mm:
            return (
                f"the position of {'the lump' if len(widths) == 1 else 'each lump'} is known: its "
                f"90 % interval is {max(widths):.2g} mm wide after {count} presses"
            )
        if not widths and count >= self.empty_presses:
            told = "nothing was found" if not finding["reasons"] else "the presses cannot tell"
            return (
                f"no lump has a probability of {self.probability:.0%} after {count} presses: {told}"
            )
        return ""


def position_width_mm(lump: Mapping[str, Any]) -> float:
    """Return the width of the 90 % interval of a lump's centre, mm, along its widest axis.

    Args:
        lump: Plain values of a lump, see `tactorch.inverse.Lump.plain`.
    """
    return _SPAN * float(np.max(lump["center_deviation_mm"]))
