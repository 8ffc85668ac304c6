"""Exhibits from cases: CSV, Markdown and figures in one folder."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from tactorch.errors import ConfigError, TactorchError
from tactorch.files import atomic_path
from tactorch.reproduce.cases import ProgressCallback, run_cases
from tactorch.reproduce.studies import EXHIBITS, STUDIES, TITLES

_log = logging.getLogger(__name__)
ALL = "all"
INDEX = "README.md"
_CASES = "cases"


def reproduce(
    name: str,
    sizes: Mapping[str, Mapping[str, Any]],
    out: Path,
    *,
    workers: int | None,
    progress: Callable[[str], AbstractContextManager[ProgressCallback]],
) -> list[Path]:
    """Write one exhibit or all; stored cases are not computed again.

    Args:
        name: One of `EXHIBITS`, or "all".
        sizes: Options of each study by its name.
        out: Folder of the files.
        workers: Number of processes; the number of cores if None.
        progress: Context manager that takes the name of a study and provides the callback of
            its progress.

    Returns:
        The Markdown file of each exhibit.

    Raises:
        ConfigError: The name is unknown.
        TactorchError: Cases failed; the exhibits contain the others.
    """
    if name != ALL and name not in EXHIBITS:
        raise ConfigError(f"exhibit={name}: choose one of {', '.join(EXHIBITS)}, or {ALL}.")
    names = list(EXHIBITS) if name == ALL else [name]
    written, failures = [], []
    for study in dict.fromkeys(EXHIBITS[exhibit] for exhibit in names):
        module, options = STUDIES[study], sizes[study]
        with progress(study) as update:
            results, failed = run_cases(module.cases(options), out / _CASES, workers, update)
        for case, reason in failed.items():
            _log.warning("%s, %s failed: %s", study, case, reason)
        failures += [f"{study} {case} ({reason})" for case, reason in failed.items()]
        for exhibit in (one for one in names if EXHIBITS[one] == study and results):
            try:
                text = module.EXHIBITS[exhibit](results, options, out)
            except Exception as error:  # an exhibit may need a case that failed
                if not failed:
                    raise
                _log.warning("%s is omitted because cases failed: %r", exhibit, error)
                continue
            written.append(_write(out / f"{exhibit}.md", exhibit, text, list(failed)))
    _write_index(out)
    if failures:
        raise TactorchError(
            f"{len(failures)} cases failed: {'; '.join(failures[:3])}. All others are stored;"
            " repeat the command to try these again."
        )
    return written


def _write(path: Path, exhibit: str, text: str, failed: Sequence[str]) -> Path:
    missing = f"\n\nMissing because they failed: {', '.join(failed)}." if failed else ""
    method = (STUDIES[EXHIBITS[exhibit]].__doc__ or "").strip()
    content = f"# {TITLES[exhibit]}\n\n{text}{missing}\n\n## Method\n\n{method}\n"
    with atomic_path(path) as temporary:
        temporary.write_text(content, encoding="utf-8")
    return path


def _write_index(out: Path) -> None:
    """List the available exhibits."""
    available = [name for name in EXHIBITS if (out / f"{name}.md").is_file()]
    lines = [f"- [{TITLES[name]}]({name}.md)" for name in available]
    with atomic_path(out / INDEX) as temporary:
        temporary.write_text(
            "\n".join(["# Tables and figures of the paper, reproduced", "", *lines, ""])
        )
