"""The commands, and the dispatch of a command line to one of them."""

import os
import sys
from importlib import import_module

from tactorch.cli.status import INTERRUPTED

_HELP = ("-h", "--help", "help")

VERBS = {
    "simulate": "press a phantom and record how its surface moves",
    "import": "convert files of other formats into a recording",
    "invert": "reconstruct the map of Young's modulus from a recording",
    "live": "follow a growing recording: the map after each press, and where to press next",
    "find": "lumps in a map: depth, size, confidence and shape",
    "evaluate": "score a reconstruction against the truth",
    "report": "one HTML file with the results of a run, or of several side by side",
    "generate": "make a dataset of simulated presses on random objects",
    "train": "train a network on a dataset",
    "evaluate-model": "evaluate a trained network, in numbers and pictures",
    "reproduce": "reproduce the paper's tables and figures beside its own numbers",
    "demo": "from presses to a map, on a simulated cube or a published case",
    "sensor": "from camera frames of a tactile sensor to forces; see its commands below",
    "doctor": "check this machine: what works, what is missing, and how to install it",
    "completion": "a script that makes bash, zsh or fish complete commands and settings",
}
#: Commands of a verb that has several.
GROUPS = {
    "sensor": {
        "calibrate": "fit the map from colours to slopes, from presses of a ball",
        "check": "test a calibration on presses that it was not fitted to",
        "track": "follow the markers through frames",
        "reconstruct": "depth of the gel's surface in each frame",
        "force": "force on the gel in each frame: resultant and distribution",
        "record": "frames and poses of a session into a recording, to invert",
    },
}
#: Verbs that are no Hydra apps: they have no settings.
PLAIN = ("doctor", "completion")
#: Commands that take settings, as typed.
COMMANDS = (
    *(verb for verb in VERBS if verb not in (*GROUPS, *PLAIN)),
    *(f"{group} {verb}" for group, verbs in GROUPS.items() for verb in verbs),
)


def main(arguments: list[str] | None = None) -> None:
    """Run `tactorch VERB [settings]`; ends the process with a status other than 0 on errors."""
    try:
        _dispatch(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # as in `tactorch invert --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:  # before or after what a command's own run catches
        print("tactorch: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _dispatch(arguments: list[str] | None) -> None:
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given and given[0] in _HELP and len(given) > 1:
        given = [*given[1:], "--help"]
    if not given or given[0] in _HELP:
        print(_usage())
        return
    if given[0] in ("-V", "--version", "version") or given[-1] == "--version":
        from tactorch.versions import versions

        print("  ".join(f"{name} {version}" for name, version in versions().items()))
        return
    from tactorch.cli.app import fail, run_app
    from tactorch.cli.positional import named

    verb, settings = given[0], given[1:]
    if verb not in VERBS:
        fail(_no_command(verb))
    if verb in PLAIN:
        _run_plain(verb, settings)
    elif verb not in GROUPS:
        run_app(verb, named(verb, settings))
    elif not settings or settings[0] in _HELP:
        print(_usage_of(verb))
    elif settings[0] in GROUPS[verb]:
        run_app(f"{verb} {settings[0]}", settings[1:])
    else:
        from tactorch.config import did_you_mean

        commands = list(GROUPS[verb])
        fail(
            f"'{settings[0]}' is not one of its commands; choose one of {', '.join(commands)}."
            f"{did_you_mean(settings[0], commands)}",
            verb,
        )


def _no_command(word: str) -> str:
    """Return the message for a word that is no command."""
    from tactorch.config import did_you_mean

    if "=" in word:
        return f"a command comes first, as in: tactorch simulate {word}"
    inner = next((command for command in COMMANDS if command.endswith(f" {word}")), None)
    flags = ("--help", "--version")
    hint = f" Did you mean '{inner}'?" if inner else did_you_mean(word, [*VERBS, *flags])
    return f"'{word}' is not a command; choose one of {', '.join(VERBS)}.{hint}"


def _run_plain(verb: str, words: list[str]) -> None:
    """Run a verb that is no Hydra app; its module returns the exit status."""
    from tactorch.cli.app import fail
    from tactorch.cli.help import wants_help
    from tactorch.errors import TactorchError

    module = import_module(f"tactorch.cli.{verb}")
    if wants_help(words):
        print(module.HELP)
        return
    try:
        status = module.run(words)
    except TactorchError as error:
        fail(str(error), verb)
    if status:
        sys.exit(status)


def _usage() -> str:
    lines = ["tactorch: from presses on a soft object to a map of its Young's modulus", ""]
    lines += [f"  tactorch {verb:<15} {text}" for verb, text in VERBS.items()]
    for group in GROUPS:
        lines += ["", *_commands(group)]
    lines += ["", "  tactorch VERB --help shows its settings; tactorch --version its versions."]
    return "\n".join(lines)


def _usage_of(group: str) -> str:
    lines = [f"tactorch {group}: {VERBS[group].split(';')[0]}", "", *_commands(group)]
    lines += ["", f"  tactorch {group} COMMAND --help shows its settings."]
    return "\n".join(lines)


def _commands(group: str) -> list[str]:
    return [f"  tactorch {group} {verb:<12} {text}" for verb, text in GROUPS[group].items()]
