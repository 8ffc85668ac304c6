"""The `tactorch` command: one Hydra app per verb."""

from tactorch.cli.main import VERBS, main

__all__ = ["VERBS", "main"]
