"""What is found out about a machine, one thing at a time."""

from collections.abc import Callable
from dataclasses import dataclass

from tactorch.errors import TactorchError


@dataclass(frozen=True)
class Finding:
    """Result of one check of the installation.

    Attributes:
        part: Group of the check, such as "packages".
        name: Name of the checked item.
        works: Whether the item works; None for information only.
        message: Version, path or size of the item, or the reason of the failure.
        feature: Feature that needs the item.
        remedy: Command or action if the item does not work.
        core: Whether tactorch needs the item for everything.
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
