"""The `tactorch` command: one Hydra app per verb."""

from tactorch.cli.commands import COMMANDS, GROUPS, VERBS
from tactorch.cli.main import main

__all__ = ["COMMANDS", "GROUPS", "VERBS", "main"]
