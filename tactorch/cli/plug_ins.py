"""Checks of the components of other packages, in another process.

Importing one runs its code, which may print, end the process, or not end.
"""

import faulthandler
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from tactorch.config.registry import GROUPS, REGISTRIES, entry_points, origin

_LIMIT_S = 5.0  # of an import
_START_S = 60.0  # of tactorch itself
_RESULT = "tactorch plug-in: "
_TIMEOUT = "Timeout ("  # as faulthandler begins


def installed() -> dict[str, list[Any]]:
    """Return the entry points for tactorch by distribution and import path."""
    found: dict[str, list[Any]] = {}
    for entry in entry_points():
        found.setdefault(origin(entry), []).append(entry)
    return found


def check(plugins: Mapping[str, list[Any]]) -> dict[str, str]:
    """Return why components of `installed` cannot be used; "" for those that can.

    One that ends its process, or does not end, is followed by another process for the rest.
    """
    names = {
        key: [f"{entry.group.removeprefix(GROUPS)}={entry.name}" for entry in entries]
        for key, entries in plugins.items()
    }
    found: dict[str, str] = {}
    while left := {key: choices for key, choices in names.items() if key not in found}:
        found |= _run(left)
    return found


def _run(names: Mapping[str, list[str]]) -> dict[str, str]:
    """Check components in one process; return at least the finding of the first."""
    path = os.pathsep.join(filter(None, sys.path))
    limit_s = _START_S + _LIMIT_S * len(names)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", __name__, json.dumps(names)],
            env={**os.environ, "PYTHONPATH": path}, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, errors="replace", timeout=limit_s,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return dict.fromkeys(names, f"the imports do not end within {limit_s:.0f} s")
    found: dict[str, str] = {}
    for line in done.stdout.splitlines():
        if line.startswith(_RESULT):
            found |= json.loads(line.removeprefix(_RESULT))
    culprit = next((key for key in names if key not in found), None)
    if culprit is not None:
        found[culprit] = (
            f"its import does not end within {_LIMIT_S:.0f} s"
            if _TIMEOUT in done.stderr
            else f"its import ends the process with status {done.returncode}"
        )
    return found


def _error(choice: str) -> str:
    """Return why a component, KIND=NAME, cannot be used; "" where it can."""
    from tactorch.cli.schema import describe_plugin

    section, _, name = choice.partition("=")
    if section not in REGISTRIES:
        return f"tactorch has no components of the kind '{section}' (entry point group)"
    registry = REGISTRIES[section]
    if name in registry.builtin():
        return f"{choice} is the name of a component of tactorch, so that it is ignored"
    return str(describe_plugin(registry, name).get("error", ""))


def _main(names: Mapping[str, list[str]]) -> None:
    from tactorch.cli import COMMANDS
    from tactorch.cli.schema import options_class

    for command in COMMANDS:  # imports the registries
        options_class(command)
    for key, choices in names.items():
        faulthandler.dump_traceback_later(_LIMIT_S, exit=True)
        error = next(filter(None, map(_error, choices)), "")
        faulthandler.cancel_dump_traceback_later()
        print(f"\n{_RESULT}{json.dumps({key: error})}", flush=True)


if __name__ == "__main__":
    _main(json.loads(sys.argv[1]))
