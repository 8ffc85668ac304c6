"""What a benchmark ran on, in words that fit any machine, and what else ran there meanwhile."""

import json
import os
import platform
import resource
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


def describe_machine(packages: tuple[str, ...]) -> dict[str, str | int]:
    """Return the processor, its cores, the system, Python and the versions of `packages`."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: _version(name) for name in packages},
    }


def write_results(
    folder: Path, name: str, lines: list[str], result: dict[str, Any], packages: tuple[str, ...]
) -> None:
    """Write NAME.md with the lines, and NAME.json with the figures and the machine."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    content = json.dumps({**result, "machine": describe_machine(packages)}, indent=1)
    (folder / f"{name}.json").write_text(content + "\n", encoding="utf-8")


def peak_gib() -> float:
    """Largest resident memory of this process so far, GiB."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / 2.0 ** (30 if sys.platform == "darwin" else 20)


def _processor() -> str:
    """Model of the processor and its instruction sets' highest vector width."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    fields: dict[str, str] = {}
    for line in info.read_text().splitlines():
        key, _, value = line.partition(":")
        fields.setdefault(key.strip(), value.strip())
    name = fields.get("model name", platform.machine())
    vectors = "AVX-512" if "avx512f" in fields.get("flags", "") else "no AVX-512"
    numbers = f"family {fields.get('cpu family', '?')} model {fields.get('model', '?')}"
    return f"{name} ({numbers}, {vectors}, {float(fields.get('cpu MHz', 0)) / 1e3:.1f} GHz)"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


class OtherWork:
    """Meter of the processor time that other processes take, from its construction on."""

    def __init__(self) -> None:
        """Start."""
        self._began = time.perf_counter(), _busy_seconds(), time.process_time()

    def share(self) -> float | None:
        """Share of all cores that others have taken so far; None where it cannot be told."""
        wall, busy, own = self._began
        now = _busy_seconds()
        if busy is None or now is None:
            return None
        others = (now - busy) - (time.process_time() - own)
        return max(others, 0.0) / ((time.perf_counter() - wall) * (os.cpu_count() or 1))


def _busy_seconds() -> float | None:
    """Processor seconds that all processes together have taken since the machine started."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return None
    user, nice, system, _, _, interrupt, soft = (
        int(x) for x in stat.read_text().split("\n", 1)[0].split()[1:8]
    )
    return (user + nice + system + interrupt + soft) / os.sysconf("SC_CLK_TCK")
