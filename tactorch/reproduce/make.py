"""Exhibits from cases: CSV, Markdown and pictures in one folder."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from tactorch.errors import ConfigError, TactorchError
from tactorch.files import atomic_path
from tactorch.reproduce.cases import Told, make_cases
from tactorch.reproduce.studies import EXHIBITS, TITLES, about, cases_of, study_of, writer_of

_log = logging.getLogger(__name__)
ALL = "all"
INDEX = "README.md"
_CASES = "cases"


def make(
    name: str,
    sizes: Mapping[str, Mapping[str, Any]],
    out: Path,
    *,
    workers: int | None,
    progress: Callable[[str], AbstractContextManager[Told]],
) -> list[Path]:
    """Make an exhibit, or all; cases that are stored already are not made again.

    Args:
        name: Of `EXHIBITS`, or "all".
        sizes: Options of each study, by its name.
        out: Folder of the files.
        workers: Processes; as many as there are cores by default.
        progress: Given a study's name, a context whose value tells how far it is.

    Returns:
        The Markdown file of each exhibit.

    Raises:
        ConfigError: The name is unknown.
        TactorchError: Cases failed; the exhibits hold the others.
    """
    if name != ALL and name not in EXHIBITS:
        raise ConfigError(f"exhibit={name}: choose one of {', '.join(EXHIBITS)}, or {ALL}.")
    wanted = list(EXHIBITS) if name == ALL else [name]
    written, failed = [], []
    for study in dict.fromkeys(study_of(exhibit) for exhibit in wanted):
        options = sizes[study]
        with progress(study) as tell:
            found, bad = make_cases(cases_of(study, options), out / _CASES, workers, tell)
        for case, reason in bad.items():
            _log.warning("%s, %s failed: %s", study, case, reason)
        failed += [f"{study} {case} ({reason})" for case, reason in bad.items()]
        for exhibit in (one for one in wanted if study_of(one) == study):
            if not found:
                continue
            try:
                text = writer_of(exhibit)(found, options, out)
            except Exception as error:  # an exhibit may be nothing without a case that failed
                if not bad:
                    raise
                _log.warning("%s is not made without the cases that failed: %r", exhibit, error)
                continue
            written.append(_write(out / f"{exhibit}.md", exhibit, study, text, list(bad)))
    _write_index(out)
    if failed:
        raise TactorchError(
            f"{len(failed)} cases failed: {'; '.join(failed[:3])}. All others are kept; the same"
            " command tries these again."
        )
    return written


def _write(path: Path, exhibit: str, study: str, text: str, bad: Sequence[str]) -> Path:
    missing = f"\n\nMissing, because they failed: {', '.join(bad)}." if bad else ""
    content = f"# {TITLES[exhibit]}\n\n{text}{missing}\n\n## How\n\n{about(study)}\n"
    with atomic_path(path) as temporary:
        temporary.write_text(content, encoding="utf-8")
    return path


def _write_index(out: Path) -> None:
    """List the exhibits that there are."""
    there = [name for name in EXHIBITS if (out / f"{name}.md").is_file()]
    lines = [f"- [{TITLES[name]}]({name}.md)" for name in there]
    with atomic_path(out / INDEX) as temporary:
        temporary.write_text(
            "\n".join(["# The paper's tables and figures, made anew", "", *lines, ""])
        )
