"""Values that are given without KEY=, as in `tactorch report runs/a runs/b`."""

from collections.abc import Sequence
from typing import NamedTuple


class Place(NamedTuple):
    """Settings that the words without a key are values of: the first word, and a list of others."""

    first: str
    others: str = ""


POSITIONAL = {
    "find": Place("run"),
    "report": Place("run", "compare"),
    "reproduce": Place("exhibit"),
}


def named(verb: str, settings: Sequence[str]) -> list[str]:
    """Return the settings, with their keys put before the leading words that have none.

    Words beyond those that the command takes stay as they are, and are refused later.
    """
    if verb not in POSITIONAL:
        return list(settings)
    place, count = POSITIONAL[verb], 0
    limit = len(settings) if place.others else 1
    while count < min(limit, len(settings)) and _is_bare(settings[count]):
        count += 1
    bare, rest = settings[:count], list(settings[count:])
    keyed = [f"{place.first}={_quoted(value)}" for value in bare[:1]]
    if len(bare) > 1:
        keyed.append(f"{place.others}=[{','.join(map(_quoted, bare[1:]))}]")
    return [*keyed, *rest]


def _is_bare(word: str) -> bool:
    return "=" not in word and word[:1] != "-"


def _quoted(path: str) -> str:
    """Return a path as Hydra takes any text."""
    escaped = path.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
