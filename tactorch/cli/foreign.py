"""Presets and experiments of another folder, `--config-dir`.

They are read as plain settings: nothing in them reaches Hydra's own settings, by which a file could
run any function. `--trust-config-dir` hands the folder to Hydra as it is.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tactorch.cli.overrides import PROGRAM
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
    content = path.read_bytes()
    is_hydra = path.relative_to(folder).parts[0] == "hydra" or b"@package hydra" in content
    reasons = [text for text in _texts(read_yaml(path)) if _is_program(text)]
    if is_hydra or reasons:
        shown = f" sets '{reasons[0]}'" if reasons else " sets 'hydra'"
        raise ConfigError(
            f"'{path}'{shown}, which can run programs or read the environment; remove it, or add "
            "--trust-config-dir if you trust everything in that folder."
        )


def _is_program(text: str) -> bool:
    name = text.removeprefix("override ").lstrip("/")
    is_hydra = name == "hydra" or name.startswith(("hydra/", "hydra.", "hydra@"))
    return is_hydra or PROGRAM.search(text) is not None


def _texts(value: Any) -> Iterator[str]:
    """Yield all text in a table, names and values."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield str(key)
            yield from _texts(inner)
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)
    elif isinstance(value, str):
        yield value
