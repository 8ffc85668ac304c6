"""Types of settings: conversion of values, and descriptions for messages."""

import math
import types
from collections.abc import Collection, Iterator, Mapping, Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

#: Result of `convert` for a value of another type.
INVALID = object()
_COUNTS = {2: "two", 3: "three", 4: "four"}
_LETTERS = "XYZW"


def convert(value: Any, annotation: Any) -> Any:
    """Return a value converted to the type of a setting, or `INVALID`.

    Whole numbers are accepted as numbers, lists as tuples, and text as a path; booleans are not
    numbers, and numbers are finite. Types that are neither plain nor a container of plain ones are
    checked by `isinstance`.
    """
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is Any:
        return value
    if annotation is None or annotation is types.NoneType:
        return None if value is None else INVALID
    if origin in (Union, types.UnionType):
        return _convert_union(value, arguments)
    if origin is Literal:
        return next((a for a in arguments if a == value and type(a) is type(value)), INVALID)
    if annotation in _PLAIN:
        return _PLAIN[annotation](value)
    if origin is Sequence:
        origin, arguments = tuple, (*arguments, Ellipsis)
    if origin in (tuple, list):
        return _convert_sequence(value, origin, arguments)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _convert_mapping(value, arguments)
    if origin is not None:  # a callable, an array type: nothing that can be looked up
        return value
    return value if isinstance(value, annotation) else INVALID


def _convert_union(value: Any, members: tuple[Any, ...]) -> Any:
    exact = [member for member in members if type(value) is member]
    converted = (convert(value, member) for member in (*exact, *members))
    return next((result for result in converted if result is not INVALID), INVALID)


def _convert_sequence(value: Any, origin: type, arguments: tuple[Any, ...]) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value  # of NumPy
    if isinstance(value, str | Mapping) or not isinstance(value, Sequence):
        return INVALID
    if origin is not tuple or arguments[-1] is Ellipsis:
        arguments = arguments[:1] * len(value)
    if len(value) != len(arguments):
        return INVALID
    items = [convert(v, a) for v, a in zip(value, arguments, strict=True)]
    return INVALID if any(item is INVALID for item in items) else origin(items)


def _convert_mapping(value: Any, arguments: tuple[Any, ...]) -> Any:
    if not isinstance(value, Mapping):
        return INVALID
    items = {convert(k, arguments[0]): convert(v, arguments[1]) for k, v in value.items()}
    return INVALID if any(INVALID in item for item in items.items()) else items


def _number(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, Real):
        return INVALID
    try:
        number = float(value)
    except OverflowError:  # an integer beyond the floats
        return INVALID
    return number if math.isfinite(number) else INVALID


def _path(value: Any) -> Any:
    # Numbers are valid names of files.
    if isinstance(value, bool) or not isinstance(value, str | int | float | Path) or value == "":
        return INVALID
    return value if isinstance(value, Path) else Path(str(value))


_PLAIN: dict[Any, Any] = {
    bool: lambda value: value if isinstance(value, bool) else INVALID,
    int: lambda v: INVALID if isinstance(v, bool) or not isinstance(v, Integral) else int(v),
    float: _number,
    str: lambda value: value if isinstance(value, str) else INVALID,
    Path: _path,
}
_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_NAMES |= {Path: "a path", types.NoneType: "null"}
_PLURALS = {int: "whole numbers", float: "numbers", str: "names", Path: "paths"}


def describe(annotation: Any) -> str:
    """Return a type in words, such as "a whole number" or "a list of three numbers: [X,Y,Z]"."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation in _NAMES:
        return _NAMES[annotation]
    if origin in (Union, types.UnionType):
        words = [describe(a) for a in arguments if a not in (bool, types.NoneType)]
        return _join(["true", "false", *words] if bool in arguments else words)
    if origin is Literal:
        return _join([str(a) for a in arguments])
    if origin is tuple and arguments[-1] is not Ellipsis:
        count = len(arguments)
        inner = get_args(arguments[0]) if get_origin(arguments[0]) is tuple else ()
        letters = ",".join(_LETTERS[: len(inner) or count])
        example = f"[[{letters}],...]" if inner else f"[{letters}]"
        return f"a list of {_COUNTS.get(count, count)} {_plural(arguments[0])}: {example}"
    if origin in (tuple, list, Sequence):
        is_nested = get_origin(arguments[0]) in (tuple, list, Sequence)
        example = "[[...],[...]]" if is_nested else "[A,B]"
        return f"a list of {_plural(arguments[0])}: {example}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"a table of {_plural(arguments[1])}: {{NAME: VALUE}}"
    return getattr(annotation, "__name__", str(annotation))


def choices_of(annotation: Any) -> tuple[Any, ...]:
    """Return the values a type lists: those of its literals, true and false; else nothing."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is bool:
        return (True, False)
    if origin is Literal:
        return arguments
    if origin in (Union, types.UnionType):
        return tuple(choice for member in arguments for choice in choices_of(member))
    return ()


def leaf_types(annotation: Any) -> set[Any]:
    """Return the types that a type is composed of, `dict` among them for tables."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {dict}
    if origin is Literal or not arguments:
        return {annotation}
    return set().union(*(leaf_types(argument) for argument in arguments))


def leaves(
    values: Mapping[Any, Any], tables: Collection[str] = (), prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the settings of a nested table by their full names; `tables` are single settings."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and name not in tables:
            yield from leaves(value, tables, f"{name}.")
        else:
            yield name, value


def _plural(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (tuple, list):
        if origin is list or arguments[-1] is Ellipsis:
            return f"lists of {_plural(arguments[0])}"
        count = len(arguments)
        lists = f"lists of {_COUNTS.get(count, count)} {_plural(arguments[0])}"
        return "points" if arguments == (float, float, float) else lists
    if origin is Literal:
        return describe(annotation)
    if origin in (Union, types.UnionType):
        return _join([_plural(a) for a in arguments if a is not types.NoneType])
    return _PLURALS.get(annotation, "values")


def _join(words: Sequence[str]) -> str:
    return " or ".join((", ".join(words[:-1]), words[-1])) if len(words) > 1 else words[0]
