"""Self-contained HTML report of one inversion, or of several side by side."""

from tactorch.report.runs import Run, is_complete, load_run, run_names, settings_from
from tactorch.report.write import COLOURS, write_report

__all__ = [
    "COLOURS",
    "Run",
    "is_complete",
    "load_run",
    "run_names",
    "settings_from",
    "write_report",
]
