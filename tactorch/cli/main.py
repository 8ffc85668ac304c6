"""Dispatch of a command line to one of the commands."""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING

from tactorch.cli.commands import COMMANDS, GROUPS, PLAIN, VERBS, group_usage, usage

if TYPE_CHECKING:
    from tactorch.cli.app import App

_HELP = ("-h", "--help", "help")


def main(arguments: list[str] | None = None) -> None:
    """Run `tactorch VERB [settings]`; ends the process with a status other than 0 on errors."""
    try:
        app = _dispatch(list(sys.argv[1:] if arguments is None else arguments))
        if app is not None:
            with app.hydra_main() as hydra_main:
                hydra_main()
        sys.stdout.flush()
    except BrokenPipeError:  # as in `tactorch invert --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:  # before or after a command's own run
        from tactorch.cli.console import INTERRUPTED

        print("tactorch: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _dispatch(words: list[str]) -> "App | None":
    """Return the app of a command that takes settings; run any other, and return None."""
    if len(words) > 1 and words[0] in _HELP:
        words = [*words[1:], "--help"]
    if not words or words[0] in _HELP:
        print(usage())
        return None
    if words[0] in ("-V", "--version", "version") or words[-1] == "--version":
        from tactorch.versions import versions

        print("  ".join(f"{name} {version}" for name, version in versions().items()))
        return None
    from tactorch.cli.app import App, fail
    from tactorch.cli.help import help_text, wants_help
    from tactorch.errors import TactorchError

    command, *settings = words
    if command not in VERBS:
        fail(_no_command(command))
    if command in GROUPS:
        if not settings or settings[0] in _HELP:
            print(group_usage(command))
            return None
        if settings[0] not in GROUPS[command]:
            fail(_no_command_of(command, settings[0]), command)
        command = f"{command} {settings.pop(0)}"
    plain = import_module(f"tactorch.cli.{command}") if command in PLAIN else None
    try:
        if wants_help(settings):
            print(help_text(command, settings) if plain is None else plain.HELP)
            return None
        if plain is None:
            return App(command, settings)
        status = plain.run(settings)
    except TactorchError as error:
        fail(str(error), command)
    if status:
        sys.exit(status)
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


def _no_command_of(group: str, word: str) -> str:
    from tactorch.config.registry import did_you_mean

    names, hint = ", ".join(GROUPS[group]), did_you_mean(word, GROUPS[group])
    return f"'{word}' is not one of its commands; choose one of {names}.{hint}"
