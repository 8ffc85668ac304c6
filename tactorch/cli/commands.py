"""The commands: names, purposes and usage."""

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
#: Verbs without settings: their modules have the text `HELP`.
PLAIN = ("doctor", "completion")
#: Commands that take settings, as typed.
COMMANDS = (
    *(verb for verb in VERBS if verb not in (*GROUPS, *PLAIN)),
    *(f"{group} {verb}" for group, verbs in GROUPS.items() for verb in verbs),
)


def usage() -> str:
    """Return the list of all commands."""
    lines = ["tactorch: from presses on a soft object to a map of its Young's modulus", ""]
    lines += [f"  tactorch {verb:<15} {text}" for verb, text in VERBS.items()]
    for group in GROUPS:
        lines += ["", *_commands(group)]
    lines += ["", "  tactorch VERB --help shows its settings; tactorch --version its versions."]
    return "\n".join(lines)


def group_usage(group: str) -> str:
    """Return the list of the commands of a verb."""
    lines = [f"tactorch {group}: {VERBS[group].split(';')[0]}", "", *_commands(group)]
    lines += ["", f"  tactorch {group} COMMAND --help shows its settings."]
    return "\n".join(lines)


def _commands(group: str) -> list[str]:
    return [f"  tactorch {group} {verb:<12} {text}" for verb, text in GROUPS[group].items()]
