"""Typed settings: the only source of a setting's name, type, range, default and help.

- `Options`, `option`: a dataclass of settings and its fields.
- `settings_of`: the settings of a class, for help, completion and documentation.
- `Registry`: named components of one kind, built in or from installed packages.
- `to_mapping`: settings as a table of values; `Options.from_mapping` reads it.
"""

from tactorch.config.options import Options, Setting, option, settings_of, to_mapping
from tactorch.config.registry import REGISTRIES, Registry

__all__ = [
    "REGISTRIES",
    "Options",
    "Registry",
    "Setting",
    "option",
    "settings_of",
    "to_mapping",
]
