"""Files of a live run, from which a killed run continues."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError
from tactorch.files import atomic_path, read_arrays, write_arrays
from tactorch.inverse import Reconstruction
from tactorch.sampling.sources import Arrival

STATE, HISTORY, RESULT = "state.npz", "history.jsonl", "reconstruction.h5"


class Store:
    """State, history and result of a run; each file is replaced as a whole.

    The state holds the history too, so that the two never disagree: a run that was killed between
    writing them writes the history again.

    Args:
        folder: Folder of the run.
        task: Digest of the settings; a run is continued with the same ones only.
    """

    def __init__(self, folder: str | Path, task: str) -> None:
        self.folder, self._task = Path(folder), task

    def save(
        self,
        state: Mapping[str, np.ndarray],
        arrivals: Sequence[Arrival],
        history: Sequence[Mapping[str, Any]],
    ) -> None:
        """Write the state and the history after an update."""
        lines = [json.dumps(entry, allow_nan=False) for entry in history]
        texts = {
            "keys": [arrival.key for arrival in arrivals],
            "marks": [arrival.digest for arrival in arrivals],
            "history": lines,
            "task": [self._task],
        }
        arrays = {name: np.array(values, dtype=str) for name, values in texts.items()}
        write_arrays(self.folder / STATE, {**arrays, **state})
        self.write_history(history)

    def save_result(self, result: Reconstruction) -> None:
        """Write the reconstruction."""
        result.save(self.folder / RESULT)

    def write_history(self, history: Sequence[Mapping[str, Any]]) -> None:
        """Write the history, one JSON object a line."""
        with atomic_path(self.folder / HISTORY) as path:
            text = "".join(json.dumps(entry, allow_nan=False) + "\n" for entry in history)
            path.write_text(text, encoding="utf-8")

    def load(self) -> dict[str, np.ndarray] | None:
        """Return the state of the run to continue; None if the folder holds none.

        Raises:
            FileError: the state cannot be read, or is of a run with other settings.
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

    @staticmethod
    def history(state: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
        """Return the history that a state holds."""
        return [json.loads(str(line)) for line in state["history"]]
