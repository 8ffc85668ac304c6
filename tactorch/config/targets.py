"""Components of user-defined modules, named by `_target_` in a folder of settings.

Importing a module runs its code. A name is imported only where its package is trusted: tactorch,
installed packages with an entry point of tactorch, and those that the user names (`--trust`).
"""

import inspect
import os
import sys
from importlib import import_module
from typing import Any

from tactorch.config.options import Options
from tactorch.config.registry import Registry, entry_points
from tactorch.errors import ConfigError

#: Key of the import path, as in configurations of Hydra.
TARGET = "_target_"
_trusted: set[str] = {"tactorch"}


def trust(*packages: str) -> None:
    """Allow that classes of packages are imported by this process."""
    _trusted.update(package.strip() for name in packages for package in name.split(","))


def load_target(path: Any, registry: Registry, where: str) -> type[Options]:
    """Return the class of an import path.

    Args:
        path: Import path, MODULE.CLASS or MODULE:CLASS.
        registry: Components of the same kind, whose base class it has.
        where: File that names it, for messages.

    Raises:
        ConfigError: The package is not trusted, the class cannot be imported, or it is not of this
            kind.
    """
    module, name = _split(path, where)
    package = module.partition(".")[0]
    installed = {entry.value.partition(":")[0].partition(".")[0] for entry in entry_points()}
    if package not in _trusted | installed:
        raise ConfigError(
            f"'{where}' sets {TARGET}: {path}, and the package '{package}' is not trusted; add "
            f"--trust {package} if you trust its code."
        )
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        component = getattr(import_module(module), name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever code of another package raises
        raise ConfigError(
            f"'{where}': {TARGET}: {path} cannot be imported ({type(error).__name__}: {error}); "
            "check the path. The working directory and PYTHONPATH are searched."
        ) from error
    base = registry.base() or Options
    if not (inspect.isclass(component) and issubclass(component, base)):
        raise ConfigError(
            f"'{where}': {TARGET}: {path} is no {registry.section}; derive the class from "
            f"{base.__module__}.{base.__qualname__}."
        )
    return component


def _split(path: Any, where: str) -> tuple[str, str]:
    text = path.replace(":", ".") if isinstance(path, str) else ""
    module, _, name = text.rpartition(".")
    if not (module and all(part.isidentifier() for part in text.split("."))):
        raise ConfigError(
            f"'{where}': {TARGET}: {path!r}: give MODULE.CLASS, as my_lab.priors.Mine."
        )
    return module, name
