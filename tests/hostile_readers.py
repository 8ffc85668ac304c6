"""Readers of files in processes with limits of memory and time.

Run as a program, it imports the readers once, and reads each file that standard input names in a
copy of itself (fork): lines of JSON, [reader, path], answered by [outcome, message, seconds, MiB].
"""

import gc
import importlib
import json
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

LIMIT_GIB = 0.1  # of the budget, so that files which exceed it are made quickly
MEMORY_MIB, SECONDS = 500, 20


def _function(path: str) -> Callable[[Path], Any]:
    module, _, name = path.partition(":")
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found  # type: ignore[no-any-return]


def _json(path: Path) -> Any:
    from tactorch.files import read_json

    return read_json(path, "summary", "write it again.")


def _arrays(path: Path) -> Any:
    from tactorch.files import read_arrays

    return read_arrays(path, "state", "write it again.")


def _resume(path: Path) -> Any:
    """A run folder, which `path` is one of the settings of."""
    from tactorch.cli import resume
    from tactorch.cli.schema import load_schema

    resume.saved_options("invert", path.parents[1])
    return resume.with_resume(load_schema("invert"), [f"resume={path.parents[1]}"])


def _presets(path: Path) -> Any:
    from tactorch.cli.presets import check_plain

    return check_plain(path.parents[1])


def _bag(path: Path) -> Any:
    from tactorch.ros2.bag import open_bag

    with open_bag(path.parent if path.name == "metadata.yaml" else path) as bag:
        for topic, count in bag.counts.items():
            if count:
                list(bag.messages(topic))


def _video(path: Path) -> Any:
    from tactorch.sensor.frames import open_source

    return sum(frame.image is not None for frame in open_source(path))


def _table(path: Path) -> Any:
    from tactorch.importers.sheets import read_sheet

    return read_sheet(path)


READERS: dict[str, Callable[[Path], Any]] = {
    "presets": _presets,
    "run": _resume,
    "json": _json,
    "arrays": _arrays,
    "bag": _bag,
    "video": _video,
    "table": _table,
    **{
        name: lambda path, place=place: _function(place)(path)  # type: ignore[misc]
        for name, place in {
            "sensor": "tactorch.sensor.description:load_sensor",
            "recording": "tactorch.recording:Recording.load",
            "reconstruction": "tactorch.inverse:Reconstruction.load",
            "recognizer": "tactorch.learning.recognizer:load_recognizer",
            "calibration": "tactorch.sensor.calibration:load_calibration",
            "volume": "tactorch.volumes.read:read_volume",
            "image": "tactorch.sensor.frames:read_image",
            "mesh": "tactorch.mesh:read_mesh",
            "surface": "tactorch.mesh:read_surface",
            "vtk": "tactorch.importers.vtk_files:read_vtk",
        }.items()
    },
}


def _status_kib(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))


def _answer(reader: str, path: str) -> tuple[str, str, float, float]:
    from tactorch.errors import TactorchError

    limit = (_status_kib("VmData:") + 1024 * MEMORY_MIB) * 1024
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    signal.alarm(SECONDS)
    before, start = _status_kib("VmRSS:"), time.monotonic()
    outcome, message = "read", ""
    try:
        READERS[reader](Path(path))
    except TactorchError as error:
        outcome, message = "refused", str(error)
    except BaseException as error:
        outcome, message = "wrong", repr(error)[:500]
    used = max(0, _status_kib("VmHWM:") - before) / 1024
    return outcome, message, time.monotonic() - start, used


def _serve() -> None:
    import cv2
    import torch

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    for module in ("tactorch.cli.resume", "tactorch.inverse", "tactorch.learning.recognizer"):
        importlib.import_module(module)
    for name in ("tactorch.volumes.read", "tactorch.importers.vtk_files", "tactorch.sensor.frames"):
        importlib.import_module(name)
    gc.freeze()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what readers print is no answer
    for line in sys.stdin:
        reading, writing = os.pipe()
        if not (child := os.fork()):
            with os.fdopen(writing, "w") as result:
                json.dump(_answer(*json.loads(line)), result)
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as result:
            text = result.read()
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(text or json.dumps(["wrong", f"ended with {status}", 0, 0]), file=answers, flush=True)


if __name__ == "__main__":
    _serve()
