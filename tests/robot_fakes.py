"""A robot without mechanics, and entries of a history, for the tests of `tactorch.robot`."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tactorch.robot import PressCommand, PressReport

DOWN = np.array([0.0, 0.0, -1.0])


def quadratic(points: np.ndarray) -> np.ndarray:
    """Return a displacement that is a quadratic polynomial of the position, mm."""
    x, y, _ = (points - 5.0).T
    return 0.01 * np.column_stack([x, y, -4.0 + 0.5 * x * x + 0.3 * x * y])


@dataclass
class FakeRobot:
    """Reports a known displacement at the commanded pose.

    Attributes:
        failures: Exception of each call that fails, by its number.
        changes: Fields of the report that are replaced.
    """

    failures: dict[int, Exception] = field(default_factory=dict)
    changes: dict[str, Any] = field(default_factory=dict)
    commands: list[PressCommand] = field(default_factory=list)

    def press(self, command: PressCommand) -> PressReport:
        self.commands.append(command)
        if error := self.failures.get(len(self.commands)):
            raise error
        grid = np.linspace(-1.0, 1.0, 15)
        offsets = np.array([(x, y, 0.0) for x in grid for y in grid if x * x + y * y <= 1.0])
        points = command.center_mm + command.radius_mm * offsets
        report = PressReport(
            command.center_mm, command.inward, command.force_n * command.inward,
            points, quadratic(points), 0.002,
        )  # fmt: skip
        return replace(report, **self.changes)


def entry(
    press: int, *widths: float, probability: float = 0.99, searched: bool = True, **finding: Any
) -> dict[str, Any]:
    lumps = [
        {"center_deviation_mm": [0.1 * w / 3.29, w / 3.29, 0.0], "probability": probability}
        for w in widths
    ]
    found = {"lumps": lumps, "reasons": [], **finding}
    return {"press": press, "finding": found, "searched": searched}
