"""Verbs, and the way from a command line to one of them."""

import os
import sys

VERBS = {
    "simulate": "press a phantom and record how its surface moves",
    "import": "turn files of others into a recording",
    "invert": "reconstruct the map of Young's modulus from a recording",
    "live": "follow a recording that grows: the map after each press, and where to press next",
    "evaluate": "score a reconstruction against the truth",
    "generate": "make a dataset of simulated presses on random objects",
    "train": "train a network on a dataset",
    "evaluate-model": "how good a trained network is, in numbers and pictures",
    "demo": "from presses to a map, on a simulated cube or a published case",
    "sensor": "from camera frames of a tactile sensor to forces; see its commands below",
}
#: Commands of a verb that has several.
GROUPS = {
    "sensor": {
        "calibrate": "learn what colours tell of slopes, from presses of a ball",
        "check": "judge a calibration on presses that it was not made from",
        "track": "follow the markers through frames",
        "reconstruct": "depth of the gel's face in each frame",
        "force": "force on the gel in each frame, in all and over its face",
        "record": "frames and poses of a session into a recording, to invert",
    },
}
#: All that can be given settings, as typed.
COMMANDS = (
    *(verb for verb in VERBS if verb not in GROUPS),
    *(f"{group} {verb}" for group, verbs in GROUPS.items() for verb in verbs),
)


def main(arguments: list[str] | None = None) -> None:
    """Run `tactorch VERB [settings]`; ends the process where something is wrong."""
    try:
        _dispatch(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # as in `tactorch invert --help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _dispatch(arguments: list[str] | None) -> None:
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help", "help"):
        print(_usage())
        return
    if given[0] in ("-V", "--version", "version"):
        from tactorch.versions import versions

        print("  ".join(f"{name} {version}" for name, version in versions().items()))
        return
    from tactorch.cli.app import fail, run_app

    verb, settings = given[0], given[1:]
    if verb not in VERBS:
        from tactorch.cli.complaints import did_you_mean

        known = ", ".join(VERBS)
        fail(f"'{verb}' is not a command; choose one of {known}.{did_you_mean(verb, list(VERBS))}")
    if verb not in GROUPS:
        run_app(verb, settings)
    elif not settings or settings[0] in ("-h", "--help", "help"):
        print(_usage_of(verb))
    elif settings[0] in GROUPS[verb]:
        run_app(f"{verb} {settings[0]}", settings[1:])
    else:
        from tactorch.cli.complaints import did_you_mean

        commands = list(GROUPS[verb])
        fail(
            f"'{settings[0]}' is not one of its commands; choose one of {', '.join(commands)}."
            f"{did_you_mean(settings[0], commands)}",
            verb,
        )


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
