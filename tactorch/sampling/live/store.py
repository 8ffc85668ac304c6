"""What a live run leaves in its folder, so that a killed one goes on where it was."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError
from tactorch.files import atomic_path, read_arrays, write_arrays
from tactorch.sampling.live.source import Arrival

STATE, HISTORY, RESULT = "state.npz", "history.jsonl", "reconstruction.h5"


class Store:
    """State and history of a run, each file whole at every moment.

    The state holds the history too, so that the two never disagree: a run that was killed between
    writing one and the other writes the history again.
    """

    def __init__(self, folder: str | Path, task: str) -> None:
        """Take the folder.

        Args:
            folder: Of the run.
            task: What must be the same for a run to be continued: the settings, in few characters.
        """
        self.folder, self._task = Path(folder), task

    def save(
        self,
        state: Mapping[str, np.ndarray],
        arrivals: Sequence[Arrival],
        history: Sequence[Mapping[str, Any]],
    ) -> None:
        """Write the state after an update, and the history."""
        lines = [json.dumps(entry, allow_nan=False) for entry in history]
        texts = {
            "keys": [one.key for one in arrivals],
            "marks": [one.mark for one in arrivals],
            "history": lines,
            "task": [self._task],
        }
        arrays = {name: np.array(values, dtype=str) for name, values in texts.items()}
        write_arrays(self.folder / STATE, {**arrays, **state})
        self.write_history(history)

    def write_history(self, history: Sequence[Mapping[str, Any]]) -> None:
        """Write the history, one JSON object a line."""
        with atomic_path(self.folder / HISTORY) as path:
            text = "".join(json.dumps(entry, allow_nan=False) + "\n" for entry in history)
            path.write_text(text, encoding="utf-8")

    def load(self) -> dict[str, np.ndarray] | None:
        """Return the state of the run to continue; None where the folder holds none.

        Raises:
            FileError: it cannot be read, or was made with other settings.
        """
        path = self.folder / STATE
        if not path.exists():
            return None
        state = read_arrays(path, "state", "delete it, or choose another run_dir.")
        task = str(state["task"].ravel()[0]) if state.get("task", np.empty(0)).size else ""
        if task != self._task:
            raise FileError(
                f"'{path}' is of a run with other settings; give those, to continue it, or choose "
                "another run_dir."
            )
        return state


def history_of(state: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    """Return the history that a state holds."""
    return [json.loads(str(line)) for line in state["history"]]
