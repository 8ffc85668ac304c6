"""Files of a live run, from which a killed run continues."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import FileError
from tactorch.files import read_arrays, write_arrays, write_file
from tactorch.sampling.sources import Arrival

STATE, HISTORY, RESULT = "state.npz", "history.jsonl", "reconstruction.h5"


class Store:
    """State and history of a run; each file is replaced as a whole.

    The state holds the history too, so that the two never disagree: a run that was killed between
    writing them writes the history again. A run is continued with the same settings only; `task`
    is their digest.
    """

    def __init__(self, folder: str | Path, task: str) -> None:
        self.folder, self._task = Path(folder), task

    def save(
        self,
        state: Mapping[str, np.ndarray],
        arrivals: Sequence[Arrival],
        history: Sequence[Mapping[str, Any]],
    ) -> None:
        """Write the state and the history, one JSON object a line."""
        lines = [json.dumps(entry, allow_nan=False) for entry in history]
        texts = {"keys": [a.key for a in arrivals], "marks": [a.digest for a in arrivals]}
        texts |= {"history": lines, "task": [self._task]}
        arrays = {name: np.array(values, dtype=str) for name, values in texts.items()}
        write_arrays(self.folder / STATE, {**arrays, **state})
        write_file(self.folder / HISTORY, "".join(f"{line}\n" for line in lines))

    def load(self) -> tuple[dict[str, np.ndarray], dict[str, str], list[dict[str, Any]]] | None:
        """Return state, digests of the presses by key, and history; None if the folder has none."""
        path = self.folder / STATE
        if not path.exists():
            return None
        state = read_arrays(path, "state", "delete it, or choose another run_dir.")
        if [self._task] != state.get("task", np.empty(0)).tolist():
            raise FileError(
                f"'{path}' is of a run with other settings; give those, to continue it, or choose "
                "another run_dir."
            )
        digests = dict(zip(state["keys"].tolist(), state["marks"].tolist(), strict=True))
        return state, digests, [json.loads(line) for line in state["history"].tolist()]
