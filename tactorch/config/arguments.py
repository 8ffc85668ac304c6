"""Settings from the arguments of a function or class, where these are declared already."""

import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, make_dataclass
from typing import Any, ClassVar, get_type_hints

from tactorch.config.options import Options, option, settings_of


class ArgumentOptions(Options):
    """Settings that are arguments of a function; calling them calls it."""

    function: ClassVar[Callable[..., Any]]

    def __call__(self, **others: Any) -> Any:
        """Call the function with the settings and further arguments."""
        values = {setting.name: getattr(self, setting.name) for setting in settings_of(type(self))}
        return type(self).function(**others, **values)


def options_from_arguments(
    function: Callable[..., Any], section: str, *, without: tuple[str, ...] = ()
) -> type[ArgumentOptions]:
    """Return settings whose names, types, defaults and help are those of a function's arguments.

    Args:
        function: Function or class, with annotations, and with `Args` in its docstring.
        section: Section of the settings.
        without: Arguments that are no settings.

    Returns:
        A class of settings; its objects call the function.
    """
    hints = get_type_hints(function.__init__ if inspect.isclass(function) else function)
    documentation = inspect.getdoc(function) or ""
    help_texts, fields = _argument_help(documentation), []
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in without:
            empty = parameter.default is inspect.Parameter.empty
            default = MISSING if empty else parameter.default
            fields.append((name, hints[name], option(default, help_texts.get(name, ""))))
    namespace = {
        "section": section,
        "function": staticmethod(function),
        "__doc__": documentation.partition("\n")[0],
    }
    name, bases = f"{function.__name__}Options", (ArgumentOptions,)
    return make_dataclass(name, fields, bases=bases, frozen=True, kw_only=True, namespace=namespace)


def _argument_help(text: str) -> dict[str, str]:
    """Return the descriptions in the `Args` section of a docstring."""
    section = re.search(r"^Args:\n((?:[ \t].*\n?|\n)+)", text, flags=re.MULTILINE)
    entries = section[1] if section else ""
    pairs = re.findall(r"^ {4}(\w+): ((?:.|\n {8,})+)", entries, re.MULTILINE)
    return {name: " ".join(words.split()).rstrip(".") for name, words in pairs}
