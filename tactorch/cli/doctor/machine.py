"""Processors, memory and graphics of this machine."""

import os
import platform
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from tactorch.cli.doctor.finding import Finding, looked_at, reason_of
from tactorch.errors import ConfigError

PART = "machine"
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_GIB = 2.0**30


def look_at_machine() -> Iterator[Finding]:
    """Look at what there is to compute with."""
    yield Finding(PART, "system", None, f"{platform.system()} {platform.machine()}")
    for name, look in (("cores", _cores), ("threads", _threads), ("memory", _memory)):
        found = looked_at(PART, name, look)
        yield replace(found, works=None) if found.works else found
    yield _gpu()


def _cores() -> str:
    there = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else there
    quota = _of_container("cpu.max")
    share = f", {float(quota[0]) / float(quota[1]):g} of them by the container" if quota else ""
    return f"{usable} usable of {there}{share}"


def _threads() -> str:
    """How many threads libraries use by themselves, and what the environment says of that."""
    said = ", ".join(f"{name}={os.environ[name]}" for name in _THREADS if name in os.environ)
    import torch

    return f"torch uses {torch.get_num_threads()}" + (f" ({said})" if said else "")


def _memory() -> str:
    if not hasattr(os, "sysconf"):
        return "unknown"
    page = os.sysconf("SC_PAGE_SIZE")
    message = f"{page * os.sysconf('SC_PHYS_PAGES') / _GIB:.1f} GiB"
    limit = _of_container("memory.max")
    if limit:
        message += f", {float(limit[0]) / _GIB:.1f} GiB of them for the container"
    available = _available()
    return message + (f", {available:.1f} GiB free" if available is not None else "")


def _available() -> float | None:
    """Return the memory that can be had without swapping, GiB; None where the system hides it."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    kib = next((float(x.split()[1]) for x in lines if x.startswith("MemAvailable:")), None)
    return None if kib is None else kib * 1024 / _GIB


def _of_container(name: str) -> list[str]:
    """Return a limit of the container that we are in; empty where there is none."""
    try:
        words = Path("/sys/fs/cgroup", name).read_text().split()
    except OSError:
        return []
    return [] if not words or words[0] == "max" else words


def _gpu() -> Finding:
    """Return the finding on the GPU; its absence is reported, but is no failure."""
    feature = "solver=torch_cg, trainer=gpu"
    try:
        reason = _why_none()
    except Exception as error:  # a broken torch, reported among the packages
        reason = reason_of(error)
    if reason:
        return Finding(PART, "GPU", None, f"none: {reason}", feature)
    return looked_at(PART, "GPU", _devices, feature, "see what nvidia-smi says of its driver")


def _why_none() -> str:
    """Return why torch can use no GPU; empty where it can."""
    import torch

    if torch.version.cuda is None:
        return f"torch {torch.__version__} is built without CUDA"
    if torch.cuda.is_available():
        return ""
    try:
        torch.cuda.init()
    except (RuntimeError, AssertionError) as error:
        return reason_of(error)
    return "torch sees no device"


def _devices() -> str:
    """Use each: a device may be seen, and fail."""
    import torch

    names = []
    for k in range(torch.cuda.device_count()):
        if float(torch.ones(8, device=f"cuda:{k}").sum()) != 8.0:
            raise ConfigError(f"device {k} adds wrongly")
        names.append(torch.cuda.get_device_name(k))
    return f"{', '.join(names)} (CUDA {torch.version.cuda})"
