"""A frame as its source gives it."""

from dataclasses import dataclass

from tactorch.sensor.image import Image


@dataclass(frozen=True, eq=False)
class RawFrame:
    """What a source gives.

    Attributes:
        name: Of the file, or of the place in the source; for messages.
        image: RGB; None where it could not be read.
        time_s: Since the first frame; None where unknown.
        fault: Why it could not be read, or "".
        unix_s: When a camera gave it, seconds since 1970; None where unknown.
    """

    name: str
    image: Image | None
    time_s: float | None = None
    fault: str = ""
    unix_s: float | None = None
