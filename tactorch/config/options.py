"""Typed settings: a frozen dataclass whose fields know their range, unit and help.

A setting is declared once, where it is used:

    @dataclass(frozen=True)
    class TotalVariation(Options):
        section = "regularization"
        edge: float = option(0.03, "Jump of log-modulus below which the penalty is quadratic", gt=0)

Making one checks every value. The command line, its help and completion, the documentation and
error messages read the same fields (`settings_of`).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache
from hashlib import sha256
from types import FunctionType
from typing import Any, ClassVar, get_args, get_type_hints

from tactorch.config.registry import (
    NO_VALUE,
    REGISTRIES,
    Registry,
    missing_setting,
    unknown_setting,
)
from tactorch.config.values import INVALID, choices_of, convert, describe
from tactorch.errors import ConfigError

_KEY = "option"
#: Factor from another unit, in which a number may be given by mistake, by unit of a setting.
_OTHER_UNITS = {"mm": {"metres": 1e3}, "MPa": {"kPa": 1e-3, "Pa": 1e-6}}


def option(
    default: Any = MISSING,
    help: str = "",
    *,
    factory: Callable[[], Any] | None = None,
    **attributes: Any,
) -> Any:
    """Declare a setting as a field of an `Options` dataclass.

    Args:
        default: Default value; without one (and without `factory`) the setting is required.
        help: Description, a phrase without a full stop.
        factory: Function that makes the default, for mutable and nested values.
        attributes: Others of `Setting`: its unit, its limits, and where its values come from.

    Returns:
        A dataclass field.
    """
    metadata = {_KEY: Setting(help, **attributes)}
    if factory is not None:
        return field(default_factory=factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Setting:
    """A setting as messages, help, completion and documentation show it.

    Attributes:
        help: Description, a phrase without a full stop.
        unit: Physical unit, such as "mm".
        gt: Exclusive lower limit of all numbers in the value.
        ge: Inclusive lower limit.
        lt: Exclusive upper limit.
        le: Inclusive upper limit.
        section: Registry that the value is chosen from by name.
        preset: Name of the preset in `conf/` that holds the defaults, for nested settings that the
            command line offers as a group of presets.
        nonempty: Whether a list needs at least one item.
        name: Name of the field.
        annotation: Type.
        default: Default value; `dataclasses.MISSING` where the setting is required.
    """

    help: str
    unit: str = ""
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    section: str = ""
    preset: str = ""
    nonempty: bool = False
    name: str = ""
    annotation: Any = None
    default: Any = None

    @property
    def required(self) -> bool:
        """Whether there is no default."""
        return self.default is MISSING

    @property
    def registry(self) -> Registry | None:
        """Components that the value is chosen from; None for other values."""
        return REGISTRIES.get(self.section)

    @property
    def nested(self) -> "type[Options] | None":
        """Class of the nested settings that the value is made of; None for a plain value."""
        members = get_args(self.annotation) or (self.annotation,)
        classes = (m for m in members if isinstance(m, type) and issubclass(m, Options))
        return next(classes, None)

    @property
    def choices(self) -> tuple[Any, ...]:
        """Values that the type lists, for completion."""
        return choices_of(self.annotation)

    @property
    def range(self) -> str:
        """Range in words, such as "above 0, up to 1"; empty where there is none."""
        if self.gt is None and self.ge is not None and self.le is not None:
            return f"{self.ge:g} to {self.le:g}"
        low = f"at least {self.ge:g}" if self.ge is not None else ""
        low = f"above {self.gt:g}" if self.gt is not None else low
        high = f"below {self.lt:g}" if self.lt is not None else ""
        high = f"up to {self.le:g}" if self.le is not None else high
        return ", ".join(part for part in (low, high) if part)

    @property
    def expectation(self) -> str:
        """Description of valid values, such as "a number above 0, or null"."""
        kind, limits = describe(self.annotation), self.range
        separator = " " if limits.startswith(("above", "below")) else ", "
        or_null = ", or null" if convert(None, self.annotation) is None else ""
        items = ", not empty" if self.nonempty else ""
        return f"{kind}{separator if limits else ''}{limits}{items}{or_null}"

    def check(self, value: Any, prefix: str = "") -> Any:
        """Return the value converted to the setting's type.

        Names and tables of settings with a section or of nested settings become objects. Messages
        name the setting `prefix.name`.
        """
        name = f"{prefix}.{self.name}" if prefix else self.name
        if self.registry is not None:
            value = self.registry.build(value, name)
        elif self.nested is not None and isinstance(value, Mapping):
            value = self.nested.from_mapping(value, name)
        converted = convert(value, self.annotation)
        is_missing = self.nonempty and converted == ()
        if converted is not INVALID and not is_missing and self._in_range(converted):
            return converted
        text = repr(value)
        text = text if len(text) <= 60 else f"{text[:57]}..."
        if self.nested is not None:
            raise ConfigError(f"{name}={text}: several settings; give {name}.KEY=VALUE.")
        hint = " Put it in quotes." if self.annotation is str else ""
        hint = hint if converted is INVALID else self._unit_hint(converted)
        raise ConfigError(f"{name}={text}: give {self.expectation}.{hint}")

    def _in_range(self, value: Any) -> bool:
        return all(
            (self.gt is None or number > self.gt)
            and (self.ge is None or number >= self.ge)
            and (self.lt is None or number < self.lt)
            and (self.le is None or number <= self.le)
            for number in _numbers(value)
        )

    def _unit_hint(self, value: Any) -> str:
        """Return a question about the unit of a value out of range; empty if there is none."""
        for unit, factor in _OTHER_UNITS.get(self.unit, {}).items():
            converted = [factor * number for number in _numbers(value)]
            if self._in_range(converted):
                shown = ", ".join(f"{number:g}" for number in converted)
                return f" Is it in {unit}? Then give {shown}."
        return ""


class Options:
    """Base of typed settings: a frozen dataclass that checks its fields when it is made.

    Attributes:
        section: Group that the settings belong to; messages name them `section.field`.
    """

    section: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Check and convert every field; raises `ConfigError` for a bad value."""
        for setting in settings_of(type(self)):
            value = getattr(self, setting.name)
            object.__setattr__(self, setting.name, setting.check(value, self.section))

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], section: str = "", chosen: str = "") -> Any:
        """Return settings from a table of values, such as a part of a Hydra config.

        Args:
            values: Value by name; settings that are left out have their defaults. Settings with a
                section, and nested settings, may be names or tables. The text "???" is no value.
            section: Section of the settings, for messages.
            chosen: Choice of the class, such as "optimizer=tnc", for messages.

        Raises:
            ConfigError: a setting is unknown or missing, or a value cannot be used.
        """
        settings = {setting.name: setting for setting in settings_of(cls)}
        values = {n: v for n, v in values.items() if not (isinstance(v, str) and v == NO_VALUE)}
        prefix = f"{section}." if section else ""
        for name in values:
            if name not in settings:
                known = [f"{prefix}{s}" for s in settings]
                kind = chosen or section or "this group"
                raise ConfigError(unknown_setting(f"{prefix}{name}", known, prefix, kind))
        for setting in settings.values():
            if setting.required and setting.name not in values:
                raise ConfigError(missing_setting(f"{prefix}{setting.name}", setting.expectation))
        return cls(**{name: settings[name].check(v, section) for name, v in values.items()})


