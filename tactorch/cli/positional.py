"""Runs that are named without KEY=, as in `tactorch report runs/a runs/b`."""

from collections.abc import Sequence


def with_runs(settings: Sequence[str]) -> list[str]:
    """Return settings in which bare paths in front have become `run=` and `compare=`."""
    count = 0
    while count < len(settings) and "=" not in settings[count] and settings[count][:1] != "-":
        count += 1
    bare, rest = settings[:count], list(settings[count:])
    named = [f"run={quoted(path)}" for path in bare[:1]]
    if len(bare) > 1:
        named.append(f"compare=[{','.join(map(quoted, bare[1:]))}]")
    return [*named, *rest]


def quoted(path: str) -> str:
    """Return a path as Hydra takes any text."""
    escaped = path.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
