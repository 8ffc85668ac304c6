"""Self-contained HTML report of one inversion, or of several side by side."""

from tactorch.report.runs import Run, load_run, run_names, runs_in
from tactorch.report.write import report_of, write_report

__all__ = ["Run", "load_run", "report_of", "run_names", "runs_in", "write_report"]
