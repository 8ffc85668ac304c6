"""The `tactorch` command: its verbs, and the dispatch of a command line to one of them."""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

from tactorch.cli.starting import STARTED, show_starting

if TYPE_CHECKING:
    from tactorch.cli.app import App

__all__ = ["COMMANDS", "GROUPS", "VERBS", "main"]

_HELP = ("-h", "--help", "help")
VERBS = {
    "simulate": "press a phantom and record how its surface moves",
    "mesh": "tetrahedra inside a closed surface (STL, OBJ, PLY)",
    "body": "mesh an object from a labelled volume, such as a segmentation of CT or MRI",
    "import": "convert files of other formats into a recording",
    "invert": "reconstruct the map of Young's modulus, and the lumps in it, from a recording",
    "live": "follow a growing recording: map and lumps, and where to press next",
    "find": "fit inclusions to the presses of an element map, and name their shape",
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
        "unpack": "frames and poses of a ROS 2 bag into a folder, for record",
        "record": "frames and poses of a session into a recording, to invert",
    }
}
#: Verbs without settings: their modules have the text `HELP`.
PLAIN = ("doctor", "completion")
#: Commands that take settings, as typed.
COMMANDS = (
    *(verb for verb in VERBS if verb not in (*GROUPS, *PLAIN)),
    *(f"{group} {verb}" for group, verbs in GROUPS.items() for verb in verbs),
)


def main(arguments: list[str] | None = None) -> None:
    """Run `tactorch VERB [settings]`; ends the process with a status other than 0 on errors."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        show_starting(words)
    try:
        app = _dispatch(words)
        if app is not None:
            app.run()
        sys.stdout.flush()
    except BrokenPipeError:  # as in `tactorch invert --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:  # before or after a command's own run
        from tactorch.cli.console import INTERRUPTED

        print("tactorch: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        STARTED.set()


def _dispatch(words: list[str]) -> "App | None":
    """Return the app of a command that takes settings; run any other, and return None."""
    if len(words) > 1 and words[0] in _HELP:
        words = [*words[1:], "--help"]
    if not words or words[0] in _HELP:
        print(_usage())
        return None
    if words[0] in ("-V", "--version", "version") or words[-1] == "--version":
        from tactorch.versions import versions

        print("  ".join(f"{name} {version}" for name, version in versions().items()))
        return None
    from tactorch.cli.app import App, fail
    from tactorch.cli.help import help_text, wants_help
    from tactorch.config.registry import did_you_mean, entry_points
    from tactorch.errors import TactorchError

    command, *settings = words
    if command not in VERBS:
        fail(_no_command(command))
    if command in GROUPS:
        if not settings or settings[0] in _HELP:
            print(_group_usage(command))
            return None
        if settings[0] not in GROUPS[command]:
            names, hint = ", ".join(GROUPS[command]), did_you_mean(settings[0], GROUPS[command])
            fail(
                f"'{settings[0]}' is not one of its commands; choose one of {names}.{hint}", command
            )
        command = f"{command} {settings.pop(0)}"
    plain = import_module(f"tactorch.cli.{command}") if command in PLAIN else None
    try:
        if plain is None:
            entry_points()  # torch and others fail with a traceback where it fails
        if wants_help(settings):
            print(help_text(command, settings) if plain is None else plain.HELP)
            return None
        if plain is None:
            return App(command, settings)
        if status := plain.run(settings):
            sys.exit(status)
    except TactorchError as error:
        fail(str(error), command)
    return None


def _no_command(word: str) -> str:
    """Return the message for a word that is no command."""
    from tactorch.config.registry import did_you_mean

    if "=" in word:
        return f"a command comes first, as in: tactorch simulate {word}"
    inner = next((command for command in COMMANDS if command.endswith(f" {word}")), None)
    flags = ("--help", "--version")
    hint = f" Did you mean '{inner}'?" if inner else did_you_mean(word, [*VERBS, *flags])
    return f"'{word}' is not a command; choose one of {', '.join(VERBS)}.{hint}"


def _usage() -> str:
    lines = ["tactorch: from presses on a soft object to a map of its Young's modulus", ""]
    lines += [f"  tactorch {verb:<15} {text}" for verb, text in VERBS.items()]
    for group in GROUPS:
        lines += ["", *_commands(group)]
    lines += ["", "  tactorch VERB --help shows its settings; tactorch --version its versions."]
    return "\n".join(lines)


def _group_usage(group: str) -> str:
    lines = [f"tactorch {group}: {VERBS[group].split(';')[0]}", "", *_commands(group)]
    lines += ["", f"  tactorch {group} COMMAND --help shows its settings."]
    return "\n".join(lines)


def _commands(group: str) -> list[str]:
    return [f"  tactorch {group} {verb:<12} {text}" for verb, text in GROUPS[group].items()]
