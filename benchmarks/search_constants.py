"""Sensitivity of the search for inclusions to each of its constants.

    python benchmarks/search_constants.py [--case NAME|FILE] [--factor 1.4] [--only NAME...]
        [--cache FOLDER] [--resume FOLDER] [--workers N] [--out FOLDER]

Each numeric constant of the modules of the search (fields, errors, fit of shapes, search and
posterior) is multiplied and divided by the factor, whole numbers by at least one, and the search is
run again on a case of `true_objects.py`. The table has the changes of the parameters of the
inclusions in posterior standard deviations of the default run, that of the log-odds, and the CPU
seconds over the default. Constants bound as defaults of arguments and limits of memory are left
out. The truth is not read.

The last line printed is one JSON object.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from machine import map_in_processes, write_results
from true_cases import CASES, make_recording

from tactorch.errors import TactorchError
from tactorch.files import write_json
from tactorch.inverse import Settings
from tactorch.inverse.result.shapes import ShapeReconstruction
from tactorch.inverse.search import find_shapes
from tactorch.recording import Recording

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "numba", "pypardiso", "mkl")
ROOMS = ("fields", "errors", "fit.shapes", "search", "posterior")
# Other searches and maps; definitions; limits of memory; and round-off.
LEFT_OUT = (
    "palpation", "draft", "smooth_forces", "criticism", "held_out", "sharp", "_ROD", "_DIRECTIONS",
    "_LEVI_CIVITA", "_X", "_Y", "_Z", "_POISSON_TERM", "_VARIANCE", "_TINY", "_NEVER", "_AT_ONCE",
    "_AT_EDGE_MM", "_MAX_SHAPES", "MAX_LOG_ODDS", "_DAMPING",
)  # fmt: skip
HEADER = (
    "| constant | value | inclusions | largest change / deviation | log-odds | CPU ratio |\n|"
    + "---|" * 6
)


class Constant(NamedTuple):
    """A module-level number, or several."""

    module: str
    name: str
    value: Any

    def scaled(self, factor: float) -> Any:
        """Return the value times a factor; whole numbers change by one at least."""
        if isinstance(self.value, int):
            least = self.value + (1 if factor > 1.0 else -1)
            new = round(self.value * factor)
            return max(new, least) if factor > 1.0 else max(min(new, least), 1)
        if isinstance(self.value, tuple):
            return tuple(self._replace(value=one).scaled(factor) for one in self.value)
        return self.value * factor


def constants() -> Iterator[Constant]:
    """Yield the constants of the rooms, in order of their modules."""
    for module in sorted(name for name in sys.modules if name.startswith("tactorch.inverse.")):
        room = module.removeprefix("tactorch.inverse.")
        if not room.startswith(ROOMS) or any(part in room for part in LEFT_OUT):
            continue
        for name, value in vars(sys.modules[module]).items():
            numbers = value if isinstance(value, tuple) else (value,)
            numeric = all(isinstance(n, (int, float, np.ndarray)) for n in numbers) and numbers
            own = name.strip("_").isupper() and not name.startswith(LEFT_OUT)
            if own and numeric and not _is_imported(module, name):
                yield Constant(module, name, value)


def _is_imported(module: str, name: str) -> bool:
    source = Path(str(sys.modules[module].__file__)).read_text(encoding="utf-8")
    assigned = (line.split("=")[0] for line in source.splitlines() if "=" in line)
    return not any(name in head.replace(",", " ").replace(":", " ").split() for head in assigned)


def set_constant(constant: Constant, value: Any) -> None:
    """Replace the constant in its module and where it is imported by name."""
    for name, module in list(sys.modules.items()):
        is_used = name == constant.module or not constant.name.startswith("_")
        same = is_used and vars(module).get(constant.name) is constant.value
        if same and name.startswith("tactorch."):
            setattr(module, constant.name, value)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the searches and print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--case", default="ball-sides4-40db", help="case of true_objects.py, or a recording"
    )
    parser.add_argument("--factor", type=float, default=1.4, help="factor of each constant")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="constants, or modules")
    parser.add_argument("--cache", type=Path, help="folder of the noise-free recordings")
    parser.add_argument("--resume", type=Path, help="folder that keeps each run")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="folder for search_constants.json and .md")
    options = parser.parse_args(arguments)
    found = [c for c in constants() if not options.only or {c.name, c.module} & {*options.only}]
    jobs = [(None, 1.0), *((c, f) for c in found for f in (1 / options.factor, options.factor))]
    work = partial(run, case=options.case, cache=options.cache, resume=options.resume)
    results = list(map_in_processes(work, jobs, options.workers))
    base, lines = results[0], [f"Case {options.case}.", "", HEADER]
    for (constant, factor), result in zip(jobs[1:], results[1:], strict=True):
        assert constant is not None
        result.update(compare(base, result), constant=f"{constant.module}.{constant.name}")
        result["value"] = np.asarray(constant.scaled(factor)).tolist()
        lines.append(row(result))
    print("\n".join(lines))
    summary = {"case": options.case, "factor": options.factor, "default": base, "runs": results[1:]}
    if options.out:
        write_results(options.out, "search_constants", lines, summary, PACKAGES)
    print(json.dumps(summary))


def run(
    job: tuple[Constant | None, float], *, case: str, cache: Path | None, resume: Path | None
) -> dict[str, Any]:
    """Return the inclusions that a search finds with one changed constant."""
    constant, factor = job
    name = f"{constant.module}.{constant.name}_{factor:.3g}" if constant else "default"
    path = resume / f"{Path(case).stem}_{name}.json" if resume else None
    if path is not None and path.exists():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    if Path(case).is_file():
        recording = Recording.load(case)
    else:
        recording = make_recording(next(c for c in CASES if c.name == case), cache)
    if constant:
        import_module(constant.module)
        changed = constant._replace(value=constant.scaled(factor))
        set_constant(constant, changed.value)
    began = time.process_time()
    try:
        result = describe(find_shapes(recording, Settings()))
    except TactorchError as error:
        result = {"error": str(error)}
    finally:
        if constant:
            set_constant(changed, constant.value)
    result["cpu_s"] = time.process_time() - began
    print(f"{name}: {result['cpu_s']:.0f} s", file=sys.stderr, flush=True)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, result)
    return result


def describe(result: ShapeReconstruction) -> dict[str, Any]:
    """Return the parameters of a result, with their deviations."""
    return {
        "families": [family.name for family in result.field.families],
        "values": result.field.physical(result.z).tolist(),
        "deviations": (
            result.posterior.field.deviation * np.sqrt(np.diag(result.posterior.covariance))
        ).tolist(),
        "log_odds": result.log_odds_any,
        "chi2": result.chi2,
    }


def compare(base: dict[str, Any], result: dict[str, Any]) -> dict[str, Any]:
    """Return the changes from the default run; parameters of other families have no change."""
    if "error" in result:
        return {"cpu_ratio": result["cpu_s"] / base["cpu_s"]}
    change = None
    if result["families"] == base["families"]:
        count = len(base["values"])
        moved = np.array(result["values"]) - base["values"]
        change = float(np.abs(moved / np.array(base["deviations"])[:count]).max())
    return {
        "change": change,
        "log_odds_change": result["log_odds"] - base["log_odds"],
        "cpu_ratio": result["cpu_s"] / base["cpu_s"],
    }


def row(result: dict[str, Any]) -> str:
    """Return the row of the table."""
    first = f"| {result['constant'].removeprefix('tactorch.inverse.')} | {result['value']} |"
    if "error" in result:
        return f"{first} {result['error'][:60]} | | | {result['cpu_ratio']:.2f} |"
    change = "other model" if result["change"] is None else f"{result['change']:.2f}"
    return (
        f"{first} {' '.join(result['families']) or 'none'} | {change} | "
        f"{result['log_odds_change']:+.1f} | {result['cpu_ratio']:.2f} |"
    )


if __name__ == "__main__":
    main()
