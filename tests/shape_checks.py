"""Type checker of the tests, `--jaxtyping-packages` of pyproject.toml: beartype, of some calls.

An inversion calls small functions by the hundred thousand, and checks of shapes would take two
thirds of the tests' time. Each test checks the first calls of each function; after some thousand
calls, jaxtyping's own switch disables checks until the next test.
"""

import functools
import os
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

#: Limit of calls per test after which none is checked; 0 checks all calls.
MAX_CHECKS = int(os.environ.get("TACTORCH_MAX_CHECKS") or 1000)
#: Limit of checks per test and function: of its arguments, and of these with its result.
MAX_EACH = 20

# An int is accepted for a float, as static type checkers do.
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_count = _test = 0


def restart() -> None:
    """Enable checks, at the beginning of a test."""
    global _count, _test
    _count, _test = 0, _test + 1
    jaxtyping.config.update("jaxtyping_disable", False)


def checker(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that checks its arguments, unless they are those of settings.

    Settings check and convert their values themselves.
    """
    is_init = function.__qualname__.endswith("__init__")
    checked: Callable[..., Any] | None = None  # made at the first call: most are never called
    of_test = own = 0

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        global _count
        nonlocal checked, of_test, own
        _count, own = _count + 1, own + 1 if of_test == _test else 1
        of_test = _test
        if _count == MAX_CHECKS:
            jaxtyping.config.update("jaxtyping_disable", True)
        if MAX_CHECKS > 0 and own > MAX_EACH:
            return None
        if is_init and args and _is_settings(type(args[0])):
            return None
        checked = checked or _check(function)
        return checked(*args, **kwargs)

    return call


def _is_settings(cls: type) -> bool:
    return any(base.__module__ == "tactorch.config.options" for base in cls.__mro__)
