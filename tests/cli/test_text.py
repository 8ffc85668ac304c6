"""Text from files does not control the terminal."""

import json
import logging
import shutil
from pathlib import Path
from typing import Any

from tactorch.cli.console import Table
from tactorch.text import PrintableFormatter

RED = "\x1b[31mred\x1b[0m"


def test_errors_have_no_control_characters(tactorch: Any, tmp_path: Path) -> None:
    outcome = tactorch("invert", f"recording={tmp_path}/{RED}.h5")
    assert outcome.status
    assert "\x1b" not in outcome.err
    assert r"\x1b[31mred" in outcome.err


def test_log_messages_have_no_control_characters(
    tactorch: Any, finished_run: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(finished_run, tmp_path / "run"))
    summary = json.loads((run / "summary.json").read_text())
    summary["recording"] = f"{RED}.h5"
    (run / "summary.json").write_text(json.dumps(summary))
    outcome = tactorch("report", f"run={run}", "uncertainty=false", "out=report.html")
    printed = outcome.out + outcome.err
    assert r"\x1b[31mred" in printed
    assert "\x1b[31m" not in printed


def test_tables_have_no_control_characters() -> None:
    assert "\x1b" not in Table(["name"], [[RED]]).text()


def test_formatter_keeps_lines() -> None:
    record = logging.LogRecord("x", logging.INFO, "", 0, "%s", (f"a\n{RED}",), None)
    assert PrintableFormatter("%(message)s").format(record) == "a\n\\x1b[31mred\\x1b[0m"
