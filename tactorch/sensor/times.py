"""Times of the frames in a folder of images: the table `times.csv`.

Its columns are `frame`, the name of the file, and `time_s`, the time since the first frame.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tactorch.errors import FileError
from tactorch.sensor.table import read_rows

#: Name of the table.
TIMES = "times.csv"


def read_times(folder: Path, files: Sequence[Path]) -> dict[str, float]:
    """Return the times (s) of the images of a folder by file name; none without a table `TIMES`.

    Raises:
        FileError: The table lacks an image, or its times do not rise.
    """
    path = folder / TIMES
    if not path.exists():
        return {}
    rows = read_rows(path, "times of frames", ("frame", "time_s"))
    times = {row.text("frame"): row.number("time_s") for row in rows}
    missing = [file.name for file in files if file.name not in times]
    if missing:
        raise FileError(
            f"'{path}' has no time of {missing[0]}, and of {len(missing)} images in all; add them,"
            " or remove the file."
        )
    in_order = np.array([times[file.name] for file in files])
    if not (np.isfinite(in_order).all() and (np.diff(in_order) > 0).all()):
        raise FileError(f"'{path}': time_s must rise with the names of the images; repair it.")
    return times
