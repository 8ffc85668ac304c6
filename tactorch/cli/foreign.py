"""Presets and experiments of another folder, `--config-dir`.

They are read as plain settings: nothing in them reaches Hydra's own settings, by which a file could
run any function. `--trust-config-dir` hands the folder to Hydra as it is.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tactorch.cli.schema import EXPERIMENT, Schema, add_presets, read_experiments, read_yaml
from tactorch.errors import ConfigError
from tactorch.files import require_folder


def add_folder(schema: Schema, folder: Path) -> None:
    """Add the presets and experiments of a folder to a command's schema.

    Raises:
        FileError: there is no such folder.
        ConfigError: a file holds more than plain settings, an unknown setting, or has the name of
            an option of tactorch.
    """
    require_folder(folder, "folder of settings (--config-dir)")
    for path in sorted(folder.rglob("*.yaml")):
        _check_plain(path, folder)
    for group, found in schema.groups.items():
        _check_names(folder / group, found["options"])
        add_presets(folder / group, found)
    _check_names(folder / EXPERIMENT, schema.experiments)
    schema.experiments |= read_experiments(folder, schema.settings, schema.groups)


def _check_names(folder: Path, options: dict[str, Any]) -> None:
    for path in folder.glob("*.yaml"):
        if path.stem in options:
            raise ConfigError(f"'{path}' has the name of an option of tactorch; rename it.")


def _check_plain(path: Path, folder: Path) -> None:
    """Refuse settings of Hydra and names of functions, wherever they stand in a file."""
    text = path.read_bytes()
    is_hydra = path.relative_to(folder).parts[0] == "hydra" or b"@package hydra" in text
    reasons = [key for key in _keys(read_yaml(path)) if _is_program(key)]
    if is_hydra or reasons:
        shown = f" sets '{reasons[0]}'" if reasons else " sets 'hydra'"
        raise ConfigError(
            f"'{path}'{shown}, which can run programs; remove it, or add --trust-config-dir if you "
            "trust everything in that folder."
        )


def _is_program(key: str) -> bool:
    name = key.removeprefix("override ").lstrip("/")
    return name in ("hydra", "_target_") or name.startswith(("hydra/", "hydra.", "hydra@"))


def _keys(value: Any) -> Iterator[str]:
    """Yield all names in a table, and all text in its lists of defaults."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield str(key)
            yield from _keys(inner)
    elif isinstance(value, list):
        for item in value:
            yield from [item] if isinstance(item, str) else _keys(item)
