"""The `tactorch` command: one Hydra app per verb."""

from tactorch.cli.main import COMMANDS, GROUPS, VERBS, main

__all__ = ["COMMANDS", "GROUPS", "VERBS", "main"]
