"""Typed settings: the only source of a setting's name, type, range, default and help.

- `Options`, `option`: a dataclass of settings and its fields.
- `settings_of`: the settings of a class, for help, completion and documentation.
- `Registry`: named components of one kind, built in or from installed packages.
- `options_from_arguments`: settings that are the arguments of a function.
- `build`, `to_mapping`: settings from a table of values, and back.
"""

from tactorch.config.arguments import ArgumentOptions, options_from_arguments
from tactorch.config.options import Options, Setting, option, settings_of
from tactorch.config.registry import REGISTRIES, Registry, build, did_you_mean, to_mapping

__all__ = [
    "REGISTRIES",
    "ArgumentOptions",
    "Options",
    "Registry",
    "Setting",
    "build",
    "did_you_mean",
    "option",
    "options_from_arguments",
    "settings_of",
    "to_mapping",
]
