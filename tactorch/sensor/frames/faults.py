"""What may be wrong with a frame: dark, saturated, torn, frozen. Told, and left to the user."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.sensor.image import Image


@dataclass(frozen=True)
class FaultLimits:
    """From where on a frame is said to be faulty, against the reference.

    Attributes:
        dark: Share of the reference's mean brightness below which a frame is dark.
        saturated: Share of pixels that saturate over and above the reference's.
        torn: Jump between two rows, in typical jumps between rows of this frame, from which a
            frame is torn: its upper part is of another moment than its lower one.
    """

    dark: float = 0.4
    saturated: float = 0.05
    torn: float = 8.0


_SATURATED = "saturated"
_FULL = 254  # of 255: a channel that saturates
_LEAST_JUMP = 4.0  # grey values; smaller ones are noise


def fault_of(
    image: Image, reference: Image, before: Image | None, limits: FaultLimits | None = None
) -> str:
    """Return what is wrong with a frame, or "".

    Args:
        image: The frame.
        reference: The same gel without contact.
        before: The frame before it, if any.
        limits: From where on.
    """
    limits = limits or FaultLimits()
    brightness, usual = float(image.mean()), max(float(reference.mean()), 1e-9)
    if brightness < limits.dark * usual:
        return f"dark: {brightness / usual:.0%} of the reference's brightness"
    extra = _saturated(image) - _saturated(reference)
    if extra > limits.saturated:
        return f"{_SATURATED}: {extra:.0%} of the pixels more than in the reference"
    if before is not None and np.array_equal(image, before):
        return "frozen: the same as the frame before it"
    row = _torn(image, reference, limits.torn)
    return f"torn at row {row}" if row else ""


def is_sound(fault: str) -> bool:
    """Tell whether a frame can be measured on, for all its fault.

    A bright contact saturates some pixels of sound frames: those are worth less, not nothing.
    """
    return not fault or fault.startswith(_SATURATED)


def _saturated(image: Image) -> float:
    return float((image >= _FULL).any(axis=2).mean())


def _torn(image: Image, reference: Image, limit: float) -> int:
    """Return the row below a tear, or 0.

    What changed against the reference changes smoothly from row to row; a tear makes it jump over
    much of the width at one row.
    """
    change = image.astype(np.float32).mean(axis=2) - reference.astype(np.float32).mean(axis=2)
    jump: Float[np.ndarray, " rows"] = np.median(np.abs(np.diff(change, axis=0)), axis=1)
    row = int(np.argmax(jump))
    usual = max(float(np.median(jump)), _LEAST_JUMP / limit)
    return row + 1 if jump[row] > limit * usual else 0
