"""One HTML file from the folder of an inversion: what was found, where, how sure."""

from tactorch.report.runs import Run, load_run, names_of
from tactorch.report.write import COLOURS, write_report

__all__ = ["COLOURS", "Run", "load_run", "names_of", "write_report"]