def settings_of(options: type) -> tuple[Setting, ...]:
    """Return the settings of an `Options` class, in their order.

    Fields that are not declared by `option` are not settings.
    """
    return _settings(options)


@cache
def _settings(options: Any) -> tuple[Setting, ...]:  # for mypy, a class is not hashable
    hints, settings = get_type_hints(options), []
    for f in fields(options):
        if _KEY in f.metadata:
            default = f.default if f.default_factory is MISSING else f.default_factory()
            known = {"name": f.name, "annotation": hints[f.name], "default": default}
            settings.append(replace(f.metadata[_KEY], **known))
    return tuple(settings)


def to_mapping(value: Any, section: str = "") -> Any:
    """Return settings as a table of plain values, the reverse of `Options.from_mapping`.

    Values that are not plain are described, arrays by their checksum. `section` is the one of the
    registry that the value is chosen from, if any.
    """
    if isinstance(value, Options):
        registry = REGISTRIES.get(section)
        name = {} if registry is None else {"name": registry.name_of(type(value))}
        settings = settings_of(type(value))
        return name | {s.name: to_mapping(getattr(value, s.name), s.section) for s in settings}
    if isinstance(value, dict):  # such as the parts of a prior
        return {key: to_mapping(item, section) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_mapping(item) for item in value]
    if isinstance(value, type | FunctionType):
        return f"{value.__module__}.{value.__qualname__}"
    if is_dataclass(value):
        return {f.name: to_mapping(getattr(value, f.name)) for f in fields(value)}
    if getattr(value, "shape", ()):  # of an array
        digest = sha256(value.tobytes()).hexdigest()[:16]
        return f"{value.dtype} array {list(value.shape)}, sha256 {digest}..."
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield value
    elif isinstance(value, tuple | list | dict):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _numbers(item)
