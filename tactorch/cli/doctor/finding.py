"""What is found out about a machine, one thing at a time."""

from collections.abc import Callable
from dataclasses import dataclass

from tactorch.errors import TactorchError


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        part: What it belongs to, such as "packages".
        name: Of the thing.
        works: Whether it does; None where there is nothing to judge, only to tell.
        told: Its version, place or size; or what is wrong with it.
        feature: What does not work without it.
        remedy: The command, or what else to do, where it does not work.
        core: Whether nothing works without it.
    """

    part: str
    name: str
    works: bool | None
    message: str
    feature: str = ""
    remedy: str = ""
    core: bool = False


def looked_at(
    part: str,
    name: str,
    look: Callable[[], str],
    feature: str = "",
    remedy: str = "",
    core: bool = False,
) -> Finding:
    """Look at a thing; whatever is raised becomes what is wrong with it."""
    try:
        message = look()
    except Exception as error:  # a broken package may raise anything
        return Finding(part, name, False, reason_of(error), feature, remedy, core)
    return Finding(part, name, True, message, feature, "", core)


def reason_of(error: BaseException) -> str:
    """Return an error as one line."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    return text if isinstance(error, TactorchError) else f"{kind}: {text}" if text else kind
