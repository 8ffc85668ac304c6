"""Type checker of the tests, `--jaxtyping-packages` of pyproject.toml: beartype, of some calls.

An inversion calls small functions by the hundred thousand, and checks of shapes would take two
thirds of the tests' time. Each test checks its first calls; after those, jaxtyping's own switch
disables checks until the next test.
"""

import functools
import os
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

#: Limit of checks per test; 0 checks all calls.
MAX_CHECKS = int(os.environ.get("TACTORCH_MAX_CHECKS") or 5000)

# An int is accepted for a float, as static type checkers do.
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_count = 0


def restart() -> None:
    """Enable checks, at the beginning of a test."""
    global _count
    _count = 0
    jaxtyping.config.update("jaxtyping_disable", False)


def checker(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that checks its arguments, unless they are those of settings.

    Settings check and convert their values themselves.
    """
    checked = _check(function)
    is_init = function.__qualname__.endswith("__init__")

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        global _count
        _count += 1
        if _count == MAX_CHECKS:
            jaxtyping.config.update("jaxtyping_disable", True)
        if is_init and args and _is_settings(type(args[0])):
            return None
        return checked(*args, **kwargs)

    return call


def _is_settings(cls: type) -> bool:
    return any(base.__module__ == "tactorch.config.options" for base in cls.__mro__)
