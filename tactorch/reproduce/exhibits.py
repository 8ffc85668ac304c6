"""Studies and their exhibits: CSV, Markdown and figures in one folder."""

import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import ModuleType
from typing import Any

from tactorch.errors import ConfigError, TactorchError
from tactorch.files import write_file
from tactorch.reproduce import credibility, depths, design, models, recognition, sampling, sizes
from tactorch.reproduce.cases import ProgressCallback, run_cases

_log = logging.getLogger(__name__)
_ALL = "all"
#: Modules with `cases`, `run_case` and `EXHIBITS` (functions that make an exhibit), by name.
STUDIES: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (credibility, models, design, sizes, depths, recognition, sampling)
}
TITLES = {
    "table1": "Table I: time and similarity of ten models",
    "table2": "Table II: design factors and noise",
    "fig3": "Fig. 3: credibility by depth, pressure and stiffness",
    "fig4": "Fig. 4: objects of two materials",
    "fig5": "Fig. 5: heterogeneous objects",
    "fig7": "Fig. 7: maps by design factor",
    "fig8": "Fig. 8: similarity by depth",
    "fig9": "Fig. 9: wrong sizes of the object",
    "fig10": "Fig. 10: depth of a hard ball",
    "fig11": "Fig. 11: recognition of inclusions",
    "fig12": "Fig. 12: where to press next",
}
#: Study of each exhibit, in the order of the paper.
EXHIBITS: dict[str, str] = {
    exhibit: next(name for name, study in STUDIES.items() if exhibit in study.EXHIBITS)
    for exhibit in TITLES
}


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
    if name != _ALL and name not in EXHIBITS:
        raise ConfigError(f"exhibit={name}: choose one of {', '.join(EXHIBITS)}, or {_ALL}.")
    names = list(EXHIBITS) if name == _ALL else [name]
    written, failures = [], []
    for study in dict.fromkeys(EXHIBITS[exhibit] for exhibit in names):
        module, options = STUDIES[study], sizes[study]
        with progress(study) as update:
            results, failed = run_cases(
                study, module.cases(options), out / "cases", workers, update
            )
        for case, reason in failed.items():
            _log.warning("%s, %s failed: %s", study, case, reason)
            failures.append(f"{study} {case} ({reason})")
        missing = f"\n\nMissing because they failed: {', '.join(failed)}." if failed else ""
        for exhibit in (key for key in names if EXHIBITS[key] == study and results):
            try:
                text = module.EXHIBITS[exhibit](results, options).write(out, exhibit)
            except Exception as error:  # an exhibit may need a case that failed
                if not failed:
                    raise
                _log.warning("%s is omitted because cases failed: %r", exhibit, error)
                continue
            method = (module.__doc__ or "").strip()
            content = f"# {TITLES[exhibit]}\n\n{text}{missing}\n\n## Method\n\n{method}\n"
            written.append(out / f"{exhibit}.md")
            write_file(written[-1], content)
    available = [name for name in EXHIBITS if (out / f"{name}.md").is_file()]
    links = "\n".join(f"- [{TITLES[name]}]({name}.md)" for name in available)
    write_file(out / "README.md", f"# Tables and figures of the paper, reproduced\n\n{links}\n")
    if failures:
        raise TactorchError(
            f"{len(failures)} cases failed: {'; '.join(failures[:3])}. All others are stored;"
            " repeat the command to try these again."
        )
    return written
