"""From runs to the file."""

import logging
from collections.abc import Sequence
from pathlib import Path

from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.report.belief import ProgressCallback, judge
from tactorch.report.document import Told, document
from tactorch.report.finding import finding
from tactorch.report.runs import Run

#: How the modulus may be coloured; "ultrasound" is grey, linear from black to white.
COLOURS = ("viridis", "cividis", "ultrasound")
_LARGE = 10_000_000  # bytes

_log = logging.getLogger("tactorch")


def write_report(
    runs: Sequence[Run],
    out: str | Path,
    *,
    uncertainty: bool = True,
    colours: str = "viridis",
    tell: ProgressCallback | None = None,
) -> Path:
    """Write one HTML file that needs nothing else: no server, no network.

    Args:
        runs: One inversion, or several to compare; see `load_run`.
        out: The file.
        uncertainty: Whether to solve the presses again for credibility and posterior.
        colours: One of `COLOURS`; the page can switch.
        tell: Called before each step of what takes long.

    Raises:
        ConfigError: no run, or unknown colours.
        FileError: the file cannot be written.
    """
    if not runs:
        raise ConfigError("write_report: no run given; pass at least one.")
    if colours not in COLOURS:
        raise ConfigError(f"colours={colours} is unknown; choose one of {', '.join(COLOURS)}.")
    told = []
    for run in runs:
        judged = judge(run, uncertainty=uncertainty, tell=tell)
        told.append(Told(run, judged, finding(run, judged)))
    page = document(told, colours)
    with atomic_path(out) as temporary:
        temporary.write_text(page, encoding="utf-8")
    if len(page) > _LARGE:
        _log.warning("the report has %.0f MB: its meshes are large", len(page) / 1e6)
    return Path(out)
