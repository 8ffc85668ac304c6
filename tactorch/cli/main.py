"""Verbs, and the way from a command line to a Hydra app."""

import importlib
import importlib.util
import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omegaconf import DictConfig

VERBS = {
    "simulate": "press a phantom and record how its surface moves",
    "import": "turn files of others into a recording",
    "invert": "reconstruct the map of Young's modulus from a recording",
    "evaluate": "score a reconstruction against the truth",
    "demo": "from presses to a map, on a simulated cube or a published case",
}
# `import` is a word of Python's own.
_MODULES = {"import": "import_"}


def main(arguments: list[str] | None = None) -> None:
    """Run `tactorch VERB [settings]`."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help", "help"):
        print(_usage())
        return
    if given[0] in ("-V", "--version", "version"):
        from tactorch.versions import versions

        print("  ".join(f"{name} {version}" for name, version in versions().items()))
        return
    verb, rest = given[0], given[1:]
    if verb not in VERBS:
        _fail(f"'{verb}' is not a command; choose one of {', '.join(VERBS)}.{_closest(verb)}")
    run_app(verb, rest)


def run_app(verb: str, settings: list[str]) -> None:
    """Run the Hydra app of a verb with these settings."""
    import hydra

    from tactorch.errors import TactorchError

    try:
        settings = _with_resume(verb, settings)
    except TactorchError as error:
        _fail(str(error), verb)
    module = importlib.import_module(f"tactorch.cli.{_MODULES.get(verb, verb)}")
    sys.argv = [f"tactorch {verb}", *settings]
    app = hydra.main(version_base="1.3", config_path=_conf(), config_name=verb)
    app(_guarded(module.run, verb))()


def _guarded(task: Callable[["DictConfig"], Any], verb: str) -> Callable[["DictConfig"], Any]:
    """Turn errors raised on purpose into one message and exit status 2."""
    from omegaconf import MissingMandatoryValue

    from tactorch.errors import TactorchError

    def run(cfg: "DictConfig") -> Any:
        try:
            return task(cfg)
        except TactorchError as error:
            logging.getLogger("tactorch").debug("failed", exc_info=True)
            return _fail(str(error), verb)
        except MissingMandatoryValue as error:
            name = error.full_key or str(error)
            return _fail(f"'{name}' is missing; give {name}=... (see tactorch {verb} --help).", verb)

    return run


def _fail(message: str, verb: str = "") -> None:
    """Print one message and leave."""
    print(f"tactorch {verb}".rstrip() + f": error: {message}", file=sys.stderr)
    sys.exit(2)


def _conf() -> str:
    """Where the settings are: in the package, or beside it in a bare checkout."""
    if importlib.util.find_spec("tactorch.conf") is not None:
        return "pkg://tactorch.conf"
    beside = Path(__file__).resolve().parents[2] / "conf"
    if not (beside / "invert.yaml").is_file():
        _fail("the settings (tactorch.conf) are not installed; install with pip install tactorch.")
    return os.fspath(beside)


def _with_resume(verb: str, settings: list[str]) -> list[str]:
    """Let `resume=RUN` alone repeat that run's settings in its folder; later settings win."""
    from tactorch.cli.resume import settings_of

    chosen = [s.split("=", 1)[1] for s in settings if s.startswith("resume=")]
    if verb != "invert" or not chosen or chosen[-1] in ("", "null"):
        return settings
    return settings_of(Path(chosen[-1]), settings)


def _usage() -> str:
    lines = ["tactorch: from presses on a soft object to a map of its Young's modulus", ""]
    lines += [f"  tactorch {verb:<9} {text}" for verb, text in VERBS.items()]
    lines += ["", "  tactorch VERB --help shows its settings; tactorch --version its versions."]
    return "\n".join(lines)


def _closest(word: str) -> str:
    import difflib

    found = difflib.get_close_matches(word, VERBS, n=1)
    return f" Did you mean '{found[0]}'?" if found else ""
